//! The settings of a link.
use std::time::Duration;

pub use link_lanes::lanes::scheduler::Bounds;

/// The settings of a link. Both sides use the same largest batch.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// The largest batch, in bytes.
    pub max_batch: usize,
    /// The limits of what may wait.
    pub bounds: Bounds,
    /// How long the link stays open without a path that works.
    pub lease: Duration,
    /// Whether all paths are encrypted. Matters only for the count of what they carry.
    pub is_encrypted: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_batch: 16_000,
            bounds: Bounds {
                bytes: 16 << 20,
                backlog: Duration::from_millis(2500),
                droppable: Duration::from_millis(100),
            },
            lease: Duration::from_secs(10),
            is_encrypted: true,
        }
    }
}

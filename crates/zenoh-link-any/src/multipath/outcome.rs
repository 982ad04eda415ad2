//! The results of a link's logic: the effects of frames, violations, the end, and the state of its paths.
use std::time::{Duration, Instant};

use link_lanes::lanes::Lane;

use crate::{
    frame::FrameError,
    in_lane::LaneError,
    path::{AckError, Medium, PathState},
};

/// Why a link has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum End {
    /// No path has worked for the lease.
    #[error("no path to the peer has worked for {0:?}")]
    NoPath(Duration),
    /// The peer has ended the link.
    #[error("the peer has ended the link (reason {0})")]
    ClosedByPeer(u8),
    /// This side has ended the link, and has notified the peer.
    #[error("closed by this side")]
    Closed,
}

/// A violation of the protocol by the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// The frame is malformed. It ends the path.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// The acknowledgement is wrong. It ends the path.
    #[error(transparent)]
    Ack(#[from] AckError),
    /// The bytes of a lane are wrong. It ends the link.
    #[error("lane {}: {error}", .lane.number())]
    Lane {
        /// The lane.
        lane: Lane,
        /// The violation.
        error: LaneError,
    },
}

/// The effect of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Nothing for the program.
    Nothing,
    /// A batch can be taken from that lane.
    Batch(Lane),
    /// There is more room, or another path to use.
    Credits,
}

/// A change of the path that carries the bulk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Switch {
    /// The medium of the path before.
    pub previous: Medium,
    /// The medium of the path that carries the bulk since then.
    pub current: Medium,
    /// Why it has changed.
    pub reason: SwitchReason,
    /// How long frames had waited for an acknowledgement when another path took them over. Zero if none had waited.
    pub gap: Duration,
    /// When it has changed.
    pub at: Instant,
}

/// Why another path carries the bulk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SwitchReason {
    /// The path has ended: its connection was closed, or its network was lost.
    Ended,
    /// The acknowledgements of the path were missing.
    Silent,
    /// The other path is faster.
    Faster,
}

/// The state of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathReport {
    /// Its medium.
    pub medium: Medium,
    /// Whether it is used.
    pub state: PathState,
    /// Whether it carries the bulk.
    pub is_primary: bool,
    /// The rate, measured or assumed, in bytes per second.
    pub rate_bytes_per_s: f64,
    /// Whether the rate was measured.
    pub is_measured: bool,
    /// The mean round trip, if it was measured.
    pub round_trip: Option<Duration>,
    /// Number of bytes sent.
    pub sent_bytes: u64,
    /// Number of bytes among them that another path had carried before.
    pub resent_bytes: u64,
}

impl PathReport {
    /// Returns whether this is a network path that works.
    pub(crate) fn is_live_network(&self) -> bool {
        self.medium == Medium::Network && self.state == PathState::Live
    }
}

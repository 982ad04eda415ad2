//! Defines the [`LinkNumber`].
/// Identifies a link or dial within this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkNumber(pub u64);

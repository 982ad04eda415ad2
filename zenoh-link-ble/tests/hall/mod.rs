//! Scenarios of a contest hall.
mod crowd;
mod fleets;

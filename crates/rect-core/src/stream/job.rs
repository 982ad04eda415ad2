//! Defines what the sender of a stream asks for: a frame for a group of receivers, in the form that its links allow.
use super::{ladder::Step, Group};
use crate::video::Settings;

/// A frame that is to be encoded and sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Job {
    /// Group to which the frame is sent.
    pub group: Group,
    /// Step at which to encode the frame. `None` to send it unchanged, or as video.
    pub step: Option<Step>,
    /// How to encode the frame as video.
    pub video: Option<Settings>,
}

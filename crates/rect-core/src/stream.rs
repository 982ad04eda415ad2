//! Streams: a camera's pictures or a sensor's values, of which only the newest matters. A slow link drops older frames;
//! an adaptive stream adjusts the quality, size and rate of its frames to the capacity of the links.
//!
//! | purpose | key |
//! |---|---|
//! | frames for the main group | `<fleet>/<sender>/<topic>`: the picture without further framing, so that every Zenoh tool can display it |
//! | smaller frames, for the slow group | `<fleet>/<sender>/@rect/slow/<topic>` |
//! | the sender's description of the stream: [`notice`] | `<fleet>/<sender>/@rect/stream/<topic>`, queried and published |
//! | a receiver's report: [`feedback`] | `<fleet>/<receiver>/@rect/feedback/<sender>/<topic>` |
//!
//! The attachment of a frame contains its source (a random number for each of the two keys), its sequence number and
//! the low 16 bits of the time of sending. From the replies to its queries for the notice, the [`receiver`] learns the
//! offset between the clocks ([`offset`]), and with it the age of each frame. The *pace* of a frame is its size divided
//! by the time for which it occupied the slowest link: its age on arrival, minus the delay of a small message. The pace
//! shows the rate of that link without filling it, so that the sender's [`rate`] stays constant instead of oscillating.
//! The [`sender`] chooses the step of its [`ladder`] by that rate, spaces the frames ([`pacer`]), and separates
//! receivers with very different links into [`groups`].
pub mod feedback;
pub mod frame;
pub mod groups;
pub mod job;
pub mod ladder;
pub mod notice;
pub mod offset;
pub mod options;
pub mod pacer;
pub mod picture;
pub mod publish;
pub mod rate;
pub mod read;
pub mod receiver;
pub mod sender;
pub mod status;
pub mod video;
pub mod watch;

#[cfg(test)]
pub(crate) mod simulation;
#[cfg(test)]
mod tests;

use crate::name::{
    key::{KeySpace, OWN},
    topic::Topic,
    Name,
};

/// The receivers of a stream that get the same frames.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    serde::Serialize,
    serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Group {
    /// Receivers with links of similar speed, and all other Zenoh programs.
    #[default]
    Main,
    /// Receivers whose links are much slower than those of the others.
    Slow,
}

impl Group {
    /// Both groups.
    pub const ALL: [Self; 2] = [Self::Main, Self::Slow];

    /// Returns the key of the group's frames.
    pub fn key(self, keys: &KeySpace, topic: &Topic) -> String {
        match self {
            Self::Main => keys.publication(topic),
            Self::Slow => keys.own(Some(&keys.robot), &format!("slow/{topic}")),
        }
    }

    pub(crate) fn index(self) -> usize {
        match self {
            Self::Main => 0,
            Self::Slow => 1,
        }
    }
}

/// Returns the key of the notice about the stream `topic` of the robot of `keys`.
pub fn notice_key(keys: &KeySpace, topic: &Topic) -> String {
    keys.own(Some(&keys.robot), &format!("stream/{topic}"))
}

/// Returns the key of the feedback that the robot of `keys` sends about the stream `topic` of `sender`.
pub fn feedback_key(keys: &KeySpace, sender: &Name, topic: &Topic) -> String {
    keys.own(Some(&keys.robot), &format!("feedback/{sender}/{topic}"))
}

/// Returns the key expression of the feedback of all receivers about the stream `topic` of the robot of `keys`.
pub fn feedback_keys(keys: &KeySpace, topic: &Topic) -> String {
    keys.own(None, &format!("feedback/{}/{topic}", keys.robot))
}

/// Returns the robot that sent feedback on `key`. `None` if it is not a key of feedback.
pub fn feedback_from(keys: &KeySpace, key: &str) -> Option<Name> {
    let rest = key.strip_prefix(keys.fleet.as_str())?.strip_prefix('/')?;
    let (name, rest) = rest.split_once('/')?;
    rest.strip_prefix(OWN)?.strip_prefix("/feedback/")?;
    Name::new(name).ok()
}

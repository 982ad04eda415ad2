//! Streams: pictures of a camera, values of a sensor, of which the newest counts. What is old, a slow link drops; an
//! adaptive stream fits quality, size and rate of its frames to what gets through.
//!
//! | what | key |
//! |---|---|
//! | frames for all that keep up | `<fleet>/<sender>/<topic>`: the picture as it is, so that every Zenoh tool shows it |
//! | smaller ones, for those that do not | `<fleet>/<sender>/@rect/slow/<topic>` |
//! | what the sender says of it: [`notice`] | `<fleet>/<sender>/@rect/stream/<topic>`, asked for and put |
//! | what a receiver says: [`feedback`] | `<fleet>/<receiver>/@rect/feedback/<sender>/<topic>` |
//!
//! A frame's attachment is its source (drawn anew for each of the two keys), its number there and the low 16 bits of its
//! time. The [`receiver`] knows from the small question for the notice how the clocks differ ([`offset`]), thus the age of
//! each frame, thus at what *pace* the frame came through: its bytes by the time that they took. The pace tells the rate
//! of the slowest link without filling it, so that the [`rate`] of the sender stays where it is instead of swinging
//! around the link's. The [`sender`] chooses the step of its [`ladder`] by that rate, spaces the frames
//! ([`pacer`]), and parts receivers of very different links into [`groups`].
pub mod feedback;
pub mod groups;
pub mod ladder;
pub mod notice;
pub mod offset;
pub mod pacer;
pub mod picture;
pub mod rate;
pub mod receiver;
pub mod sender;
pub mod status;

#[cfg(test)]
mod simulation;
#[cfg(test)]
mod tests;

use super::{
    key::{Place, OWN},
    name::Name,
    topic::Topic,
};

/// To whom a frame goes.
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
    /// All that keep up with each other; stock programs too.
    #[default]
    Main,
    /// Those that get much less through than the others.
    Slow,
}

impl Group {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Main, Self::Slow];

    /// The key of its frames.
    pub fn key(self, place: &Place, topic: &Topic) -> String {
        match self {
            Self::Main => place.publication(topic),
            Self::Slow => place.own(Some(&place.robot), &format!("slow/{topic}")),
        }
    }

    pub(crate) fn index(self) -> usize {
        match self {
            Self::Main => 0,
            Self::Slow => 1,
        }
    }
}

/// The key of what the sender at `place` says of a stream.
pub fn notice_key(place: &Place, topic: &Topic) -> String {
    place.own(Some(&place.robot), &format!("stream/{topic}"))
}

/// The key of what the receiver at `place` says of the stream of `sender`.
pub fn feedback_key(place: &Place, sender: &Name, topic: &Topic) -> String {
    place.own(Some(&place.robot), &format!("feedback/{sender}/{topic}"))
}

/// The key expression of what all receivers say of the stream of the sender at `place`.
pub fn feedback_keys(place: &Place, topic: &Topic) -> String {
    place.own(None, &format!("feedback/{}/{topic}", place.robot))
}

/// Who wrote a key that [`feedback_keys`] matches.
pub fn feedback_from(place: &Place, key: &str) -> Option<Name> {
    let rest = key.strip_prefix(place.fleet.as_str())?.strip_prefix('/')?;
    let (name, rest) = rest.split_once('/')?;
    rest.strip_prefix(OWN)?.strip_prefix("/feedback/")?;
    Name::new(name).ok()
}

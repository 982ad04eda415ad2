//! Decides when a recorder asks for a key frame: a video cannot be decoded before its first one, and a recording consists of files
//! that are removed one by one if it keeps only the newest.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use rect_core::{
    message::Message,
    name::{key::KeySpace, topic::Topic, Name},
    stream::{feedback::Feedback, feedback_key},
    video::bitstream,
};

use crate::segments::SEGMENT;

/// The pause before a request that had no effect is repeated.
const RETRY: Duration = Duration::from_secs(1);
/// The maximum number of videos that are watched.
const MAX_VIDEOS: usize = 256;

/// The videos of a recording.
#[derive(Debug)]
pub struct KeyFrames {
    place: KeySpace,
    /// When each video needs its next key frame.
    due: BTreeMap<(Name, Topic), Instant>,
}

/// A message to the sender of a video.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyRequest {
    /// The key on which it is published.
    pub key: String,
    /// The payload.
    pub bytes: Vec<u8>,
}

impl KeyFrames {
    /// Creates the requests of a recorder of the robot of `place`.
    pub fn new(place: KeySpace) -> Self {
        Self {
            place,
            due: BTreeMap::new(),
        }
    }

    /// Handles a message of the recording. Returns the request to send.
    pub fn on_message(&mut self, message: &Message, now: Instant) -> Option<KeyRequest> {
        if !bitstream::is_video(&message.payload) || message.replayed {
            return None;
        }
        let video = (message.sender.clone(), message.topic.clone());
        let due = self.due.get(&video);
        if due.is_none() && self.due.len() >= MAX_VIDEOS {
            return None;
        }
        if bitstream::is_key_frame(&message.payload.bytes) {
            self.due.insert(video, now + SEGMENT);
            return None;
        }
        if due.is_some_and(|&due| now < due) {
            return None;
        }
        let request = KeyRequest {
            key: feedback_key(&self.place, &message.sender, &message.topic),
            bytes: Feedback::of_recorder().encode(),
        };
        self.due.insert(video, now + RETRY);
        Some(request)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rect_core::message::{encoding::Encoding, payload::Payload};

    const KEY: &[u8] = &[
        0, 0, 0, 1, 0x67, 1, 0, 0, 0, 1, 0x68, 1, 0, 0, 0, 1, 0x65, 1,
    ];
    const OTHER: &[u8] = &[0, 0, 0, 1, 0x61, 1];

    fn videos_of_base() -> KeyFrames {
        KeyFrames::new(KeySpace {
            fleet: Name::new("rect").expect("a fleet"),
            robot: Name::new("base").expect("a name"),
        })
    }

    fn frame(topic: &str, bytes: &'static [u8]) -> Message {
        let (sender, topic) = (Name::new("wombat-1"), Topic::new(topic));
        let payload = Payload::new(bytes, Encoding::H264);
        Message::new(sender.expect("a name"), topic.expect("a topic"), payload)
    }

    #[test]
    fn asks_at_the_beginning_and_when_a_file_has_none() {
        let mut videos = videos_of_base();
        let start = Instant::now();
        let mut asks = |topic, bytes, seconds| {
            let message = frame(topic, bytes);
            videos.on_message(&message, start + Duration::from_secs_f64(seconds))
        };
        let request = asks("camera", OTHER, 0.0).expect("a request");
        assert_eq!(request.key, "rect/base/@rect/feedback/wombat-1/camera");
        assert_eq!(
            Feedback::decode(&request.bytes),
            Ok(Feedback::of_recorder())
        );
        assert_eq!(asks("camera", OTHER, 0.9), None, "asked a moment ago");
        assert!(asks("camera", OTHER, 1.0).is_some(), "not heard");
        assert_eq!(asks("camera", KEY, 1.5), None);
        assert_eq!(asks("camera", OTHER, 6.4), None);
        assert!(asks("camera", OTHER, 6.5).is_some());
        assert!(asks("rear", OTHER, 6.5).is_some(), "another video");
        assert_eq!(asks("rear", KEY, 7.0), None);
    }

    #[test]
    fn ignores_what_is_not_live_video() {
        let mut videos = videos_of_base();
        let replayed = Message {
            replayed: true,
            ..frame("camera", OTHER)
        };
        let picture = Message {
            payload: Payload::new(OTHER, Encoding::JPEG),
            ..frame("camera", OTHER)
        };
        for message in [replayed, picture] {
            assert_eq!(videos.on_message(&message, Instant::now()), None);
        }
    }
}

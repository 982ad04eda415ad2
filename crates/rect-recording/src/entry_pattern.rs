//! Selects the entries of a recording by their topics.
use std::str::FromStr;

use rect_core::name::topic::{Pattern, TopicError};
use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

/// A pattern for topics of a recording: `<robot>/<topic>`, or one with a slash before it, such as `/left/*`, for the topics of
/// other programs, which may have no robot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EntryPattern {
    /// A pattern for messages of robots.
    Robot(Pattern),
    /// A pattern for whole topics.
    Whole(OwnedKeyExpr),
}

impl EntryPattern {
    /// Returns whether a topic of a recording matches.
    pub fn matches(&self, topic: &str) -> bool {
        let topic = topic.trim_start_matches('/');
        match self {
            Self::Robot(pattern) => pattern.matches(topic),
            Self::Whole(pattern) => {
                keyexpr::new(topic).is_ok_and(|topic| pattern.intersects(topic))
            }
        }
    }
}

impl From<Pattern> for EntryPattern {
    fn from(pattern: Pattern) -> Self {
        Self::Robot(pattern)
    }
}

impl FromStr for EntryPattern {
    type Err = TopicError;

    fn from_str(text: &str) -> Result<Self, TopicError> {
        let Some(whole) = text.strip_prefix('/') else {
            return Ok(Self::Robot(Pattern::new(text)?));
        };
        let pattern = OwnedKeyExpr::new(whole.to_owned());
        let pattern = pattern.map_err(|error| TopicError::Invalid {
            topic: text.to_owned(),
            reason: error.to_string(),
        });
        Ok(Self::Whole(pattern?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_with_and_without_a_robot_are_selected() {
        for (pattern, topic, expected) in [
            ("wombat-1/arm/*", "wombat-1/arm/angle", true),
            ("wombat-1/arm/*", "/wombat-1/arm/angle", true),
            ("*/image", "/left/image", true),
            ("/left_camera/*", "/left_camera/image", true),
            ("/left_camera/*", "/right_camera/image", false),
            ("/odom", "/odom", true),
            ("/**", "/odom", true),
            ("/**", "wombat-1/arm", true),
            ("/odom", "/odometry", false),
            ("/odom", "/Not a key//", false),
        ] {
            let pattern: EntryPattern = pattern.parse().expect(pattern);
            assert_eq!(pattern.matches(topic), expected, "{pattern:?} {topic}");
        }
        for wrong in ["odom", "/", "//odom", "/a//b", "/a/"] {
            assert!(wrong.parse::<EntryPattern>().is_err(), "{wrong}");
        }
    }
}

//! Owns what a message may be about ([`Topic`]), and what one may subscribe to ([`Pattern`]).
use std::{fmt, str::FromStr, sync::Arc};

use zenoh_keyexpr::{canon::Canonize, keyexpr};

use super::{
    display::is_harmful,
    name::{Name, NameError},
};

/// The longest topic, in bytes: it goes over the air with every message that has no declared key.
pub const MAX_BYTES: usize = 200;

/// The part of a key that says that the next is a robot to whom the message goes.
pub(super) const TO: &str = "to";

/// What a message is about: parts with `/` between them, such as `arm/angle`; no wildcards, no part that begins with `@`
/// (those are Zenoh's and RECT's own), and the first part is not `to`.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Topic(Arc<str>);

/// The messages that one wants: of whom, and about what.
///
/// As text, `<robot>/<topic>`, both with Zenoh's wildcards: `wombat-2/arm/angle`, `*/arm/*` (any robot, anything of its
/// arm), `wombat-2/**` (all that it says).
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct Pattern {
    robot: Option<Name>,
    topic: Arc<str>,
}

/// The text can't be a topic or a pattern.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TopicError {
    /// Empty, or too long.
    #[error("a topic is 1 to {MAX_BYTES} bytes long, such as `arm/angle`")]
    Length,
    /// Zenoh does not take it as a key.
    #[error("the topic {topic:?} is not one: {reason}")]
    Invalid {
        /// What was given.
        topic: String,
        /// What Zenoh says of it.
        reason: String,
    },
    /// A wildcard where one thing is to be named.
    #[error("the topic {0:?} has a wildcard in it: a message is about one thing; wildcards are for subscribing")]
    Wildcard(String),
    /// A character that a terminal would obey, or that makes a line read as something else than it is: control characters,
    /// invisible characters, and the marks that change the direction of text.
    #[error(
        "the topic {topic:?} has the character U+{:04X} in it: control characters, invisible characters and marks of text \
         direction are not allowed in topics; use letters, digits, `_`, `-` and `/`",
        u32::from(*.found)
    )]
    Character {
        /// The rejected text.
        topic: String,
        /// The first such character.
        found: char,
    },
    /// A part that belongs to Zenoh or RECT.
    #[error("the topic {topic:?} has the part {part:?} in it, which is for RECT's own messages")]
    Reserved {
        /// What was given.
        topic: String,
        /// Which part.
        part: String,
    },
    /// The robot of a pattern.
    #[error(
        "a pattern is `<robot>/<topic>`, such as `wombat-2/arm/angle` or `*/arm/*`: {0:?} is not"
    )]
    Pattern(String),
    /// The robot of a pattern has no possible name.
    #[error(transparent)]
    Robot(#[from] NameError),
}

impl From<std::convert::Infallible> for TopicError {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

impl Topic {
    /// Checks a text.
    ///
    /// # Errors
    /// [`TopicError`]: what is wrong with it.
    pub fn new(text: &str) -> Result<Self, TopicError> {
        let key = checked(text)?;
        if key.contains('*') {
            return Err(TopicError::Wildcard(text.to_owned()));
        }
        Ok(Self(text.into()))
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl Pattern {
    /// Reads `<robot>/<topic>`.
    ///
    /// # Errors
    /// [`TopicError`]: what is wrong with it.
    pub fn new(text: &str) -> Result<Self, TopicError> {
        let no_pattern = || TopicError::Pattern(text.chars().take(MAX_BYTES).collect());
        let (robot, topic) = text.split_once('/').ok_or_else(no_pattern)?;
        let robot = match robot {
            "*" => None,
            name => Some(Name::new(name)?),
        };
        Self::of(robot, topic)
    }

    /// Of that robot, or of any; `topic` may have wildcards.
    ///
    /// # Errors
    /// [`TopicError`]: what is wrong with the topic.
    pub fn of(robot: Option<Name>, topic: &str) -> Result<Self, TopicError> {
        if topic.len() > MAX_BYTES {
            return Err(TopicError::Length);
        }
        let mut canonical = topic.to_owned();
        // zenoh-keyexpr 1.10.2 reads beyond the end of one that ends in these.
        while canonical.contains("$*$*") {
            canonical = canonical.replace("$*$*", "$*");
        }
        canonical.canonize();
        checked(&canonical)?;
        let topic = canonical.into();
        Ok(Self { robot, topic })
    }

    /// Of whom; `None`: anyone.
    pub fn robot(&self) -> Option<&Name> {
        self.robot.as_ref()
    }

    /// About what, perhaps with wildcards.
    pub fn topic(&self) -> &str {
        &self.topic
    }
}

fn checked(text: &str) -> Result<&keyexpr, TopicError> {
    if !(1..=MAX_BYTES).contains(&text.len()) {
        return Err(TopicError::Length);
    }
    let topic = || text.to_owned();
    if let Some(found) = text.chars().find(|&c| is_harmful(c)) {
        let topic = topic();
        return Err(TopicError::Character { topic, found });
    }
    let key = keyexpr::new(text).map_err(|error| TopicError::Invalid {
        topic: topic(),
        reason: error.to_string(),
    })?;
    let own = |(n, part): &(usize, &str)| part.starts_with('@') || (*n == 0 && *part == TO);
    match text.split('/').enumerate().find(own) {
        Some((_, part)) => Err(TopicError::Reserved {
            topic: topic(),
            part: part.to_owned(),
        }),
        None => Ok(key),
    }
}

impl FromStr for Topic {
    type Err = TopicError;

    fn from_str(text: &str) -> Result<Self, TopicError> {
        Self::new(text)
    }
}

impl TryFrom<&str> for Topic {
    type Error = TopicError;

    fn try_from(text: &str) -> Result<Self, TopicError> {
        Self::new(text)
    }
}

impl TryFrom<&Topic> for Topic {
    type Error = TopicError;

    fn try_from(topic: &Topic) -> Result<Self, TopicError> {
        Ok(topic.clone())
    }
}

impl FromStr for Pattern {
    type Err = TopicError;

    fn from_str(text: &str) -> Result<Self, TopicError> {
        Self::new(text)
    }
}

impl TryFrom<&str> for Pattern {
    type Error = TopicError;

    fn try_from(text: &str) -> Result<Self, TopicError> {
        Self::new(text)
    }
}

impl TryFrom<&Pattern> for Pattern {
    type Error = TopicError;

    fn try_from(pattern: &Pattern) -> Result<Self, TopicError> {
        Ok(pattern.clone())
    }
}

impl fmt::Display for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for Topic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

impl fmt::Display for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let robot = self.robot.as_ref().map_or("*", Name::as_str);
        write!(f, "{robot}/{}", self.topic)
    }
}

impl fmt::Debug for Pattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{self}\"")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_names_one_thing() {
        for good in ["a", "arm/angle", "arm/to/x", "a b", "ä/ö", "to-do"] {
            assert_eq!(Topic::new(good).expect(good).as_str(), good);
        }
        let too_long = "x".repeat(MAX_BYTES + 1);
        for bad in [
            "", "/a", "a/", "a//b", "a/*", "**", "a$*", "to", "to/x", "@rect", "a/@x", "a#b",
            "a?b", &too_long,
        ] {
            assert!(Topic::new(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn control_and_direction_characters_are_rejected_in_topics_and_patterns() {
        let controls = (0..=0x1f).chain(0x7f..=0x9f).filter_map(char::from_u32);
        let directions = (0x202a..=0x202e)
            .chain(0x2066..=0x2069)
            .chain([0x200e, 0x200f, 0x61c]);
        for c in controls.chain(directions.filter_map(char::from_u32)) {
            let text = format!("arm/{c}angle");
            let error = Topic::new(&text).expect_err("a topic");
            assert!(
                matches!(&error, TopicError::Character { found, .. } if *found == c),
                "{error}"
            );
            let shown = error.to_string();
            assert!(
                shown.contains(&format!("U+{:04X}", u32::from(c))) && !shown.contains(c),
                "{shown}"
            );
            assert!(Pattern::new(&format!("*/{text}/*")).is_err(), "{c:?}");
        }
        for good in ["日本/角度", "a\u{200d}b", "é", "arm angle"] {
            assert!(Topic::new(good).is_ok(), "{good}");
        }
    }

    #[test]
    fn a_pattern_says_of_whom_and_about_what() {
        let pattern = Pattern::new("wombat-2/arm/*").expect("good");
        assert_eq!(pattern.robot().map(Name::as_str), Some("wombat-2"));
        assert_eq!(pattern.topic(), "arm/*");
        assert_eq!(Pattern::new("*/**").expect("good").robot(), None);
        assert_eq!(
            Pattern::new("*/**/**").expect("good").topic(),
            "**",
            "canonical"
        );
        for odd in ["*/b$*$*", "*/b$*$*$*", "*/b$*$*$*$*"] {
            assert_eq!(Pattern::new(odd).expect(odd).topic(), "b$*");
        }
        assert_eq!(Pattern::new("*/$*$*$*/b").expect("good").topic(), "*/b");
        for bad in [
            "",
            "arm",
            "**/arm",
            "w*/arm",
            "hci0/arm",
            "a/",
            "*/@rect/**",
            "*/to/x",
        ] {
            assert!(Pattern::new(bad).is_err(), "{bad}");
        }
    }
}

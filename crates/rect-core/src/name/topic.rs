//! Defines [`Topic`], the subject of a message, [`RobotTopic`], that of one robot, and [`Pattern`], which subscriptions match
//! against.
use std::{fmt, str::FromStr, sync::Arc};

use zenoh_keyexpr::{canon::Canonize, keyexpr};

use super::{parameter::is_name, Name, NameError};
use crate::text::display::is_harmful;

/// The maximum length of a topic, in bytes. The topic is sent with every message whose key is not declared.
pub const MAX_BYTES: usize = 200;

/// The beginning of the topics at which groups of parameters are changed. Access control grants it separately (`@set`).
const PARAMETERS: &str = "@rect/@set/parameters/";
/// The beginning of the topics at which goals of actions are started and cancelled. Access control grants it separately (`@set`).
const ACTIONS: &str = "@rect/@set/actions/";

/// The part of a key that precedes the recipient of a message to one robot.
pub(super) const TO: &str = "to";

/// The topic of a message: one or more parts separated by `/`, such as `arm/angle`; 1 to 200 bytes. It has no wildcards
/// and no control, invisible or text direction characters, no part begins with `@` (Zenoh and RECT use such parts
/// internally), and the first part is not `to`.
///
/// ```
/// use rect_core::name::topic::Topic;
/// assert!(Topic::new("arm/angle").is_ok());
/// assert!(Topic::new("arm/*").is_err());
/// ```
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Topic(Arc<str>);

/// A topic of one robot; as text, `<robot>/<topic>`: `wombat-2/camera`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RobotTopic {
    /// The robot.
    pub robot: Name,
    /// The topic.
    pub topic: Topic,
}

/// Selects messages by sender and topic.
///
/// As text, it is `<robot>/<topic>`. The robot is a name, or `*` for any robot. The topic may contain Zenoh's
/// wildcards: `wombat-2/arm/angle`, `*/arm/*` (topics of two parts, the first of which is `arm`, from any robot),
/// `wombat-2/**` (everything that wombat-2 publishes, or sends to this robot).
///
/// ```
/// use rect_core::name::topic::Pattern;
/// let pattern = Pattern::new("*/arm/*")?;
/// assert_eq!((pattern.robot(), pattern.topic()), (None, "arm/*"));
/// # Ok::<(), rect_core::name::topic::TopicError>(())
/// ```
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct Pattern {
    robot: Option<Name>,
    topic: Arc<str>,
}

/// The text is not a valid topic or pattern.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TopicError {
    /// The topic is empty or too long.
    #[error("a topic must be 1 to {MAX_BYTES} bytes long, such as `arm/angle`")]
    Length,
    /// Zenoh does not accept the topic as part of a key.
    #[error("{topic:?} is not a valid topic: {reason}")]
    Invalid {
        /// The rejected topic.
        topic: String,
        /// The reason that Zenoh gives.
        reason: String,
    },
    /// The topic of a message contains a wildcard.
    #[error("the topic {0:?} contains a wildcard: only subscriptions may use wildcards")]
    Wildcard(String),
    /// The topic contains a character that a terminal would interpret or that makes text read differently: control
    /// characters, invisible characters, and the marks that change the direction of text.
    #[error(
        "the topic {topic:?} contains the character U+{:04X}: control characters, invisible characters and marks of text \
         direction are not allowed in topics; use letters, digits, `_`, `-` and `/`",
        u32::from(*.found)
    )]
    Character {
        /// The rejected topic.
        topic: String,
        /// The first such character.
        found: char,
    },
    /// The topic contains a part that Zenoh or RECT uses internally.
    #[error("the topic {topic:?} contains the part {part:?}, which is reserved for internal messages of RECT and Zenoh")]
    Reserved {
        /// The rejected topic.
        topic: String,
        /// The reserved part.
        part: String,
    },
    /// The text is not of the form `<robot>/<topic>`.
    #[error(
        "{0:?} is not a pattern: write `<robot>/<topic>`, such as `wombat-2/arm/angle` or `*/arm/*`"
    )]
    Pattern(String),
    /// The text is not of the form `<robot>/<topic>`.
    #[error("{0:?} is not a topic of a robot: write `<robot>/<topic>`, such as `wombat-2/camera`")]
    RobotTopic(String),
    /// The robot of the text is not a valid name.
    #[error(transparent)]
    Robot(#[from] NameError),
}

impl From<std::convert::Infallible> for TopicError {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

impl Topic {
    /// Creates a topic after checking the text.
    ///
    /// # Errors
    /// Returns a [`TopicError`] that explains why the text is not a valid topic.
    pub fn new(text: &str) -> Result<Self, TopicError> {
        let key = checked(text)?;
        if key.contains('*') {
            return Err(TopicError::Wildcard(text.to_owned()));
        }
        Ok(Self(text.into()))
    }

    /// Returns the internal topic at which a program serves changes of a group of parameters. `None` if the name of the group is invalid.
    pub fn of_parameters(group: &str) -> Option<Self> {
        is_name(group).then(|| Self(format!("{PARAMETERS}{group}").into()))
    }

    /// Returns the group of parameters whose changes are served here.
    pub fn parameters(&self) -> Option<&str> {
        self.0.strip_prefix(PARAMETERS)
    }

    /// Returns the internal topic at which a program serves an action. `None` if the name of the action is invalid.
    pub fn of_action(action: &str) -> Option<Self> {
        is_name(action).then(|| Self(format!("{ACTIONS}{action}").into()))
    }

    /// Returns the action that is served here.
    pub fn action(&self) -> Option<&str> {
        self.0.strip_prefix(ACTIONS)
    }

    /// Returns the topic as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl RobotTopic {
    /// Parses `<robot>/<topic>`.
    ///
    /// # Errors
    /// Returns a [`TopicError`] that explains why the text is not a topic of a robot.
    pub fn new(text: &str) -> Result<Self, TopicError> {
        let no_topic = || TopicError::RobotTopic(text.chars().take(MAX_BYTES).collect());
        let (robot, topic) = text.split_once('/').ok_or_else(no_topic)?;
        Ok(Self {
            robot: Name::new(robot)?,
            topic: Topic::new(topic)?,
        })
    }
}

impl Pattern {
    /// Parses `<robot>/<topic>`.
    ///
    /// # Errors
    /// Returns a [`TopicError`] that explains why the text is not a valid pattern.
    pub fn new(text: &str) -> Result<Self, TopicError> {
        let no_pattern = || TopicError::Pattern(text.chars().take(MAX_BYTES).collect());
        let (robot, topic) = text.split_once('/').ok_or_else(no_pattern)?;
        let robot = match robot {
            "*" => None,
            name => Some(Name::new(name)?),
        };
        Self::of(robot, topic)
    }

    /// Creates a pattern for messages of `robot`, or of any robot (`None`). `topic` may contain wildcards.
    ///
    /// # Errors
    /// Returns a [`TopicError`] that explains why the topic is not valid.
    pub fn of(robot: Option<Name>, topic: &str) -> Result<Self, TopicError> {
        if topic.len() > MAX_BYTES {
            return Err(TopicError::Length);
        }
        let mut canonical = topic.to_owned();
        // zenoh-keyexpr 1.10.2 reads out of bounds when it canonizes a text that ends in `$*$*`.
        while canonical.contains("$*$*") {
            canonical = canonical.replace("$*$*", "$*");
        }
        canonical.canonize();
        checked(&canonical)?;
        let topic = canonical.into();
        Ok(Self { robot, topic })
    }

    /// Returns whether a message of `topic`, as `<robot>/<topic>`, matches.
    pub fn matches(&self, topic: &str) -> bool {
        let pattern = self.to_string();
        let (pattern, topic) = (keyexpr::new(&pattern), keyexpr::new(topic));
        matches!((pattern, topic), (Ok(pattern), Ok(topic)) if pattern.intersects(topic))
    }

    /// Returns the sender that the pattern selects. `None` if it selects any robot.
    pub fn robot(&self) -> Option<&Name> {
        self.robot.as_ref()
    }

    /// Returns the topic that the pattern selects, which may contain wildcards.
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
    let is_reserved = |(n, part): &(usize, &str)| part.starts_with('@') || (*n == 0 && *part == TO);
    match text.split('/').enumerate().find(is_reserved) {
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

impl FromStr for RobotTopic {
    type Err = TopicError;

    fn from_str(text: &str) -> Result<Self, TopicError> {
        Self::new(text)
    }
}

impl TryFrom<&str> for RobotTopic {
    type Error = TopicError;

    fn try_from(text: &str) -> Result<Self, TopicError> {
        Self::new(text)
    }
}

impl TryFrom<&RobotTopic> for RobotTopic {
    type Error = TopicError;

    fn try_from(topic: &RobotTopic) -> Result<Self, TopicError> {
        Ok(topic.clone())
    }
}

impl fmt::Display for RobotTopic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.robot, self.topic)
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

impl serde::Serialize for Topic {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
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
    fn topics_have_no_wildcards_and_no_reserved_parts() {
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
            let error = Topic::new(&text).expect_err("invalid topic");
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
    fn the_topic_of_a_robot_has_no_wildcards() {
        let topic = RobotTopic::new("wombat-2/arm/angle").expect("good");
        assert_eq!(topic.robot.as_str(), "wombat-2");
        assert_eq!(topic.topic.as_str(), "arm/angle");
        assert_eq!(topic.to_string(), "wombat-2/arm/angle");
        for bad in ["", "camera", "a/", "/camera", "*/camera", "a/*", "a/@rect"] {
            assert!(RobotTopic::new(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn patterns_select_robot_and_topic() {
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

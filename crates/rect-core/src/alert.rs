//! Alerts of a robot: what is wrong until somebody clears it. Each one is a retained topic, `alerts/<name>`.
pub mod query;

use serde::{Deserialize, Serialize};

use crate::{
    log::{clean, level::Level},
    message::{encoding::Encoding, payload::Payload},
    name::topic::{Topic, TopicError},
};

/// The beginning of the topics of alerts.
const ALERTS: &str = "alerts/";
/// The pattern of the topics of all alerts of a robot.
pub const TOPICS: &str = "alerts/*";
/// The maximum length of a text, in bytes; longer ones are cut.
const MAX_TEXT: usize = 500;
/// The maximum length of the name of an alert, in bytes.
const MAX_NAME: usize = 60;

/// Something that is wrong with a robot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Alert {
    /// The problem, for people.
    pub text: String,
    /// How important it is.
    #[serde(default)]
    pub level: Level,
    /// Since when, in milliseconds since 1970 by the clock of the robot.
    pub at: u64,
    /// The program that has raised it; empty if it has no name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub program: String,
}

impl Alert {
    /// Returns the alert as bytes.
    pub fn write(&self) -> Payload {
        let json = serde_json::to_vec(self).unwrap_or_default();
        Payload::new(json, Encoding::JSON)
    }

    /// Reads the value of a topic; `None` if it is not an alert.
    pub fn read(topic: &Topic, payload: &Payload) -> Option<Self> {
        topic.as_str().strip_prefix(ALERTS)?;
        let alert: Self = serde_json::from_slice(&payload.bytes).ok()?;
        Some(Self {
            text: clean::word(&alert.text, MAX_TEXT),
            program: clean::word(&alert.program, MAX_NAME),
            ..alert
        })
    }
}

/// Returns the topic of the alert with a name or text: `battery low` has `alerts/battery-low`.
///
/// # Errors
/// Fails if it has neither a letter nor a digit.
pub fn topic(text: &str) -> Result<Topic, TopicError> {
    let lower = text.to_lowercase();
    let words = lower.split(|c: char| !c.is_alphanumeric());
    let mut name = String::new();
    for word in words.filter(|word| !word.is_empty()) {
        if name.len() + 1 + word.len() > MAX_NAME && !name.is_empty() {
            break;
        }
        if !name.is_empty() {
            name.push('-');
        }
        name.extend(word.chars().take(MAX_NAME / 4));
    }
    if name.is_empty() {
        return Err(TopicError::Invalid {
            topic: text.chars().take(MAX_NAME).collect(),
            reason: "an alert is a text with letters or digits, such as `battery low`".to_owned(),
        });
    }
    Topic::new(&format!("{ALERTS}{name}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_topic_of_an_alert_is_its_text_in_words() {
        for (text, expected) in [
            ("battery low", "alerts/battery-low"),
            ("Motor 2: too hot!", "alerts/motor-2-too-hot"),
            ("温度 /*@", "alerts/温度"),
        ] {
            assert_eq!(topic(text).expect(text).as_str(), expected);
        }
        let long = topic(&"word ".repeat(100)).expect("long");
        assert!(long.as_str().len() <= ALERTS.len() + MAX_NAME, "{long}");
        assert!(topic("?!").is_err());
    }

    #[test]
    fn an_alert_is_read_as_it_was_written_without_control_characters() {
        let alert = Alert {
            text: "battery\x1b[31m low".to_owned(),
            level: Level::Warn,
            at: 5,
            program: "arm".to_owned(),
        };
        let topic = topic("battery").expect("topic");
        let read = Alert::read(&topic, &alert.write()).expect("an alert");
        assert_eq!(read.text, "battery low");
        assert_eq!(read.level, Level::Warn);
        let other = Topic::new("mode").expect("topic");
        assert_eq!(Alert::read(&other, &alert.write()), None);
    }
}

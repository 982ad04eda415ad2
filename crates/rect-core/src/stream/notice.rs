//! Encodes the notice of a stream as JSON. The sender returns it to receivers that query it, which also measures the
//! offset of their clocks, and publishes it when robots change groups.
use serde::{Deserialize, Serialize};

use super::Group;

/// The maximum length of a notice that is decoded, in bytes.
pub const MAX_BYTES: usize = 8192;
/// The maximum number of robots named per group. Robots that are not named keep their group.
pub const MAX_NAMES: usize = 64;

/// The sender's description of a stream.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notice {
    /// Time of the sender's clock, in milliseconds since 1970. Frames contain its low 16 bits.
    pub time_ms: u64,
    /// Group that new receivers join, unless their robot is named.
    #[serde(default)]
    pub join: Group,
    /// Interval at which receivers send feedback, in milliseconds. 0 for no feedback. Default: 500.
    #[serde(default = "default_feedback_ms")]
    pub feedback_ms: u32,
    /// Robots in the main group.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub main: Vec<String>,
    /// Robots in the slow group.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub slow: Vec<String>,
}

fn default_feedback_ms() -> u32 {
    500
}

/// The bytes are not a valid notice.
#[derive(Debug, thiserror::Error)]
pub enum NoticeError {
    /// The notice is too long.
    #[error("a stream's notice of {0} bytes is too long: at most {MAX_BYTES} bytes are allowed")]
    Length(usize),
    /// The notice is not JSON, or does not have the expected shape.
    #[error("not a valid notice of a stream")]
    Json(#[from] serde_json::Error),
}

impl Notice {
    /// Decodes an untrusted notice.
    ///
    /// # Errors
    /// Returns a [`NoticeError`] if the bytes are not a valid notice.
    pub fn decode(bytes: &[u8]) -> Result<Self, NoticeError> {
        if bytes.len() > MAX_BYTES {
            return Err(NoticeError::Length(bytes.len()));
        }
        Ok(serde_json::from_slice(bytes)?)
    }

    /// Encodes the notice as JSON.
    pub fn encode(&self) -> Vec<u8> {
        // This cannot fail: it consists of numbers and names only.
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Returns the group of a robot. `None` if the robot is not named.
    pub fn group_of(&self, robot: &str) -> Option<Group> {
        let is_in = |names: &[String]| names.iter().any(|name| name == robot);
        match (is_in(&self.main), is_in(&self.slow)) {
            (true, _) => Some(Group::Main),
            (false, true) => Some(Group::Slow),
            (false, false) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notices_round_trip_and_are_short_without_groups() {
        let notice = Notice {
            time_ms: 1_795_000_000_000,
            feedback_ms: 500,
            ..Notice::default()
        };
        let bytes = notice.encode();
        assert!(bytes.len() < 70, "{}", String::from_utf8_lossy(&bytes));
        assert_eq!(Notice::decode(&bytes).expect("read"), notice);
        let with_groups = Notice {
            main: vec!["laptop".into()],
            slow: vec!["wombat-2".into()],
            join: Group::Slow,
            ..notice
        };
        let read = Notice::decode(&with_groups.encode()).expect("read");
        assert_eq!(read.group_of("laptop"), Some(Group::Main));
        assert_eq!(read.group_of("wombat-2"), Some(Group::Slow));
        assert_eq!(read.group_of("other"), None);
    }

    #[test]
    fn invalid_notices_are_rejected() {
        for wrong in ["", "{}", "{\"time_ms\":-1}", "{\"time_ms\":1,\"slow\":3}"] {
            assert!(Notice::decode(wrong.as_bytes()).is_err(), "{wrong}");
        }
        assert!(Notice::decode(&vec![b' '; MAX_BYTES + 1]).is_err());
    }
}

//! Owns what a sender says of its stream, as JSON: on the question of a receiver (whose clock learns from it), and to all
//! when robots change groups.
use serde::{Deserialize, Serialize};

use super::Group;

/// The longest that is read, in bytes.
pub const MAX_BYTES: usize = 8192;
/// The most robots that are named of each group; who is not named stays where it is.
pub const MAX_NAMES: usize = 64;

/// What a sender says.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notice {
    /// Its clock, in milliseconds since 1970; the low 16 bits of it go with each frame.
    pub time_ms: u64,
    /// Where a receiver listens that is not named.
    #[serde(default)]
    pub join: Group,
    /// How often receivers are to say what came, in milliseconds.
    #[serde(default = "half_a_second")]
    pub feedback_ms: u32,
    /// The robots that listen to the stream's own key.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub main: Vec<String>,
    /// The robots that listen to the slow group's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub slow: Vec<String>,
}

fn half_a_second() -> u32 {
    500
}

/// It is no such notice.
#[derive(Debug, thiserror::Error)]
pub enum NoticeError {
    /// Longer than any.
    #[error("a stream's notice of {0} bytes is too long: {MAX_BYTES} are the most")]
    Length(usize),
    /// Not JSON, or not of this shape.
    #[error("this is no stream's notice")]
    Json(#[from] serde_json::Error),
}

impl Notice {
    /// From bytes of whoever sent them.
    ///
    /// # Errors
    /// They are something else.
    pub fn decode(bytes: &[u8]) -> Result<Self, NoticeError> {
        if bytes.len() > MAX_BYTES {
            return Err(NoticeError::Length(bytes.len()));
        }
        Ok(serde_json::from_slice(bytes)?)
    }

    /// As JSON.
    pub fn encode(&self) -> Vec<u8> {
        // Numbers and names only: there is nothing in it that JSON can't say.
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Where the robot of that name is to listen; `None`: it is not named.
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
    fn it_comes_back_and_is_short_while_there_is_nothing_to_say() {
        let notice = Notice {
            time_ms: 1_795_000_000_000,
            feedback_ms: 500,
            ..Notice::default()
        };
        let bytes = notice.encode();
        assert!(bytes.len() < 70, "{}", String::from_utf8_lossy(&bytes));
        assert_eq!(Notice::decode(&bytes).expect("read"), notice);
        let parted = Notice {
            main: vec!["laptop".into()],
            slow: vec!["wombat-2".into()],
            join: Group::Slow,
            ..notice
        };
        let read = Notice::decode(&parted.encode()).expect("read");
        assert_eq!(read.group_of("laptop"), Some(Group::Main));
        assert_eq!(read.group_of("wombat-2"), Some(Group::Slow));
        assert_eq!(read.group_of("other"), None);
    }

    #[test]
    fn what_is_something_else_is_refused() {
        for wrong in ["", "{}", "{\"time_ms\":-1}", "{\"time_ms\":1,\"slow\":3}"] {
            assert!(Notice::decode(wrong.as_bytes()).is_err(), "{wrong}");
        }
        assert!(Notice::decode(&vec![b' '; MAX_BYTES + 1]).is_err());
    }
}

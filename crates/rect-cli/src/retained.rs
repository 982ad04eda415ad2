//! Describes retained messages: where their values are kept, how old they are, and whether their programs have ended.
use std::time::Duration;

use clap::ValueEnum;
use rect::{Retained, Robot};
use rect_core::text::humanize::duration;
use serde_json::json;

/// The age from which on the age of a value is shown beside it. A younger one has just been published.
const SHOWN_FROM: Duration = Duration::from_secs(1);

/// Where the router keeps a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Place {
    Memory,
    Disk,
}

impl Place {
    /// Returns a handle of `robot` whose values are kept there.
    pub fn handle(self, robot: &Robot) -> Robot {
        match self {
            Self::Memory => robot.retained(),
            Self::Disk => robot.retained_on_disk(),
        }
    }
}

/// Returns what is special about a retained message: `retained, 3 s ago, its program has ended`.
pub fn words(retained: &Retained) -> String {
    let mut words = match retained.is_forgotten {
        true => "forgotten".to_owned(),
        false => "retained".to_owned(),
    };
    if retained.age > SHOWN_FROM {
        words += &format!(", {}", age(retained));
    }
    words + ended(retained)
}

/// Returns the end of a description: whether the program has ended.
pub fn ended(retained: &Retained) -> &'static str {
    match retained.has_ended {
        true => ", its program has ended",
        false => "",
    }
}

/// Returns the age of a value: `3 s ago`.
pub fn age(retained: &Retained) -> String {
    format!("{} ago", duration(retained.age))
}

/// Returns the description of a retained message as JSON.
pub fn json(retained: &Retained) -> serde_json::Value {
    json!({
        "age_s": retained.age.as_secs_f64(),
        "has_ended": retained.has_ended,
        "is_forgotten": retained.is_forgotten,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn age_is_shown_from_one_second_on() {
        let mut retained = Retained {
            age: Duration::from_secs(1),
            has_ended: false,
            is_forgotten: false,
        };
        assert_eq!(words(&retained), "retained");
        retained.age = Duration::from_millis(1001);
        assert_eq!(words(&retained), "retained, 1 s ago");
        retained.has_ended = true;
        retained.age = Duration::from_secs(180);
        assert_eq!(
            words(&retained),
            "retained, 3 min ago, its program has ended"
        );
        retained.is_forgotten = true;
        retained.has_ended = false;
        assert_eq!(words(&retained), "forgotten, 3 min ago");
    }
}

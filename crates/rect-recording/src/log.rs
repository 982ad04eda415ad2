//! Decides how the lines that programs log are recorded, and shown in viewers: as `foxglove.Log`, which log panels show.
use rect_core::{
    log::{level::Level, line::Line, page::Kept},
    name::{key::OWN, Name},
};
use serde::Serialize;
use serde_json::{Map, Value};

use crate::schema::Schema;

/// The subject of lines.
pub const LOG: &str = "log";
/// The schema, which viewers know by its name.
const SCHEMA: &str = include_str!("log/schema.json");
/// The text for lines that were missed.
const MISSED: &str = "lines were missed: the program logs faster than the link carries";

/// The form of a line in a recording.
#[derive(Debug, Serialize)]
struct LogReport<'a> {
    timestamp: Timestamp,
    level: u8,
    message: &'a str,
    /// `<program>/<logger>`, or the program.
    name: String,
    file: &'a str,
    line: u32,
    /// Not part of the schema.
    #[serde(skip_serializing_if = "Map::is_empty")]
    fields: Map<String, Value>,
}

#[derive(Debug, Serialize)]
struct Timestamp {
    sec: u32,
    nsec: u32,
}

/// Returns the topic of the lines of a robot in recordings and viewers. No message has such a topic.
pub fn topic(robot: &Name) -> String {
    format!("{robot}/{OWN}/{LOG}")
}

/// Returns whether a recorded topic is that of the lines of a robot.
pub fn is_log(topic: &str) -> bool {
    let rest = topic.split_once('/').map(|(_, rest)| rest);
    let subject = rest.and_then(|rest| rest.strip_prefix(OWN));
    subject.and_then(|subject| subject.strip_prefix('/')) == Some(LOG)
}

/// Returns the schema of lines.
pub fn schema() -> Schema {
    Schema {
        name: "foxglove.Log".to_owned(),
        encoding: "jsonschema".into(),
        text: SCHEMA.as_bytes().to_vec(),
    }
}

/// Returns a line in the form of the schema, as JSON.
pub fn message(kept: &Kept) -> Vec<u8> {
    let Kept { program, line, .. } = kept;
    let name = match line.logger.as_str() {
        "" => program.clone(),
        logger => format!("{program}/{logger}"),
    };
    let place = line.source.rsplit_once(':');
    let place = place.and_then(|(file, number)| Some((file, number.parse().ok()?)));
    let (file, number) = place.unwrap_or((&line.source, 0));
    let report = LogReport {
        timestamp: Timestamp {
            sec: u32::try_from(line.at / 1000).unwrap_or(u32::MAX),
            nsec: u32::try_from(line.at % 1000 * 1_000_000).unwrap_or_default(),
        },
        level: match line.level {
            Level::Debug => 1,
            Level::Info => 2,
            Level::Warn => 3,
            Level::Error => 4,
        },
        message: &line.text,
        name,
        file,
        line: number,
        fields: line.fields.clone().into_iter().collect(),
    };
    // Texts and numbers can always be written.
    serde_json::to_vec(&report).unwrap_or_default()
}

/// Returns the line that says that lines of a robot were missed.
pub fn missed(now_ms: u64) -> Kept {
    Kept {
        number: 0,
        program: "rect".to_owned(),
        line: Line::new(now_ms, Level::Warn, MISSED),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn written(line: Line) -> Value {
        let kept = Kept {
            number: 1,
            program: "arm".to_owned(),
            line,
        };
        serde_json::from_slice(&message(&kept)).expect("JSON")
    }

    #[test]
    fn a_line_has_the_form_that_viewers_know() {
        let line = Line {
            logger: "driver".to_owned(),
            fields: [("angle".to_owned(), json!(12.5))].into(),
            source: "src/arm.py:12".to_owned(),
            ..Line::new(1_795_000_000_123, Level::Error, "Traceback:\n  too hot")
        };
        let expected = json!({
            "timestamp": {"sec": 1_795_000_000, "nsec": 123_000_000},
            "level": 4,
            "message": "Traceback:\n  too hot",
            "name": "arm/driver",
            "file": "src/arm.py",
            "line": 12,
            "fields": {"angle": 12.5},
        });
        assert_eq!(written(line), expected);
    }

    #[test]
    fn a_place_without_a_number_and_a_clock_that_is_centuries_off_are_written() {
        let line = Line {
            source: "main".to_owned(),
            ..Line::new(u64::MAX, Level::Debug, "")
        };
        let value = written(line);
        assert_eq!(
            (&value["file"], &value["line"]),
            (&json!("main"), &json!(0))
        );
        assert_eq!(value["timestamp"]["sec"], json!(u32::MAX));
    }

    #[test]
    fn only_the_topic_of_lines_is_recognised() {
        let robot = Name::new("wombat-1").expect("a name");
        assert!(is_log(&topic(&robot)));
        for other in [
            "wombat-1/log",
            "wombat-1/@rect/logs",
            "@rect/log",
            "wombat-1/@rect/link/log",
        ] {
            assert!(!is_log(other), "{other}");
        }
    }
}

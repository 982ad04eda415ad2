//! Owns what is said to people in several places: an error and what caused it, as one line; short times.

use std::{error::Error, time::Duration};

/// The longest reason that is shown where there is room for one line, in characters.
const REASON_CHARACTERS: usize = 120;

/// The error and its causes, outermost first. A cause that its effect already quotes is not said again.
pub fn with_causes(error: &(dyn Error + 'static)) -> String {
    let mut text = for_people(&error.to_string());
    let mut cause = error.source();
    while let Some(error) = cause {
        let next = for_people(&error.to_string());
        if !text.contains(next.trim_end_matches('.')) {
            text = format!("{}: {next}", text.trim_end_matches(['.', ':']));
        }
        cause = error.source();
    }
    text
}

/// Returns an error's text on one line, without the places in Zenoh's source code that it names.
pub fn on_one_line(error: &str) -> String {
    for_people(error)
}

/// A short time, in so many milliseconds.
pub fn milliseconds(ms: f64) -> String {
    let decimals = usize::from(ms < 10.0);
    format!("{ms:.decimals$} ms")
}

/// A duration, rounded for people: `85 ms`, `4.2 s`, `64 s`, `3 min`, `2 h`.
pub fn duration(time: Duration) -> String {
    let s = time.as_secs_f64();
    if time < Duration::from_millis(1) && !time.is_zero() {
        return format!("{:.1} ms", s * 1000.0);
    }
    if s < 0.9995 && !time.is_zero() {
        return format!("{:.0} ms", s * 1000.0);
    }
    if s < 9.95 {
        return format!("{s:.1} s").replace(".0 s", " s");
    }
    match s {
        s if s < 119.5 => format!("{s:.0} s"),
        s if s < 7_170.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} h", s / 3600.0),
    }
}

/// The same of a number of seconds, of which others decide; one that is no duration is shown as `-`.
pub fn duration_of_s(seconds: f64) -> String {
    Duration::try_from_secs_f64(seconds).map_or_else(|_| "-".to_owned(), duration)
}

/// A number of bytes, rounded for people: `512 B`, `12 kB`, `3 MB`.
pub fn bytes(count: u64) -> String {
    match count {
        0..=9_999 => format!("{count} B"),
        10_000..=9_999_999 => format!("{} kB", count / 1_000),
        _ => format!("{} MB", count / 1_000_000),
    }
}

/// The part of an error's text that tells a person what went wrong: without places in source code and without the steps
/// that only repeat that something failed, at most 120 characters.
pub fn short_reason(error: &str) -> String {
    let text = for_people(error);
    // Zenoh's errors are a chain from the outermost step to the cause, `...: cause`, of which steps may say the same.
    let mut parts: Vec<&str> = Vec::new();
    for part in text.split(": ").map(|part| part.trim_end_matches('.')) {
        if !part.is_empty() && !parts.contains(&part) {
            parts.push(part);
        }
    }
    let mut short = parts.join(": ");
    while short.chars().count() > REASON_CHARACTERS && parts.len() > 1 {
        parts.remove(0);
        short = parts.join(": ");
    }
    if short.chars().count() > REASON_CHARACTERS {
        short = short.chars().take(REASON_CHARACTERS - 1).collect();
        short.truncate(short.rfind(' ').unwrap_or(short.len()));
        short.push('\u{2026}');
    }
    short
}

/// On one line, and without the place in Zenoh's source code, ` at /path/file.rs:123.`, that each step carries: a person
/// has no use for it.
fn for_people(error: &str) -> String {
    let mut text = String::with_capacity(error.len());
    let mut words = error.split_whitespace().peekable();
    while let Some(word) = words.next() {
        match (word, words.peek().and_then(|next| after_source_line(next))) {
            ("at", Some(rest)) => {
                text.push_str(rest);
                words.next();
            }
            _ => {
                if !text.is_empty() {
                    text.push(' ');
                }
                text.push_str(word);
            }
        }
    }
    text.replace(" - Caused by ", ": ")
}

/// What follows in the word after `/path/file.rs:123.`, if it is such a place.
fn after_source_line(word: &str) -> Option<&str> {
    let (_, line) = word.split_once(".rs:")?;
    let rest = line.trim_start_matches(|c: char| c.is_ascii_digit());
    (rest.len() < line.len()).then(|| rest.trim_start_matches('.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{said}")]
    struct Said {
        said: &'static str,
        source: Option<Box<Said>>,
    }

    #[test]
    fn times_are_as_short_as_they_are_telling() {
        let shown = [0.043, 9.94, 83.2].map(milliseconds);
        assert_eq!(shown, ["0.0 ms", "9.9 ms", "83 ms"]);
    }

    #[test]
    fn durations_are_rounded_for_people() {
        for (seconds, shown) in [
            (0.0, "0 s"),
            (0.0004, "0.4 ms"),
            (0.2, "200 ms"),
            (0.9999, "1 s"),
            (2.0, "2 s"),
            (4.198_282_544, "4.2 s"),
            (9.97, "10 s"),
            (64.4, "64 s"),
            (180.0, "3 min"),
            (7_200.0, "2 h"),
        ] {
            assert_eq!(duration(Duration::from_secs_f64(seconds)), shown);
        }
        assert_eq!(duration_of_s(-1.0), "-");
        assert_eq!(
            [9_999, 10_000, 12_345_678].map(bytes),
            ["9999 B", "10 kB", "12 MB"]
        );
    }

    #[test]
    fn a_reason_fits_one_line_and_has_no_place_in_source_code() {
        let refused = "Can not create a new TCP link bound to tcp/127.0.0.1:7447: [tcp/127.0.0.1:7447: Connection refused (os error 111) \
            at /root/.cargo/registry/src/x/zenoh-link-commons-1.10.2/src/tcp.rs:61.] at /root/.cargo/registry/src/x/src/unicast.rs:334.";
        let short = short_reason(refused);
        assert!(short.contains("Connection refused"), "{short}");
        assert!(
            !short.contains(".rs") && short.chars().count() <= REASON_CHARACTERS,
            "{short}"
        );
        let long = "word ".repeat(100);
        let short = short_reason(&long);
        assert!(
            short.chars().count() <= REASON_CHARACTERS && short.ends_with("word\u{2026}"),
            "{short}"
        );
        assert_eq!(short_reason("no answer"), "no answer");
        assert_eq!(short_reason(""), "");
    }

    #[test]
    fn places_in_the_source_are_left_out_and_causes_kept() {
        let zenoh = "Can not create a new TCP listener at /root/.cargo/registry/src/x/zenoh-link-tcp-1.10.2/src/unicast.rs:380. - Caused by Address already in use (os error 98)";
        let error = Said {
            said: zenoh,
            source: None,
        };
        assert_eq!(
            with_causes(&error),
            "Can not create a new TCP listener: Address already in use (os error 98)"
        );
    }

    #[test]
    fn a_message_of_several_lines_becomes_one() {
        let zenoh = "no listener: [in use at /src/tcp.rs:61.]\n  at all";
        let error = Said {
            said: zenoh,
            source: None,
        };
        assert_eq!(with_causes(&error), "no listener: [in use] at all");
    }

    #[test]
    fn a_cause_is_said_once() {
        let inner = |said| Some(Box::new(Said { said, source: None }));
        let quoting = Said {
            said: "no radio: hci0 is off",
            source: inner("hci0 is off"),
        };
        assert_eq!(with_causes(&quoting), "no radio: hci0 is off");
        let plain = Said {
            said: "no radio",
            source: inner("hci0 is off"),
        };
        assert_eq!(with_causes(&plain), "no radio: hci0 is off");
    }

    #[test]
    fn ordinary_words_stay() {
        let error = Said {
            said: "meet me at ble/x:1. at noon",
            source: None,
        };
        assert_eq!(with_causes(&error), "meet me at ble/x:1. at noon");
    }
}

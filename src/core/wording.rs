//! Owns what is said to people in several places: an error and what caused it, as one line; short times.

use std::error::Error;

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

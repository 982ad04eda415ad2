//! Formats errors, durations and sizes for people.

use std::{borrow::Cow, error::Error, time::Duration};

/// The maximum length of a reason that must fit one line, in characters.
const REASON_CHARACTERS: usize = 120;

/// Returns an error and its causes as one line, outermost first. A cause that an outer error already quotes is not
/// repeated.
pub fn with_causes(error: &(dyn Error + 'static)) -> String {
    let mut text = clean_up(&error.to_string());
    let mut cause = error.source();
    while let Some(error) = cause {
        let next = clean_up(&error.to_string());
        if !text.contains(next.trim_end_matches('.')) {
            text = format!("{}: {next}", text.trim_end_matches(['.', ':']));
        }
        cause = error.source();
    }
    text
}

/// Returns the causes of an error, outermost first, each as one line.
pub fn causes<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = String> + 'a {
    std::iter::successors(error.source(), |&cause| cause.source())
        .map(|cause| clean_up(&cause.to_string()))
}

/// Returns an error's text as one line, without the source locations that Zenoh adds.
pub fn on_one_line(error: &str) -> String {
    clean_up(error)
}

/// Formats a number of milliseconds: `9.9 ms`, `83 ms`.
pub fn milliseconds(ms: f64) -> String {
    let decimals = usize::from(ms < 10.0);
    format!("{ms:.decimals$} ms")
}

/// Formats a duration, rounded: `85 ms`, `4.2 s`, `64 s`, `3 min`, `2 h`.
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

/// Formats a number of seconds from an untrusted source. Returns `-` if it is not a valid duration.
pub fn duration_of_s(seconds: f64) -> String {
    Duration::try_from_secs_f64(seconds).map_or_else(|_| "-".to_owned(), duration)
}

/// Formats a number of bytes, rounded down: `512 B`, `12 kB`, `3 MB`.
pub fn bytes(count: u64) -> String {
    match count {
        0..=9_999 => format!("{count} B"),
        10_000..=9_999_999 => format!("{} kB", count / 1_000),
        _ => format!("{} MB", count / 1_000_000),
    }
}

/// Returns the essential part of an error's text, in at most 120 characters: without source locations and repeated
/// steps. If the text is still too long, the outermost steps are removed first, and then its end.
pub fn short_reason(error: &str) -> String {
    let text = clean_up(error);
    // Zenoh's errors are chains from the outermost step to the cause, `...: cause`, in which steps may repeat each
    // other.
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

/// Puts the text on one line and removes Zenoh's source locations, ` at /path/file.rs:123.`, which do not help users.
fn clean_up(error: &str) -> String {
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

/// Returns a text without the source locations that Zenoh adds to its errors, ` at /path/file.rs:123.`: they are paths of the computer
/// on which the program was built. Everything else stays as it is, also the locations of a panic, `file.rs:123:45`.
pub fn without_locations(text: &str) -> Cow<'_, str> {
    const AT: &str = " at ";
    if !text.contains(".rs:") {
        return text.into();
    }
    let (mut kept, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(begin) = rest.find(AT) {
        let (before, word) = (&rest[..begin], &rest[begin + AT.len()..]);
        let end = word.find(char::is_whitespace).unwrap_or(word.len());
        kept.push_str(before);
        match after_source_line(&word[..end]).filter(|after| !after.starts_with(':')) {
            Some(after) => kept.push_str(after),
            None => {
                kept.push_str(AT);
                kept.push_str(&word[..end]);
            }
        }
        rest = &word[end..];
    }
    kept.push_str(rest);
    kept.into()
}

/// Returns the rest of the word after `/path/file.rs:123.`, if the word is such a location.
fn after_source_line(word: &str) -> Option<&str> {
    let (_, line) = word.split_once(".rs:")?;
    let rest = line.trim_start_matches(|c: char| c.is_ascii_digit());
    (rest.len() < line.len()).then(|| rest.trim_start_matches('.'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("{text}")]
    struct TestError {
        text: &'static str,
        source: Option<Box<TestError>>,
    }

    #[test]
    fn source_locations_of_errors_are_removed_and_those_of_panics_stay() {
        let line = "WARN  net-1 zenoh: cannot open x: refused at /root/.cargo/src/lib.rs:62. at /b/c.rs:7.\n";
        assert_eq!(
            without_locations(line),
            "WARN  net-1 zenoh: cannot open x: refused\n"
        );
        let more = "error=it failed at /a/b.rs:3. - Caused by no at y.rs at 12:30  (file.rs:1)\n";
        let kept = "error=it failed - Caused by no at y.rs at 12:30  (file.rs:1)\n";
        assert_eq!(without_locations(more), kept);
        for same in [
            "thread main: panicked at crates/a/src/lib.rs:68:5:\nno\n",
            "      at ./src/main.rs:7:1\n",
            "listening at tcp/127.0.0.1:7447",
            "ends with at ",
        ] {
            assert_eq!(without_locations(same), same);
        }
    }

    #[test]
    fn milliseconds_have_decimals_below_ten() {
        let shown = [0.043, 9.94, 83.2].map(milliseconds);
        assert_eq!(shown, ["0.0 ms", "9.9 ms", "83 ms"]);
    }

    #[test]
    fn durations_and_sizes_are_rounded() {
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
    fn short_reasons_fit_one_line_and_have_no_source_location() {
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
    fn removes_source_locations_and_keeps_causes() {
        let zenoh = "Can not create a new TCP listener at /root/.cargo/registry/src/x/zenoh-link-tcp-1.10.2/src/unicast.rs:380. - Caused by Address already in use (os error 98)";
        let error = TestError {
            text: zenoh,
            source: None,
        };
        assert_eq!(
            with_causes(&error),
            "Can not create a new TCP listener: Address already in use (os error 98)"
        );
    }

    #[test]
    fn joins_lines() {
        let zenoh = "no listener: [in use at /src/tcp.rs:61.]\n  at all";
        let error = TestError {
            text: zenoh,
            source: None,
        };
        assert_eq!(with_causes(&error), "no listener: [in use] at all");
    }

    #[test]
    fn does_not_repeat_a_cause() {
        let inner = |text| Some(Box::new(TestError { text, source: None }));
        let quoting = TestError {
            text: "no radio: hci0 is off",
            source: inner("hci0 is off"),
        };
        assert_eq!(with_causes(&quoting), "no radio: hci0 is off");
        let plain = TestError {
            text: "no radio",
            source: inner("hci0 is off"),
        };
        assert_eq!(with_causes(&plain), "no radio: hci0 is off");
    }

    #[test]
    fn causes_are_listed_from_the_outermost_to_the_innermost() {
        let cause = |text, source: Option<TestError>| {
            let source = source.map(Box::new);
            TestError { text, source }
        };
        let off = cause("hci0 is off at /src/radio.rs:7.", None);
        let error = cause("no link", Some(cause("no radio", Some(off))));
        let all: Vec<_> = causes(&error).collect();
        assert_eq!(all, ["no radio", "hci0 is off"]);
        assert_eq!(causes(&cause("no link", None)).count(), 0);
    }

    #[test]
    fn ordinary_text_is_unchanged() {
        let error = TestError {
            text: "meet me at ble/x:1. at noon",
            source: None,
        };
        assert_eq!(with_causes(&error), "meet me at ble/x:1. at noon");
    }
}

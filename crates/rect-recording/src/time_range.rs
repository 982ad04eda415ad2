//! Parses the range of time of a query, in Zenoh's notation.
//!
//! `[<start>..<end>]` is a range, and `[<start>;<duration>]` is short for `[<start>..<start + duration>]`. A bound is excluded
//! if its bracket is turned outwards: `]` before the start, `[` after the end. In a range, either bound may be left out.
//!
//! A time is `now()`, `now(<duration>)`, `now(-<duration>)`, or a date and time in UTC such as `2026-11-28T14:03:07.5Z`. A
//! duration is a number with a unit (`u` for microseconds, `ms`, `s`, `m`, `h`, `d`, `w`); without one it is in seconds.
use std::{ops::Bound, time::Duration};

/// The maximum length of a range, in bytes.
const MAX_BYTES: usize = 128;
/// The maximum duration, a thousand years. It keeps all times within the range of [`Duration`].
const MAX_DURATION: Duration = Duration::from_secs(1000 * 365 * DAY_S);
/// The years that a date may have.
const YEARS: std::ops::RangeInclusive<u64> = 1970..=9999;
const DAY_S: u64 = 24 * 3600;
/// The units of durations in seconds. `ms` is before `s` and `m`, which it ends and begins with.
const UNITS: [(&str, f64); 7] = [
    ("ms", 1e-3),
    ("u", 1e-6),
    ("s", 1.0),
    ("m", 60.0),
    ("h", 3600.0),
    ("d", DAY_S as f64),
    ("w", 7.0 * DAY_S as f64),
];

/// A range of time. The bounds are durations since 1970; earlier times count as 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TimeRange {
    /// The beginning.
    pub start: Bound<Duration>,
    /// The end.
    pub end: Bound<Duration>,
}

/// The text is not a range of time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TimeRangeError {
    /// The text is longer than any range.
    #[error("it is longer than {MAX_BYTES} bytes")]
    Length,
    /// A bracket is missing.
    #[error("it must begin and end with a bracket, such as [now(-10s)..]")]
    Bracket,
    /// The separator is missing.
    #[error("it needs `..` between its bounds, or `;` before its duration")]
    Separator,
    /// A time has another form.
    #[error("{0:?} is not a time such as now(-10s) or 2026-11-28T14:03:07Z")]
    Time(String),
    /// A duration has another form, or is too long.
    #[error("{0:?} is not a duration such as 10s or 1.5h, of at most a thousand years")]
    Duration(String),
}

impl TimeRange {
    /// Parses a range. `now` is the time that `now()` stands for, since 1970.
    ///
    /// # Errors
    /// Returns an error that names the part which is not valid.
    pub fn parse(text: &str, now: Duration) -> Result<Self, TimeRangeError> {
        if text.len() > MAX_BYTES {
            return Err(TimeRangeError::Length);
        }
        let (includes_start, inner) = match text.split_at_checked(1) {
            Some(("[", inner)) => (true, inner),
            Some(("]", inner)) => (false, inner),
            _ => return Err(TimeRangeError::Bracket),
        };
        let (includes_end, inner) = match (inner.strip_suffix(']'), inner.strip_suffix('[')) {
            (Some(inner), _) => (true, inner),
            (_, Some(inner)) => (false, inner),
            _ => return Err(TimeRangeError::Bracket),
        };
        let (start, end) = if let Some((start, end)) = inner.split_once("..") {
            (bound(start, now)?, bound(end, now)?)
        } else if let Some((start, lasts)) = inner.split_once(';') {
            let start = time(start, now)?;
            let end = start.saturating_add(duration(lasts)?);
            (Some(start), Some(end))
        } else {
            return Err(TimeRangeError::Separator);
        };
        let bound = |time: Option<Duration>, is_included| match time {
            Some(time) if is_included => Bound::Included(time),
            Some(time) => Bound::Excluded(time),
            None => Bound::Unbounded,
        };
        Ok(Self {
            start: bound(start, includes_start),
            end: bound(end, includes_end),
        })
    }
}

fn bound(text: &str, now: Duration) -> Result<Option<Duration>, TimeRangeError> {
    match text {
        "" => Ok(None),
        text => time(text, now).map(Some),
    }
}

fn time(text: &str, now: Duration) -> Result<Duration, TimeRangeError> {
    let offset = text
        .strip_prefix("now(")
        .and_then(|rest| rest.strip_suffix(')'));
    match offset {
        Some("") => Ok(now),
        Some(offset) => match offset.strip_prefix('-') {
            Some(before) => Ok(now.saturating_sub(duration(before)?)),
            None => Ok(now.saturating_add(duration(offset)?)),
        },
        None => date_time(text).ok_or_else(|| TimeRangeError::Time(text.to_owned())),
    }
}

fn duration(text: &str) -> Result<Duration, TimeRangeError> {
    let unit = UNITS
        .iter()
        .find_map(|(unit, seconds)| Some((text.strip_suffix(unit)?, *seconds)));
    let (number, seconds) = unit.unwrap_or((text, 1.0));
    let value = number.parse::<f64>().ok();
    let parsed = value.and_then(|value| Duration::try_from_secs_f64(value * seconds).ok());
    let parsed = parsed.filter(|parsed| *parsed <= MAX_DURATION);
    parsed.ok_or_else(|| TimeRangeError::Duration(text.to_owned()))
}

/// Parses `<year>-<month>-<day>T<hour>:<minute>:<second>`, optionally with a fraction of the second and a `Z`. A space may
/// stand for the `T`.
fn date_time(text: &str) -> Option<Duration> {
    let text = text.strip_suffix('Z').unwrap_or(text);
    let (whole, fraction) = text.split_once('.').unwrap_or((text, "0"));
    let (date, of_day) = whole.split_once(['T', ' '])?;
    let [year, month, day] = numbers(date, '-', [4, 2, 2])?;
    let [hour, minute, second] = numbers(of_day, ':', [2, 2, 2])?;
    let is_valid = YEARS.contains(&year)
        && (1..=12).contains(&month)
        && (1..=days_of_month(year, month)).contains(&day)
        && hour < 24
        && minute < 60
        // A leap second, which counts as the one before it.
        && second <= 60;
    if !is_valid {
        return None;
    }
    let days_of_years: u64 = (*YEARS.start()..year).map(days_of_year).sum();
    let days_of_months: u64 = (1..month).map(|month| days_of_month(year, month)).sum();
    let days = days_of_years + days_of_months + day - 1;
    let seconds = days * DAY_S + hour * 3600 + minute * 60 + second.min(59);
    Some(Duration::new(seconds, nanoseconds(fraction)?))
}

/// Parses numbers that have exactly these digits.
fn numbers(text: &str, separator: char, digits: [usize; 3]) -> Option<[u64; 3]> {
    let mut parts = text.split(separator);
    let mut found = [0; 3];
    for (number, digits) in found.iter_mut().zip(digits) {
        let part = parts.next().filter(|part| part.len() == digits)?;
        *number = decimal(part)?;
    }
    parts.next().is_none().then_some(found)
}

fn nanoseconds(fraction: &str) -> Option<u32> {
    let missing = 9usize.checked_sub(fraction.len())?;
    let value = u32::try_from(decimal(fraction)?).ok()?;
    Some(value * 10u32.pow(missing as u32))
}

/// Parses digits, without the sign that `parse` allows.
fn decimal(text: &str) -> Option<u64> {
    let is_decimal = text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|_| is_decimal)
}

fn days_of_year(year: u64) -> u64 {
    (1..=12).map(|month| days_of_month(year, month)).sum()
}

fn days_of_month(year: u64, month: u64) -> u64 {
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    match month {
        2 if is_leap => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::from_secs(1_000_000_000);

    fn range(text: &str) -> Result<TimeRange, TimeRangeError> {
        TimeRange::parse(text, NOW)
    }

    fn at(text: &str) -> Option<Duration> {
        match range(&format!("[{text}..]")).ok()?.start {
            Bound::Included(time) => Some(time),
            _ => None,
        }
    }

    #[test]
    fn brackets_include_or_exclude_bounds() {
        use Bound::{Excluded, Included, Unbounded};
        let hour = Duration::from_secs(3600);
        for (text, start, end) in [
            ("[..]", Unbounded, Unbounded),
            ("]..[", Unbounded, Unbounded),
            ("[now()..]", Included(NOW), Unbounded),
            ("[..now()]", Unbounded, Included(NOW)),
            (
                "[now(-1h)..now(1h)]",
                Included(NOW - hour),
                Included(NOW + hour),
            ),
            (
                "]now(-1h)..now(1h)[",
                Excluded(NOW - hour),
                Excluded(NOW + hour),
            ),
            ("[now(-1h);1h]", Included(NOW - hour), Included(NOW)),
            ("]now();1h[", Excluded(NOW), Excluded(NOW + hour)),
        ] {
            assert_eq!(range(text), Ok(TimeRange { start, end }), "{text}");
        }
    }

    #[test]
    fn durations_have_units() {
        for (text, milliseconds) in [
            ("0", 0.0),
            ("123.45", 123_450.0),
            ("1u", 0.001),
            ("1.5ms", 1.5),
            ("100ms", 100.0),
            ("10s", 10_000.0),
            ("0.5s", 500.0),
            ("1.1m", 66_000.0),
            ("1.5h", 5_400_000.0),
            ("1d", 86_400_000.0),
            ("1w", 604_800_000.0),
        ] {
            let found = at(&format!("now({text})")).expect(text) - NOW;
            let expected = Duration::from_secs_f64(milliseconds / 1000.0);
            assert!(
                found.abs_diff(expected) < Duration::from_nanos(100),
                "{text}: {found:?}"
            );
        }
    }

    #[test]
    fn dates_are_in_utc() {
        for (text, seconds, nanoseconds) in [
            ("1970-01-01T00:00:00Z", 0, 0),
            ("2022-06-30T01:02:03.226942997Z", 1_656_550_923, 226_942_997),
            ("2022-06-30T01:02:03Z", 1_656_550_923, 0),
            ("2022-06-30T01:02:03", 1_656_550_923, 0),
            ("2022-06-30 01:02:03Z", 1_656_550_923, 0),
            ("2000-02-29T00:00:00.5", 951_782_400, 500_000_000),
            ("2016-12-31T23:59:60Z", 1_483_228_799, 0),
            ("9999-12-31T23:59:59Z", 253_402_300_799, 0),
        ] {
            assert_eq!(
                at(text),
                Some(Duration::new(seconds, nanoseconds)),
                "{text}"
            );
        }
    }

    #[test]
    fn times_before_1970_count_as_1970() {
        assert_eq!(
            at("now(-100w)"),
            Some(NOW - Duration::from_secs(100 * 604_800))
        );
        assert_eq!(at("now(-5000w)"), Some(Duration::ZERO));
    }

    #[test]
    fn other_texts_are_rejected() {
        for text in [
            "",
            "[",
            "[]",
            "[;]",
            "[;1h]",
            "[now();]",
            "[1h..]",
            "now()",
            "(now()..)",
            "[now()",
            "[now(..]",
            "[now)..]",
            "[now(-)..]",
            "[now(--1s)..]",
            "[now();-1s]",
            "[now(1x)..]",
            "[now(4mm)..]",
            "[now(1h4m)..]",
            "[now(inf)..]",
            "[now(NaN)..]",
            "[now(1e99)..]",
            "[now(60000w)..]",
            "[2020-11-05..]",
            "[2022-06-30T01:02:03+02:00..]",
            "[2022-13-30T01:02:03Z..]",
            "[2022-02-29T01:02:03Z..]",
            "[1969-12-31T23:59:59Z..]",
            "[2022-06-30T24:02:03Z..]",
            "[2022-06-30T01:02:03.1234567890Z..]",
            "[2022-06-30T01:02:03.Z..]",
            "[+022-06-30T01:02:03Z..]",
            "€..€",
        ] {
            assert!(range(text).is_err(), "{text}");
        }
        let long = format!("[now(-{}1s)..]", "0".repeat(MAX_BYTES));
        assert_eq!(range(&long), Err(TimeRangeError::Length));
    }
}

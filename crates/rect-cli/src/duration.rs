//! Parses durations on the command line.
use std::{str::FromStr, time::Duration};

/// A duration on the command line: a number with the unit `us`, `ms`, `s`, `m` or `h`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DurationArgument(pub Duration);

/// The text is not a valid duration.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("{0:?} is not a valid duration; write a number with a unit, such as 7.5ms, 2s or 10m")]
pub struct ParseDurationError(String);

impl FromStr for DurationArgument {
    type Err = ParseDurationError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = || ParseDurationError(text.to_owned());
        let at = text
            .find(|c: char| c.is_ascii_alphabetic())
            .ok_or_else(wrong)?;
        let (number, unit) = text.split_at(at);
        let seconds = match unit {
            "us" => 1e-6,
            "ms" => 1e-3,
            "s" => 1.0,
            "m" => 60.0,
            "h" => 3600.0,
            _ => return Err(wrong()),
        };
        let number: f64 = number.parse().map_err(|_| wrong())?;
        Duration::try_from_secs_f64(number * seconds)
            .map(Self)
            .map_err(|_| wrong())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_require_a_number_and_a_unit() {
        for (text, micros) in [
            ("30ms", 30_000),
            ("7.5ms", 7500),
            ("2s", 2_000_000),
            ("50us", 50),
            ("1.5m", 90_000_000),
            ("1h", 3_600_000_000),
        ] {
            assert_eq!(
                text.parse(),
                Ok(DurationArgument(Duration::from_micros(micros))),
                "{text}"
            );
        }
        for text in ["", "30", "ms", "-1s", "1d", "nans", "infs"] {
            assert!(text.parse::<DurationArgument>().is_err(), "{text}");
        }
    }
}

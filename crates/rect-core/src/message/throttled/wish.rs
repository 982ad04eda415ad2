//! Defines [`Wish`], what a throttled subscriber asks for.
use std::{fmt, str::FromStr, time::Duration};

/// The lowest rate that can be asked for, in messages per second: one in 100 s.
pub const MIN_HZ: f64 = 0.01;
/// The highest one.
pub const MAX_HZ: f64 = 1000.0;

/// How many messages of a topic a subscriber wants. As text `2` (at most two a second), `0.5`, `2c` (and only if the value differs from
/// the last one), `c`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Wish {
    /// The highest rate in thousandths of a message per second. `None`: any rate.
    max_mhz: Option<u32>,
    /// Whether to leave out messages whose value equals the last one.
    on_change: bool,
}

/// The rate is out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("it must be {MIN_HZ} to {MAX_HZ} messages per second")]
pub struct WishError(pub f64);

impl Wish {
    /// Creates a wish. `None` if it wants every message.
    ///
    /// # Errors
    /// Fails if the rate is out of range.
    pub fn new(max_hz: Option<f64>, on_change: bool) -> Result<Option<Self>, WishError> {
        let mhz = |hz: f64| match (MIN_HZ..=MAX_HZ).contains(&hz) {
            true => Ok((hz * 1000.0).round() as u32),
            false => Err(WishError(hz)),
        };
        let max_mhz = max_hz.map(mhz).transpose()?;
        let is_wish = max_mhz.is_some() || on_change;
        Ok(is_wish.then_some(Self { max_mhz, on_change }))
    }

    /// Returns the shortest time between two messages; zero without a limit.
    pub fn interval(self) -> Duration {
        let of = |mhz| Duration::from_secs_f64(1000.0 / f64::from(mhz));
        self.max_mhz.map_or(Duration::ZERO, of)
    }

    /// Returns whether to leave out messages whose value equals the last one.
    pub fn is_on_change(self) -> bool {
        self.on_change
    }
}

impl fmt::Display for Wish {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(mhz) = self.max_mhz {
            write!(f, "{}", f64::from(mhz) / 1000.0)?;
        }
        f.write_str(if self.on_change { "c" } else { "" })
    }
}

impl FromStr for Wish {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (rate, on_change) = match text.strip_suffix('c') {
            Some(rate) => (rate, true),
            None => (text, false),
        };
        let max_hz = (!rate.is_empty()).then(|| rate.parse()).transpose();
        let wish = Self::new(max_hz.map_err(|_| ())?, on_change);
        wish.ok().flatten().ok_or(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_round_trip_as_text() {
        for (max_hz, on_change, text) in [
            (Some(2.0), false, "2"),
            (Some(0.5), true, "0.5c"),
            (None, true, "c"),
            (Some(33.333), false, "33.333"),
        ] {
            let wish = Wish::new(max_hz, on_change)
                .expect("valid")
                .expect("a wish");
            assert_eq!(wish.to_string(), text);
            assert_eq!(text.parse(), Ok(wish));
        }
        assert_eq!(Wish::new(None, false), Ok(None));
    }

    #[test]
    fn rates_out_of_range_are_refused() {
        for hz in [0.0, -1.0, 0.001, 1001.0, f64::NAN, f64::INFINITY] {
            assert!(Wish::new(Some(hz), false).is_err(), "{hz}");
        }
        for text in ["", "x", "0", "-2", "1e9", "nan", "2cc", "2 "] {
            assert!(text.parse::<Wish>().is_err(), "{text}");
        }
    }

    #[test]
    fn interval_is_that_between_two_messages() {
        let interval = |text: &str| text.parse::<Wish>().map(Wish::interval);
        assert_eq!(interval("2"), Ok(Duration::from_millis(500)));
        assert_eq!(interval("c"), Ok(Duration::ZERO));
    }
}

//! Estimates the round trip of a path, and from it the time after which a missing acknowledgement is suspicious.
use std::time::Duration;

/// The round trip until it is measured.
const INITIAL: Duration = Duration::from_millis(300);
/// The shortest time after which a path is suspected.
pub const MIN_TIMEOUT: Duration = Duration::from_millis(100);
/// The longest one.
const MAX_TIMEOUT: Duration = Duration::from_secs(2);

/// The round trip of a path: mean and variation as in TCP (RFC 6298), and the minimum.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Rtt {
    measured: Option<Measured>,
}

#[derive(Clone, Copy, Debug)]
struct Measured {
    mean: Duration,
    variation: Duration,
    min: Duration,
}

impl Rtt {
    /// Adds a measurement.
    pub(crate) fn add(&mut self, round_trip: Duration) {
        let Some(measured) = &mut self.measured else {
            self.measured = Some(Measured {
                mean: round_trip,
                variation: round_trip / 2,
                min: round_trip,
            });
            return;
        };
        let deviation = measured.mean.abs_diff(round_trip);
        measured.variation = (measured.variation * 3 + deviation) / 4;
        measured.mean = (measured.mean * 7 + round_trip) / 8;
        measured.min = measured.min.min(round_trip);
    }

    /// Returns the mean, if it was measured.
    pub(crate) fn mean(&self) -> Option<Duration> {
        self.measured.map(|measured| measured.mean)
    }

    /// Returns the minimum, if it was measured.
    pub(crate) fn min(&self) -> Option<Duration> {
        self.measured.map(|measured| measured.min)
    }

    /// Returns the time within which an acknowledgement is expected. `delay` is how long the peer may delay it.
    pub(crate) fn timeout(&self, delay: Duration) -> Duration {
        let expected = match self.measured {
            Some(measured) => measured.mean + measured.variation * 4,
            None => INITIAL,
        };
        (expected + delay).clamp(MIN_TIMEOUT, MAX_TIMEOUT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timeout_follows_the_round_trip_and_its_variation() {
        let (mut rtt, ms) = (Rtt::default(), Duration::from_millis);
        assert_eq!(rtt.timeout(ms(20)), INITIAL + ms(20));
        for _ in 0..50 {
            rtt.add(ms(2));
        }
        assert_eq!(rtt.timeout(ms(20)), MIN_TIMEOUT);
        for n in 0..50 {
            rtt.add(ms(if n % 2 == 0 { 100 } else { 200 }));
        }
        let timeout = rtt.timeout(ms(20));
        assert!((ms(300)..ms(450)).contains(&timeout), "{timeout:?}");
        assert_eq!(rtt.min(), Some(ms(2)));
        for _ in 0..50 {
            rtt.add(Duration::from_secs(9));
        }
        assert_eq!(rtt.timeout(ms(20)), MAX_TIMEOUT);
    }
}

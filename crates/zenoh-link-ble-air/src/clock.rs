//! Models the clock of an adapter, which runs slightly fast or slow. The central's clock determines when the events of a
//! connection take place, so the events of two centrals drift relative to each other.
//!
//! The Core Specification allows 50 ppm while a radio is active and up to 500 ppm while it sleeps (Vol 6, Part B, 4.2).
//! Crystals of common modules deviate by up to 20 ppm.
use std::time::Duration;

use super::rng::SimRng;

/// The clock of one adapter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Clock {
    /// Deviation in parts per billion; positive if its seconds are too long.
    deviation_ppb: i32,
}

impl Clock {
    /// Returns the clock of the adapter with this name: a deviation of at most `max_drift_ppm`, which depends only on the
    /// seed and on the name.
    pub(super) fn of(name: &str, seed: u64, max_drift_ppm: u16) -> Self {
        let mut rng =
            SimRng::new(seed ^ u64::from(crc32fast::hash(name.as_bytes())).rotate_left(32));
        Self {
            deviation_ppb: rng.random_within(i32::from(max_drift_ppm) * 1000),
        }
    }

    /// Returns the true time that passes while this clock counts `span`.
    pub(super) fn true_time(self, span: Duration) -> Duration {
        let nanos = i128::try_from(span.as_nanos()).unwrap_or(i128::MAX);
        let error = nanos * i128::from(self.deviation_ppb) / 1_000_000_000;
        Duration::from_nanos(u64::try_from(nanos + error).unwrap_or(u64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviates_within_the_limit_by_seed_and_name() {
        let day = Duration::from_secs(24 * 3600);
        let drift_us = |name: &str, seed| {
            let counted = Clock::of(name, seed, 20).true_time(day);
            counted.as_micros() as i64 - day.as_micros() as i64
        };
        let drifts: Vec<_> = (0..100).map(|n| drift_us(&format!("sim-{n}"), 1)).collect();
        let (min, max) = (drifts.iter().min(), drifts.iter().max());
        // 20 ppm of a day are 1.728 s.
        assert!(
            min >= Some(&-1_728_000) && max <= Some(&1_728_000),
            "{min:?} {max:?}"
        );
        assert!(
            min < Some(&-1_000_000) && max > Some(&1_000_000),
            "{min:?} {max:?}"
        );
        assert_eq!(drift_us("sim-1", 1), drift_us("sim-1", 1));
        assert_ne!(drift_us("sim-1", 1), drift_us("sim-1", 2));
    }

    #[test]
    fn is_exact_without_drift() {
        let span = Duration::from_nanos(7_500_001);
        assert_eq!(Clock::of("sim-a", 1, 0).true_time(span), span);
        assert_eq!(Clock::default().true_time(span), span);
    }
}

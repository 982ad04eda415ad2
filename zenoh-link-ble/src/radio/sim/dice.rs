//! Owns chance: one seeded generator for all of an air, so that a run can be repeated.
use std::time::Duration;

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

#[derive(Debug)]
pub(super) struct Dice(Pcg32);

impl Dice {
    pub(super) fn new(seed: u64) -> Self {
        Self(Pcg32::seed_from_u64(seed))
    }

    /// True with that probability. No number is drawn for what is certain.
    pub(super) fn chance(&mut self, probability: f64) -> bool {
        if probability <= 0.0 {
            false
        } else if probability >= 1.0 {
            true
        } else {
            f64::from(self.0.next_u32()) < probability * (f64::from(u32::MAX) + 1.0)
        }
    }

    /// A time from zero up to `limit`, in microseconds.
    pub(super) fn up_to(&mut self, limit: Duration) -> Duration {
        let micros = u64::try_from(limit.as_micros()).unwrap_or(u64::MAX);
        Duration::from_micros(u64::from(self.0.next_u32()) % micros.saturating_add(1).max(1))
    }

    /// A value within `jitter` of `mean`.
    pub(super) fn around(&mut self, mean: i16, jitter: u16) -> i16 {
        let spread = 2 * u32::from(jitter) + 1;
        let offset = i64::from(self.0.next_u32() % spread) - i64::from(jitter);
        i16::try_from(i64::from(mean) + offset).unwrap_or(mean)
    }
}

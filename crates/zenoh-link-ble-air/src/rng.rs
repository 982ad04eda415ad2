//! Provides random values for the air from one seeded generator, so that a run can be repeated.
use std::time::Duration;

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

#[derive(Debug)]
pub(super) struct SimRng(Pcg32);

impl SimRng {
    pub(super) fn new(seed: u64) -> Self {
        Self(Pcg32::seed_from_u64(seed))
    }

    /// Returns `true` with this probability. Does not use the generator if the result is certain.
    pub(super) fn random_bool(&mut self, probability: f64) -> bool {
        if probability <= 0.0 {
            false
        } else if probability >= 1.0 {
            true
        } else {
            f64::from(self.0.next_u32()) < probability * (f64::from(u32::MAX) + 1.0)
        }
    }

    /// Returns a random duration from zero to `limit`, in whole microseconds.
    pub(super) fn random_duration(&mut self, limit: Duration) -> Duration {
        let micros = u64::try_from(limit.as_micros()).unwrap_or(u64::MAX);
        Duration::from_micros(u64::from(self.0.next_u32()) % micros.saturating_add(1).max(1))
    }

    /// Returns a random value from `-limit` to `limit`.
    pub(super) fn random_within(&mut self, limit: i32) -> i32 {
        let spread = 2 * u64::from(limit.unsigned_abs()) + 1;
        let offset = i64::try_from(u64::from(self.0.next_u32()) % spread).unwrap_or(0);
        i32::try_from(offset - i64::from(limit.unsigned_abs())).unwrap_or(0)
    }

    /// Returns a random value that differs from `mean` by at most `jitter`.
    pub(super) fn random_around(&mut self, mean: i16, jitter: u16) -> i16 {
        let spread = 2 * u32::from(jitter) + 1;
        let offset = i64::from(self.0.next_u32() % spread) - i64::from(jitter);
        i16::try_from(i64::from(mean) + offset).unwrap_or(mean)
    }
}

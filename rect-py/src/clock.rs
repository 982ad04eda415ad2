//! Defines the clock of a driver and of the handle that owns it.
use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

/// The time that a driver sees. Clones are the same clock.
#[derive(Clone)]
pub struct Clock(Arc<State>);

struct State {
    created_at: Instant,
    /// The time since the creation, in tests; `None` for that of the computer's clock.
    frozen: Mutex<Option<Duration>>,
}

impl Clock {
    /// Creates a clock that shows the time of the computer's monotonic clock.
    pub fn new() -> Self {
        Self(Arc::new(State {
            created_at: Instant::now(),
            frozen: Mutex::new(None),
        }))
    }

    /// Returns the current time.
    pub fn now(&self) -> Instant {
        let frozen = self.0.frozen.lock().unwrap_or_else(PoisonError::into_inner);
        match *frozen {
            Some(elapsed) => self.0.created_at + elapsed,
            None => Instant::now(),
        }
    }

    /// Returns the time at which the clock was created.
    pub fn created_at(&self) -> Instant {
        self.0.created_at
    }

    /// Stops the clock at a time since its creation.
    pub fn freeze(&self, elapsed: Duration) {
        let mut frozen = self.0.frozen.lock().unwrap_or_else(PoisonError::into_inner);
        *frozen = Some(elapsed);
    }
}

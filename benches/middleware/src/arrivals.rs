//! Answers requests for the serving program, and counts the messages of a flood.
use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use bytes::Bytes;
use serde::{Deserialize, Serialize};

/// The requests that read and reset the count.
pub const COUNT: &[u8] = b"count";
pub const RESET: &[u8] = b"reset";

/// The count of a flood's messages that have arrived.
#[derive(Debug, Default)]
pub struct ArrivalCounter {
    arrivals: Mutex<Arrivals>,
}

#[derive(Debug, Default)]
struct Arrivals {
    count: u64,
    first: Option<Instant>,
    last: Option<Instant>,
}

/// The answer to `COUNT`.
#[derive(Debug, Serialize, Deserialize)]
pub struct Counted {
    pub count: u64,
    /// The time from the first arrival to the last.
    pub span: Duration,
}

impl ArrivalCounter {
    pub fn shared() -> Arc<Self> {
        Arc::default()
    }

    pub fn on_message(&self) {
        let now = Instant::now();
        let mut arrivals = self.arrivals.lock().unwrap_or_else(PoisonError::into_inner);
        arrivals.count += 1;
        arrivals.first.get_or_insert(now);
        arrivals.last = Some(now);
    }

    /// Returns the reply to a request: its own payload, or the count for `COUNT`. `RESET` resets the count.
    pub fn answer(&self, asked: Bytes) -> Bytes {
        let mut arrivals = self.arrivals.lock().unwrap_or_else(PoisonError::into_inner);
        match &asked[..] {
            COUNT => {
                let span = match (arrivals.first, arrivals.last) {
                    (Some(first), Some(last)) => last - first,
                    _ => Duration::ZERO,
                };
                let count = arrivals.count;
                let counted = serde_json::to_vec(&Counted { count, span });
                counted.unwrap_or_default().into()
            }
            RESET => {
                *arrivals = Arrivals::default();
                asked
            }
            _ => asked,
        }
    }
}

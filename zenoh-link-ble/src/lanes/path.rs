//! Owns the estimate of what the way to the peer carries, and how long it takes, from when acknowledgements come.
use std::time::{Duration, Instant};

/// How much of an estimate one measurement makes, as a divisor.
const WEIGHT: f64 = 4.0;
/// The shortest span the rate is measured over: acknowledgements come in bunches, as connection events do.
const SPAN: Duration = Duration::from_millis(200);

/// The way to the peer, as far as it was measured.
#[derive(Clone, Debug, Default)]
pub struct Path {
    rate_bytes_per_s: Option<f64>,
    round_trip: Option<Duration>,
    /// There is always something to send.
    busy: Option<Busy>,
}

#[derive(Clone, Debug)]
struct Busy {
    since: Instant,
    /// What the peer took since then.
    bytes: u32,
}

impl Path {
    /// An SDU went out.
    pub fn on_sent(&mut self, now: Instant) {
        self.busy.get_or_insert(Busy {
            since: now,
            bytes: 0,
        });
    }

    /// Nothing more waits: what is acknowledged next says nothing about the rate.
    pub fn on_idle(&mut self) {
        self.busy = None;
    }

    /// The peer took `new` more bytes; the last of them took so long to get there and be acknowledged.
    pub fn on_ack(&mut self, new: u16, took: Option<Duration>, now: Instant) {
        if let Some(busy) = self.busy.as_mut() {
            busy.bytes += u32::from(new);
            let span = now.saturating_duration_since(busy.since);
            if span >= SPAN {
                let measured = f64::from(busy.bytes) / span.as_secs_f64();
                let rate = self.rate_bytes_per_s.unwrap_or(measured);
                self.rate_bytes_per_s = Some(rate + (measured - rate) / WEIGHT);
                (busy.since, busy.bytes) = (now, 0);
            }
        }
        if let Some(took) = took {
            let round_trip = self.round_trip.unwrap_or(took);
            self.round_trip = Some((round_trip.mul_f64(WEIGHT - 1.0) + took).div_f64(WEIGHT));
        }
    }

    /// Bytes per second while there is enough to send.
    pub fn rate_bytes_per_s(&self) -> Option<f64> {
        self.rate_bytes_per_s
    }

    /// From an SDU to its acknowledgement.
    pub fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_measured_only_while_there_is_enough_to_send() {
        let (mut path, start) = (Path::default(), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        path.on_sent(at(0));
        path.on_idle();
        path.on_ack(1000, Some(Duration::from_secs(9)), at(9000));
        assert_eq!(path.rate_bytes_per_s(), None);
        assert_eq!(path.round_trip(), Some(Duration::from_secs(9)));
        // In bunches: three at once, then nothing for a while.
        for n in 0..400 {
            let (sent, heard) = (at(10_000 + 10 * n), at(10_100 + 30 * (n / 3)));
            path.on_sent(sent);
            path.on_ack(340, Some(Duration::from_millis(100)), heard);
        }
        let rate = path.rate_bytes_per_s().expect("measured");
        assert!((33_000.0..35_000.0).contains(&rate), "{rate}");
        assert!(path.round_trip().expect("measured") < Duration::from_millis(150));
    }
}

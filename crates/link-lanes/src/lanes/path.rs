//! Estimates the rate and the round-trip time of the path to the peer from the times of acknowledgements.
use std::time::{Duration, Instant};

use super::report::MeanTime;

/// Reciprocal of the weight of one measurement in the rate.
const WEIGHT: f64 = 4.0;
/// The shortest time over which the rate is measured. Acknowledgements arrive in bursts, once per connection event.
const MIN_SPAN: Duration = Duration::from_millis(200);

/// The measured properties of the path to the peer.
#[derive(Clone, Debug, Default)]
pub struct Path {
    rate_bytes_per_s: Option<f64>,
    round_trip: MeanTime,
    /// Set while there is always something to send.
    busy: Option<Busy>,
}

#[derive(Clone, Debug)]
struct Busy {
    since: Instant,
    /// Number of bytes that the peer has acknowledged since then.
    bytes: u32,
}

impl Path {
    /// Handles a sent SDU.
    pub fn on_sent(&mut self, now: Instant) {
        self.busy.get_or_insert(Busy {
            since: now,
            bytes: 0,
        });
    }

    /// Records that nothing more waits to be sent. The next acknowledgements do not show the rate of the path.
    pub fn on_idle(&mut self) {
        self.busy = None;
    }

    /// Handles an acknowledgement of `new` more bytes. `round_trip` is the time from sending the last of their SDUs until
    /// now, if it is known.
    pub fn on_ack(&mut self, new: u32, round_trip: Option<Duration>, now: Instant) {
        if let Some(busy) = self.busy.as_mut() {
            busy.bytes = busy.bytes.saturating_add(new);
            let span = now.saturating_duration_since(busy.since);
            if span >= MIN_SPAN {
                let measured = f64::from(busy.bytes) / span.as_secs_f64();
                let rate = self.rate_bytes_per_s.unwrap_or(measured);
                self.rate_bytes_per_s = Some(rate + (measured - rate) / WEIGHT);
                (busy.since, busy.bytes) = (now, 0);
            }
        }
        if let Some(measured) = round_trip {
            self.round_trip.add(measured);
        }
    }

    /// Returns the rate of the path while there is enough to send, in bytes per second; `None` until it was measured.
    pub fn rate_bytes_per_s(&self) -> Option<f64> {
        self.rate_bytes_per_s
    }

    /// Returns the moving average of the time from sending an SDU to its acknowledgement; `None` until it was measured.
    pub fn round_trip(&self) -> Option<Duration> {
        self.round_trip.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rate_is_measured_only_while_there_is_enough_to_send() {
        let (mut path, start) = (Path::default(), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        path.on_sent(at(0));
        path.on_idle();
        path.on_ack(1000, Some(Duration::from_secs(9)), at(9000));
        assert_eq!(path.rate_bytes_per_s(), None);
        assert_eq!(path.round_trip(), Some(Duration::from_secs(9)));
        // Acknowledgements arrive in bursts of three.
        for n in 0..400 {
            let (sent, acknowledged) = (at(10_000 + 10 * n), at(10_100 + 30 * (n / 3)));
            path.on_sent(sent);
            path.on_ack(340, Some(Duration::from_millis(100)), acknowledged);
        }
        let rate = path.rate_bytes_per_s().expect("measured");
        assert!((33_000.0..35_000.0).contains(&rate), "{rate}");
        assert!(path.round_trip().expect("measured") < Duration::from_millis(150));
    }
}

//! Estimates the offset between two clocks that are not synchronised, and thereby the age of frames.
//!
//! Frames contain the low 16 bits of their sender's milliseconds. The receiver's milliseconds minus those are the sum
//! of the clock offset and the time in transit, modulo 2^16. The receiver measures the offset with a small query to
//! which the sender replies with its time; the error is at most half a round trip. Until there is a reply, the fastest
//! frame of the last minute is assumed to have taken no time.
use std::time::{Duration, Instant};

use crate::clock::{fastest::Fastest, MillisecondClock};

/// How long the fastest frame is remembered. Longer would be wrong, because clocks drift.
const WINDOW: Duration = Duration::from_secs(60);
/// The maximum drift between two clocks: 100 ppm, twice what crystals are specified for.
const DRIFT_MS_PER_S: f64 = 0.1;
/// A frame that is younger than this would have arrived before it was sent: the sender's clock was set.
const IMPOSSIBLE_MS: f64 = -200.0;

#[derive(Clone, Copy, Debug)]
struct Reply {
    at: Instant,
    difference_ms: f64,
    round_trip: Duration,
}

/// The estimated offset of the sender's clock.
#[derive(Debug)]
pub struct Offset {
    own: MillisecondClock,
    /// The last difference, unwrapped. The next ones are close to it.
    near: Option<i64>,
    fastest: Fastest,
    reply: Option<Reply>,
}

impl Offset {
    /// Creates an estimate without any measurement.
    pub fn new(now: Instant) -> Self {
        Self {
            own: MillisecondClock::new(now, 0),
            near: None,
            fastest: Fastest::default(),
            reply: None,
        }
    }

    /// Handles the reply to a query that was sent at `asked_at`. `sender_low` is the low 16 bits of the sender's
    /// milliseconds, and `now` the time of arrival.
    pub fn on_reply(&mut self, asked_at: Instant, sender_low: u16, now: Instant) {
        let round_trip = now.saturating_duration_since(asked_at);
        let middle = asked_at + round_trip / 2;
        let difference_ms = self.unwrapped(self.own.low(middle).wrapping_sub(sender_low)) as f64;
        let reply = Reply {
            at: now,
            difference_ms,
            round_trip,
        };
        let is_better = self.reply.is_none_or(|known| {
            let drift_ms = now.saturating_duration_since(known.at).as_secs_f64() * DRIFT_MS_PER_S;
            let max_error = known.round_trip + Duration::from_secs_f64(drift_ms / 1000.0);
            // A larger difference is only possible if a clock was set.
            let limit_ms = (known.round_trip + round_trip).as_secs_f64() * 500.0 + drift_ms + 50.0;
            round_trip <= max_error || (difference_ms - known.difference_ms).abs() > limit_ms
        });
        if is_better {
            self.reply = Some(reply);
        }
    }

    /// Handles a frame that was sent at `sent_low`, and returns its age.
    pub fn on_frame(&mut self, sent_low: u16, now: Instant) -> Age {
        let difference = self.unwrapped(self.own.low(now).wrapping_sub(sent_low));
        self.fastest.forget_older(WINDOW, now);
        self.fastest.add(difference, now);
        if let Some(reply) = self.reply {
            let age_ms = difference as f64 - reply.difference_ms;
            let error_ms = reply.round_trip.as_secs_f64() * 500.0;
            if age_ms >= IMPOSSIBLE_MS - error_ms {
                return Age {
                    age: Duration::from_secs_f64(age_ms.max(0.0) / 1000.0),
                    min_delay: Some(reply.round_trip / 2),
                };
            }
            self.reply = None;
        }
        let age_ms = difference - self.fastest.smallest().unwrap_or(difference);
        Age {
            age: Duration::from_millis(age_ms.max(0) as u64),
            min_delay: None,
        }
    }

    /// Returns whether the sender has replied to a query.
    pub fn is_known(&self) -> bool {
        self.reply.is_some()
    }

    /// Returns the round trip of a query, if there was a reply.
    pub fn round_trip(&self) -> Option<Duration> {
        self.reply.map(|reply| reply.round_trip)
    }

    /// Extends the low 16 bits of a difference to the value that is closest to the previous difference.
    fn unwrapped(&mut self, low: u16) -> i64 {
        let near = self.near.unwrap_or_else(|| i64::from(low));
        let step = low.wrapping_sub(near as u16) as i16;
        let value = near + i64::from(step);
        self.near = Some(value);
        value
    }
}

/// The age of a frame on arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Age {
    /// Age of the frame. If the clocks' offset is unknown, the delay relative to the fastest frame of the last minute.
    pub age: Duration,
    /// Time that the smallest message takes. `None` if the clocks' offset is unknown.
    pub min_delay: Option<Duration>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn ages_are_correct_for_any_clock_offset_and_drift() {
        let start = Instant::now();
        for begin in [0, 1, 32_767, 65_500, 1_795_000_000_123] {
            let mut offset = Offset::new(start);
            // The sender's clock is 50 ppm fast.
            let sender = |at: Duration| (begin + at.mul_f64(1.000_05).as_millis() as u64) as u16;
            for n in 0..36_000u64 {
                let sent = ms(n * 100);
                if n % 150 == 0 {
                    offset.on_reply(start + sent, sender(sent + ms(20)), start + sent + ms(40));
                }
                let took = ms(20 + n * 7919 % 400);
                let found = offset.on_frame(sender(sent), start + sent + took);
                let error_ms = found.age.as_millis().abs_diff(took.as_millis());
                assert!(
                    error_ms <= 6,
                    "begin {begin}, frame {n}: {found:?}, not {took:?}"
                );
                assert!(found.min_delay.is_some_and(|delay| delay <= ms(21)));
            }
        }
    }

    #[test]
    fn without_a_reply_ages_are_relative_to_the_fastest_frame() {
        let start = Instant::now();
        let mut offset = Offset::new(start);
        for n in 0..2000u64 {
            let (sent, took) = (ms(n * 100), ms(100 + n % 7 * 10));
            let low = 65_000u16.wrapping_add(sent.as_millis() as u16);
            let found = offset.on_frame(low, start + sent + took);
            if n > 7 {
                assert_eq!(
                    (found.age, found.min_delay),
                    (took - ms(100), None),
                    "frame {n}"
                );
            }
        }
        // The delay increases. A minute later, the estimate has adapted.
        let longer = |offset: &mut Offset, n: u64| {
            let sent = ms(n * 100);
            let low = 65_000u16.wrapping_add(sent.as_millis() as u16);
            offset.on_frame(low, start + sent + ms(500)).age
        };
        assert_eq!(longer(&mut offset, 2001), ms(400));
        (2002..2700).for_each(|n| assert!(longer(&mut offset, n) <= ms(400)));
        assert_eq!(longer(&mut offset, 2701), ms(0));
    }

    #[test]
    fn adapts_to_a_clock_that_was_set() {
        let start = Instant::now();
        let mut offset = Offset::new(start);
        offset.on_reply(start, 1000, start + ms(10));
        assert_eq!(offset.on_frame(1005, start + ms(60)).age, ms(50));
        // The clock jumps one hour ahead: 3,600,000 ms are 61,056 modulo 2^16, which is 4480 back.
        let low = |at_ms: u64| (995 + at_ms + 3_600_000) as u16;
        offset.on_reply(start + ms(100), low(105), start + ms(110));
        assert_eq!(offset.on_frame(low(200), start + ms(250)).age, ms(50));
    }
}

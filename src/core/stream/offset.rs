//! Owns the difference of two clocks that nobody set alike, and so the age of a frame.
//!
//! Frames tell the low 16 bits of their sender's milliseconds. The receiver's own, less those, are the difference of the
//! clocks and the time on the way, mod 2^16. The difference comes from a small question that the sender answers with its
//! time: at most half a round trip is wrong with it. Until there is an answer, the fastest frame of the last minute
//! counts as one that took no time.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

/// The fastest frame is forgotten after so long: the clocks drift.
const WINDOW: Duration = Duration::from_secs(60);
const PART: Duration = Duration::from_secs(10);
/// How fast two clocks may drift apart: 100 ppm, twice what crystals are allowed.
const DRIFT_MS_PER_S: f64 = 0.1;
/// Such a frame would have come before it was sent: the sender's clock was set.
const IMPOSSIBLE_MS: f64 = -200.0;

/// The low 16 bits of milliseconds, by a clock of this process.
#[derive(Clone, Copy, Debug)]
pub struct Millis {
    start: Instant,
    start_ms: u64,
}

impl Millis {
    /// A clock that shows `start_ms` at `start`, and does not jump when the system's clock is set.
    pub fn new(start: Instant, start_ms: u64) -> Self {
        Self { start, start_ms }
    }

    /// What it shows.
    pub fn at(&self, now: Instant) -> u64 {
        let since = now.saturating_duration_since(self.start);
        self.start_ms.wrapping_add(since.as_millis() as u64)
    }

    /// The low 16 bits of that.
    pub fn low(&self, now: Instant) -> u16 {
        self.at(now) as u16
    }
}

#[derive(Clone, Copy, Debug)]
struct Answer {
    at: Instant,
    difference_ms: f64,
    round_trip: Duration,
}

/// What is known of the sender's clock.
#[derive(Debug)]
pub struct Offset {
    own: Millis,
    /// The last difference, unwrapped: others are near it.
    near: Option<i64>,
    /// The fastest of each part of the window.
    fastest: VecDeque<(Instant, i64)>,
    answer: Option<Answer>,
}

impl Offset {
    /// Nothing is known yet.
    pub fn new(now: Instant) -> Self {
        Self {
            own: Millis::new(now, 0),
            near: None,
            fastest: VecDeque::new(),
            answer: None,
        }
    }

    /// The sender was asked at `asked`, and answered, with `sender_low` of its milliseconds, at `now`.
    pub fn on_answer(&mut self, asked: Instant, sender_low: u16, now: Instant) {
        let round_trip = now.saturating_duration_since(asked);
        let middle = asked + round_trip / 2;
        let difference_ms = self.unwrapped(self.own.low(middle).wrapping_sub(sender_low)) as f64;
        let answer = Answer {
            at: now,
            difference_ms,
            round_trip,
        };
        let is_better = self.answer.is_none_or(|known| {
            let drift_ms = now.saturating_duration_since(known.at).as_secs_f64() * DRIFT_MS_PER_S;
            let may_be_wrong = known.round_trip + Duration::from_secs_f64(drift_ms / 1000.0);
            // So different are they only if a clock was set.
            let most_ms = (known.round_trip + round_trip).as_secs_f64() * 500.0 + drift_ms + 50.0;
            round_trip <= may_be_wrong || (difference_ms - known.difference_ms).abs() > most_ms
        });
        if is_better {
            self.answer = Some(answer);
        }
    }

    /// A frame of then came now. How long it took.
    pub fn on_frame(&mut self, sent_low: u16, now: Instant) -> Age {
        let difference = self.unwrapped(self.own.low(now).wrapping_sub(sent_low));
        self.note(difference, now);
        if let Some(answer) = self.answer {
            let took_ms = difference as f64 - answer.difference_ms;
            let wrong_ms = answer.round_trip.as_secs_f64() * 500.0;
            if took_ms >= IMPOSSIBLE_MS - wrong_ms {
                return Age {
                    age: Duration::from_secs_f64(took_ms.max(0.0) / 1000.0),
                    least: Some(answer.round_trip / 2),
                };
            }
            self.answer = None;
        }
        let fastest = self.fastest.iter().map(|&(_, fastest)| fastest).min();
        let took_ms = difference - fastest.unwrap_or(difference);
        Age {
            age: Duration::from_millis(took_ms.max(0) as u64),
            least: None,
        }
    }

    /// Whether the sender has said its time.
    pub fn is_known(&self) -> bool {
        self.answer.is_some()
    }

    /// The round trip of a small question, where known.
    pub fn round_trip(&self) -> Option<Duration> {
        self.answer.map(|answer| answer.round_trip)
    }

    fn note(&mut self, difference: i64, now: Instant) {
        let is_old = |at: Instant| now.saturating_duration_since(at) > WINDOW;
        while self.fastest.front().is_some_and(|&(at, _)| is_old(at)) {
            self.fastest.pop_front();
        }
        match self.fastest.back_mut() {
            Some((at, fastest)) if now.saturating_duration_since(*at) < PART => {
                *fastest = difference.min(*fastest);
            }
            _ => self.fastest.push_back((now, difference)),
        }
    }

    fn unwrapped(&mut self, low: u16) -> i64 {
        let near = self.near.unwrap_or_else(|| i64::from(low));
        let step = low.wrapping_sub(near as u16) as i16;
        let value = near + i64::from(step);
        self.near = Some(value);
        value
    }
}

/// How long a frame took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Age {
    /// Since it was sent; where `least` is not known, what it took longer than the fastest one of the last minute.
    pub age: Duration,
    /// What the smallest message takes.
    pub least: Option<Duration>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn ages_are_right_wherever_the_clocks_stand_and_however_they_drift() {
        let start = Instant::now();
        for begin in [0, 1, 32_767, 65_500, 1_795_000_000_123] {
            let mut offset = Offset::new(start);
            // The sender's clock is 50 ppm fast.
            let sender = |at: Duration| (begin + at.mul_f64(1.000_05).as_millis() as u64) as u16;
            for n in 0..36_000u64 {
                let sent = ms(n * 100);
                if n % 150 == 0 {
                    offset.on_answer(start + sent, sender(sent + ms(20)), start + sent + ms(40));
                }
                let took = ms(20 + n * 7919 % 400);
                let found = offset.on_frame(sender(sent), start + sent + took);
                let wrong_ms = found.age.as_millis().abs_diff(took.as_millis());
                assert!(
                    wrong_ms <= 6,
                    "begin {begin}, frame {n}: {found:?}, not {took:?}"
                );
                assert!(found.least.is_some_and(|least| least <= ms(21)));
            }
        }
    }

    #[test]
    fn without_an_answer_the_fastest_of_the_last_minute_took_no_time() {
        let start = Instant::now();
        let mut offset = Offset::new(start);
        for n in 0..2000u64 {
            let (sent, took) = (ms(n * 100), ms(100 + n % 7 * 10));
            let low = 65_000u16.wrapping_add(sent.as_millis() as u16);
            let found = offset.on_frame(low, start + sent + took);
            if n > 7 {
                assert_eq!(
                    (found.age, found.least),
                    (took - ms(100), None),
                    "frame {n}"
                );
            }
        }
        // The way is longer now: a minute later that is known.
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
    fn a_clock_that_is_set_is_noticed() {
        let start = Instant::now();
        let mut offset = Offset::new(start);
        offset.on_answer(start, 1000, start + ms(10));
        assert_eq!(offset.on_frame(1005, start + ms(60)).age, ms(50));
        // It is an hour ahead at once: 3,600,000 ms are 61,056 mod 2^16, which is 4480 back.
        let low = |at_ms: u64| (995 + at_ms + 3_600_000) as u16;
        offset.on_answer(start + ms(100), low(105), start + ms(110));
        assert_eq!(offset.on_frame(low(200), start + ms(250)).age, ms(50));
    }
}

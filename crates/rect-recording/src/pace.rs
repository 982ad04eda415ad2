//! Decides when the messages of a replay are due, while it is paused, stepped, or its rate is changed.
use std::time::{Duration, Instant};

/// The lowest and the highest rate of a replay.
pub const RATES: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// When a message is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Due {
    /// At this time.
    At(Instant),
    /// Not before the replay goes on.
    Paused,
}

/// The progress of a replay.
#[derive(Clone, Debug)]
pub struct Pace {
    /// How much faster than the recording.
    rate: f64,
    /// The position in the recording at `since`, or while the replay is paused.
    position: Duration,
    /// Since when the replay runs with this rate. `None`: it is paused.
    since: Option<Instant>,
    /// How many messages may pass while the replay is paused.
    steps: u32,
}

impl Pace {
    /// Begins a replay now, `rate` times as fast as the recording.
    pub fn new(rate: f64, now: Instant) -> Self {
        Self {
            rate,
            position: Duration::ZERO,
            since: Some(now),
            steps: 0,
        }
    }

    /// Begins again at the start of the recording, with the same rate, and paused if it was.
    pub fn restart(&mut self, now: Instant) {
        *self = Self {
            since: self.since.map(|_| now),
            ..Self::new(self.rate, now)
        };
    }

    /// Returns when the message at a position of the recording is due.
    pub fn due(&self, at: Duration, now: Instant) -> Due {
        match self.since {
            _ if self.steps > 0 => Due::At(now),
            Some(since) => Due::At(since + at.saturating_sub(self.position).div_f64(self.rate)),
            None => Due::Paused,
        }
    }

    /// Handles that the message at a position was published.
    pub fn on_published(&mut self, at: Duration) {
        if self.steps > 0 {
            self.steps -= 1;
            self.position = self.position.max(at);
        }
    }

    /// Pauses the replay, or continues it.
    pub fn pause_or_continue(&mut self, now: Instant) {
        match self.since {
            Some(_) => self.pause(now),
            None => self.since = Some(now),
        }
        self.steps = 0;
    }

    /// Pauses the replay, and lets the next message pass.
    pub fn step(&mut self, now: Instant) {
        self.pause(now);
        self.steps += 1;
    }

    /// Multiplies the rate by a factor, within [`RATES`].
    pub fn change_rate(&mut self, factor: f64, now: Instant) {
        let position = self.position(now);
        if self.since.is_some() {
            (self.position, self.since) = (position, Some(now));
        }
        self.rate = (self.rate * factor).clamp(*RATES.start(), *RATES.end());
    }

    /// Returns the position in the recording.
    pub fn position(&self, now: Instant) -> Duration {
        let since = self.since.map(|since| now.saturating_duration_since(since));
        self.position + since.unwrap_or_default().mul_f64(self.rate)
    }

    /// Returns the rate.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// Returns whether the replay is paused.
    pub fn is_paused(&self) -> bool {
        self.since.is_none()
    }

    fn pause(&mut self, now: Instant) {
        self.position = self.position(now);
        self.since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn s(s: u64) -> Duration {
        Duration::from_secs(s)
    }

    #[test]
    fn messages_are_due_at_their_distances_divided_by_the_rate() {
        let start = Instant::now();
        let mut pace = Pace::new(2.0, start);
        assert_eq!(pace.due(s(10), start), Due::At(start + s(5)));
        pace.change_rate(2.0, start + s(1));
        assert_eq!(pace.position(start + s(1)), s(2));
        assert_eq!(pace.due(s(10), start + s(1)), Due::At(start + s(3)));
        pace.change_rate(100.0, start + s(1));
        assert_eq!(pace.rate(), 10.0);
    }

    #[test]
    fn pause_moves_everything_that_follows() {
        let start = Instant::now();
        let mut pace = Pace::new(1.0, start);
        pace.pause_or_continue(start + s(4));
        assert_eq!(pace.due(s(5), start + s(60)), Due::Paused);
        assert_eq!(pace.position(start + s(60)), s(4));
        pace.pause_or_continue(start + s(60));
        assert_eq!(pace.due(s(5), start + s(60)), Due::At(start + s(61)));
    }

    #[test]
    fn step_lets_one_message_pass() {
        let start = Instant::now();
        let mut pace = Pace::new(1.0, start);
        pace.step(start);
        assert_eq!(pace.due(s(30), start), Due::At(start));
        pace.on_published(s(30));
        assert_eq!(pace.due(s(31), start), Due::Paused);
        pace.pause_or_continue(start + s(9));
        assert_eq!(pace.due(s(31), start + s(9)), Due::At(start + s(10)));
        pace.restart(start + s(20));
        assert_eq!(pace.due(s(1), start + s(20)), Due::At(start + s(21)));
    }
}

//! Decides at which rate to send to a receiver, from its feedback.
//!
//! The rate is a share of the *pace* at which frames arrived. The pace is a property of the link and independent of
//! what is sent. So the rate converges within a few reports and stays constant, and no queue has to be filled to find
//! the limit. The rate decreases immediately, and at most doubles with each report. If the clocks' offset is unknown,
//! there is no pace: then the rate grows until frames are late or lost, and backs off.
use std::time::{Duration, Instant};

use super::feedback::Feedback;

/// The share of the pace that is used. The rest is for other traffic on the link, and for frames that are larger than
/// expected.
const SHARE: f64 = 0.85;
/// Frames that are older than this wait in a queue, which has to become empty: frames that were sent before a link
/// became slower may fill a queue of 100 kB. The older they are, the smaller is the share of the pace that is used,
/// down to the second one.
const QUEUED_MS: u32 = 500;
const DRAINING_SHARE: f64 = 0.1;
/// The weights of a new measurement of the pace, for a decrease and an increase.
const WEIGHT_DOWN: f64 = 0.5;
const WEIGHT_UP: f64 = 0.3;
/// The weight of a new measurement of losses: with two reports per second, the average covers about 3 s.
const WEIGHT_LOSS: f64 = 0.15;
/// The share of lost frames above which the rate backs off. Fewer losses are normal for radio links.
const HIGH_LOSS: f64 = 0.2;
const BACKOFF: f64 = 0.85;
/// The growth per report after backing off, and how long it applies. Without a pace, it applies for a fifth of this.
const CAUTIOUS_GROWTH: f64 = 1.01;
const CAUTIOUS_TIME: Duration = Duration::from_secs(10);
/// Without a pace, frames that are later than the fastest ones by more than this are assumed to queue.
const LATE_MS: u32 = 150;
/// The growth per report without a pace, after the rate has backed off once.
const BLIND_GROWTH: f64 = 1.1;
/// After this time without feedback the rate is halved, and again every second, down to the initial rate.
const SILENCE: Duration = Duration::from_secs(2);

/// The limits of a stream's data rate, in bytes per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateLimits {
    /// Minimum rate, 1 or more. If it exceeds the maximum, the maximum is used. Default: 2,000.
    pub min_bytes_per_s: f64,
    /// Rate before the first feedback, and for receivers that send none, 1 or more. Default: 60,000.
    pub initial_bytes_per_s: f64,
    /// Maximum rate, 1 or more. Default: 20,000,000.
    pub max_bytes_per_s: f64,
}

impl Default for RateLimits {
    fn default() -> Self {
        Self {
            min_bytes_per_s: 2e3,
            initial_bytes_per_s: 60e3,
            max_bytes_per_s: 20e6,
        }
    }
}

impl RateLimits {
    /// Returns the rate before the first feedback, within the limits.
    pub(super) fn initial(&self) -> f64 {
        self.clamp(self.initial_bytes_per_s)
    }

    /// Returns the rate, or the limit that it exceeds.
    pub(super) fn clamp(&self, bytes_per_s: f64) -> f64 {
        bytes_per_s
            .max(self.min_bytes_per_s)
            .min(self.max_bytes_per_s)
    }
}

/// The rate for one receiver.
#[derive(Clone, Debug)]
pub struct Rate {
    limits: RateLimits,
    bytes_per_s: f64,
    pace: Option<f64>,
    lost_share: f64,
    cautious_until: Option<Instant>,
    /// Whether the rate has backed off before; then it grows more slowly.
    has_backed_off: bool,
    quiet_since: Instant,
}

impl Rate {
    /// Creates the rate for a new receiver.
    pub fn new(limits: RateLimits, now: Instant) -> Self {
        Self {
            limits,
            bytes_per_s: limits.initial(),
            pace: None,
            lost_share: 0.0,
            cautious_until: None,
            has_backed_off: false,
            quiet_since: now,
        }
    }

    /// Returns the current rate.
    pub fn bytes_per_s(&self) -> f64 {
        self.bytes_per_s
    }

    /// Returns the rate that would be reached after further growth: a share of the pace.
    pub fn potential(&self) -> f64 {
        match self.pace {
            Some(pace) if self.cautious_until.is_none() => self.within(pace * SHARE),
            _ => self.bytes_per_s,
        }
    }

    /// Returns the share of frames lost recently, 0 to 1.
    pub fn lost_share(&self) -> f64 {
        self.lost_share
    }

    /// Handles feedback of the receiver.
    pub fn on_feedback(&mut self, feedback: &Feedback, now: Instant) {
        self.quiet_since = now;
        let all = f64::from(feedback.frames) + f64::from(feedback.skipped);
        if all > 0.0 {
            let lost = f64::from(feedback.skipped) / all;
            self.lost_share += (lost - self.lost_share) * WEIGHT_LOSS;
        }
        if feedback.frames == 0 {
            return;
        }
        self.cautious_until = self.cautious_until.filter(|&until| now < until);
        match feedback.pace_bytes_per_s {
            Some(pace) => self.follow(f64::from(pace), feedback.age_ms),
            None => self.grow_blindly(feedback, now),
        }
        if self.lost_share > HIGH_LOSS && self.cautious_until.is_none() {
            self.back_off(self.bytes_per_s, now);
        }
    }

    /// Updates the rate if the receiver has been silent.
    pub fn poll(&mut self, now: Instant) {
        if now.saturating_duration_since(self.quiet_since) >= SILENCE {
            self.quiet_since = now - SILENCE + Duration::from_secs(1);
            let min = self.bytes_per_s.min(self.limits.initial_bytes_per_s);
            self.bytes_per_s = self.within((self.bytes_per_s / 2.0).max(min));
        }
    }

    fn follow(&mut self, pace: f64, age_ms: u32) {
        let known = self.pace.unwrap_or(pace);
        let weight = if pace < known { WEIGHT_DOWN } else { WEIGHT_UP };
        let pace = known + (pace - known) * weight;
        self.pace = Some(pace);
        let growth = if self.cautious_until.is_some() {
            CAUTIOUS_GROWTH
        } else {
            2.0
        };
        let queued = f64::from(QUEUED_MS) / f64::from(age_ms.max(QUEUED_MS));
        let share = (SHARE * queued).max(DRAINING_SHARE);
        self.bytes_per_s = self.within((pace * share).min(self.bytes_per_s * growth));
    }

    fn grow_blindly(&mut self, feedback: &Feedback, now: Instant) {
        self.pace = None;
        let span_s = f64::from(feedback.span_ms.max(100)) / 1000.0;
        let received = f64::from(feedback.bytes) / span_s;
        if feedback.age_ms > LATE_MS {
            if self.cautious_until.is_none() {
                self.back_off(received.min(self.bytes_per_s), now);
            }
            return;
        }
        let growth = match (self.cautious_until, self.has_backed_off) {
            (Some(_), _) => CAUTIOUS_GROWTH,
            (None, true) => BLIND_GROWTH,
            (None, false) => 1.5,
        };
        // A rate that is not used is not known to be possible.
        let max = self.bytes_per_s.max(received * 2.0);
        self.bytes_per_s = self.within((self.bytes_per_s * growth).min(max));
    }

    fn back_off(&mut self, from: f64, now: Instant) {
        self.bytes_per_s = self.within(from * BACKOFF);
        self.has_backed_off = true;
        // Earlier losses do not count any more.
        self.lost_share = 0.0;
        let pause = if self.pace.is_some() {
            CAUTIOUS_TIME
        } else {
            CAUTIOUS_TIME / 5
        };
        self.cautious_until = Some(now + pause);
    }

    fn within(&self, bytes_per_s: f64) -> f64 {
        self.limits.clamp(bytes_per_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn feedback(pace: Option<u32>, frames: u32, skipped: u32) -> Feedback {
        Feedback {
            span_ms: 500,
            frames,
            skipped,
            bytes: frames * 3000,
            pace_bytes_per_s: pace,
            ..Feedback::default()
        }
    }

    fn run(rate: &mut Rate, now: &mut Instant, feedback: &Feedback, times: u32) {
        for _ in 0..times {
            *now += Duration::from_millis(500);
            rate.on_feedback(feedback, *now);
            rate.poll(*now);
        }
    }

    #[test]
    fn follows_the_pace_down_at_once_and_up_by_doubling() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        run(&mut rate, &mut now, &feedback(Some(34_000), 5, 0), 1);
        assert_eq!(rate.bytes_per_s(), 34e3 * SHARE);
        run(&mut rate, &mut now, &feedback(Some(10_000_000), 5, 0), 1);
        assert_eq!(rate.bytes_per_s(), 34e3 * SHARE * 2.0);
        run(&mut rate, &mut now, &feedback(Some(10_000_000), 5, 0), 20);
        assert!(rate.bytes_per_s() > 8e6);
        run(&mut rate, &mut now, &feedback(Some(34_000), 5, 0), 12);
        assert!(rate.bytes_per_s() < 31e3);
    }

    #[test]
    fn a_queue_becomes_empty() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        let pace = 10_000.0;
        let mut queued_bytes = 100e3;
        for _ in 0..60 {
            let report = Feedback {
                age_ms: (1000.0 * queued_bytes / pace) as u32,
                ..feedback(Some(pace as u32), 5, 0)
            };
            run(&mut rate, &mut now, &report, 1);
            queued_bytes = (queued_bytes + (rate.bytes_per_s() - pace) / 2.0).max(0.0);
        }
        assert!(queued_bytes < 100.0, "{queued_bytes}");
        assert_eq!(rate.bytes_per_s(), pace * SHARE);
    }

    #[test]
    fn maximum_below_the_other_limits_is_respected() {
        let now = Instant::now();
        let limits = RateLimits {
            max_bytes_per_s: 1000.0,
            ..RateLimits::default()
        };
        let mut rate = Rate::new(limits, now);
        assert_eq!(rate.bytes_per_s(), 1000.0);
        rate.on_feedback(&feedback(Some(10_000_000), 5, 0), now);
        assert_eq!(rate.bytes_per_s(), 1000.0);
    }

    #[test]
    fn backs_off_after_many_losses_but_not_after_few() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        run(&mut rate, &mut now, &feedback(Some(50_000), 19, 1), 100);
        assert_eq!(rate.bytes_per_s(), 50e3 * SHARE);
        run(&mut rate, &mut now, &feedback(Some(50_000), 5, 5), 10);
        assert!(rate.bytes_per_s() < 47e3 * SHARE);
    }

    #[test]
    fn without_a_pace_the_rate_grows_until_frames_are_late() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        let mut good = feedback(None, 5, 0);
        good.bytes = 60_000;
        run(&mut rate, &mut now, &good, 5);
        let grown = rate.bytes_per_s();
        assert!(grown > 120e3, "{grown}");
        run(
            &mut rate,
            &mut now,
            &Feedback {
                age_ms: 300,
                bytes: 17_000,
                ..good
            },
            1,
        );
        assert_eq!(rate.bytes_per_s(), 34e3 * BACKOFF);
    }

    #[test]
    fn without_feedback_the_rate_halves_down_to_the_initial_one() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        run(&mut rate, &mut now, &feedback(Some(10_000_000), 5, 0), 20);
        for _ in 0..20 {
            now += Duration::from_secs(1);
            rate.poll(now);
        }
        assert_eq!(
            rate.bytes_per_s(),
            RateLimits::default().initial_bytes_per_s
        );
    }
}

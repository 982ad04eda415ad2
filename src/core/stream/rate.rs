//! Owns how many bytes per second one receiver gets through, from what it says.
//!
//! The rate is a share of the *pace* at which frames came through. The pace is the link's, whatever is sent, so that the
//! rate finds its place in a few messages and stays there; nothing has to be overfilled to learn where the end is. It
//! goes down at once and at most doubles with each message. Where the clocks are not known there is no pace: then it grows
//! until frames are late or lost, and gives way.
use std::time::{Duration, Instant};

use super::feedback::Feedback;

/// The share of the pace that is used: the rest is for what else the link carries, and for frames larger than expected.
const SHARE: f64 = 0.85;
/// How much of the pace one message makes.
const WEIGHT_DOWN: f64 = 0.5;
const WEIGHT_UP: f64 = 0.3;
/// How much of the share of lost frames one message makes: with two a second, the memory is about 3 s.
const WEIGHT_LOSS: f64 = 0.15;
/// With so many lost the rate gives way; fewer are the weather of a radio.
const MUCH_LOSS: f64 = 0.2;
const GIVES_WAY: f64 = 0.85;
/// After it gave way for losses, it grows by that much a message, for so long.
const CAUTIOUS_GROWTH: f64 = 1.01;
const CAUTIOUS: Duration = Duration::from_secs(10);
/// Later than the fastest ones by so much, where there is no pace, frames wait for each other.
const LATE_MS: u32 = 150;
const BLIND_GROWTH: f64 = 1.1;
/// No word for so long: it is halved, and again each second.
const SILENCE: Duration = Duration::from_secs(2);

/// What a stream may send, in bytes per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RateLimits {
    /// Not less; default 2,000.
    pub least: f64,
    /// Before anything is known, and where nobody says anything; default 60,000.
    pub first: f64,
    /// Not more; default 20,000,000.
    pub most: f64,
}

impl Default for RateLimits {
    fn default() -> Self {
        Self {
            least: 2e3,
            first: 60e3,
            most: 20e6,
        }
    }
}

/// One receiver's.
#[derive(Clone, Debug)]
pub struct Rate {
    limits: RateLimits,
    bytes_per_s: f64,
    pace: Option<f64>,
    lost_share: f64,
    cautious_until: Option<Instant>,
    /// It has given way before: no more leaps.
    has_given_way: bool,
    quiet_since: Instant,
}

impl Rate {
    /// Of a receiver that is new.
    pub fn new(limits: RateLimits, now: Instant) -> Self {
        Self {
            limits,
            bytes_per_s: limits.first.clamp(limits.least, limits.most),
            pace: None,
            lost_share: 0.0,
            cautious_until: None,
            has_given_way: false,
            quiet_since: now,
        }
    }

    /// What may be sent.
    pub fn bytes_per_s(&self) -> f64 {
        self.bytes_per_s
    }

    /// What could be sent once the rate has grown there: a share of the pace.
    pub fn potential(&self) -> f64 {
        match self.pace {
            Some(pace) if self.cautious_until.is_none() => self.within(pace * SHARE),
            _ => self.bytes_per_s,
        }
    }

    /// The share of frames lost, lately.
    pub fn lost_share(&self) -> f64 {
        self.lost_share
    }

    /// The receiver says so.
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
            Some(pace) => self.follow(f64::from(pace)),
            None => self.grow_blindly(feedback, now),
        }
        if self.lost_share > MUCH_LOSS && self.cautious_until.is_none() {
            self.give_way(self.bytes_per_s, now);
        }
    }

    /// Time has passed.
    pub fn poll(&mut self, now: Instant) {
        if now.saturating_duration_since(self.quiet_since) >= SILENCE {
            self.quiet_since = now - SILENCE + Duration::from_secs(1);
            let least = self.bytes_per_s.min(self.limits.first);
            self.bytes_per_s = self.within((self.bytes_per_s / 2.0).max(least));
        }
    }

    fn follow(&mut self, pace: f64) {
        let known = self.pace.unwrap_or(pace);
        let weight = if pace < known { WEIGHT_DOWN } else { WEIGHT_UP };
        let pace = known + (pace - known) * weight;
        self.pace = Some(pace);
        let growth = if self.cautious_until.is_some() {
            CAUTIOUS_GROWTH
        } else {
            2.0
        };
        self.bytes_per_s = self.within((pace * SHARE).min(self.bytes_per_s * growth));
    }

    fn grow_blindly(&mut self, feedback: &Feedback, now: Instant) {
        self.pace = None;
        let span_s = f64::from(feedback.span_ms.max(100)) / 1000.0;
        let came = f64::from(feedback.bytes) / span_s;
        if feedback.age_ms > LATE_MS {
            if self.cautious_until.is_none() {
                self.give_way(came.min(self.bytes_per_s), now);
            }
            return;
        }
        let growth = match (self.cautious_until, self.has_given_way) {
            (Some(_), _) => CAUTIOUS_GROWTH,
            (None, true) => BLIND_GROWTH,
            (None, false) => 1.5,
        };
        // What is not sent is not known to fit.
        let most = self.bytes_per_s.max(came * 2.0);
        self.bytes_per_s = self.within((self.bytes_per_s * growth).min(most));
    }

    fn give_way(&mut self, from: f64, now: Instant) {
        self.bytes_per_s = self.within(from * GIVES_WAY);
        self.has_given_way = true;
        // What was lost before counts no more.
        self.lost_share = 0.0;
        let pause = if self.pace.is_some() {
            CAUTIOUS
        } else {
            CAUTIOUS / 5
        };
        self.cautious_until = Some(now + pause);
    }

    fn within(&self, bytes_per_s: f64) -> f64 {
        bytes_per_s.clamp(self.limits.least, self.limits.most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn says(pace: Option<u32>, frames: u32, skipped: u32) -> Feedback {
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
    fn it_is_a_share_of_the_pace_down_at_once_and_up_by_doubling() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        run(&mut rate, &mut now, &says(Some(34_000), 5, 0), 1);
        assert_eq!(rate.bytes_per_s(), 34e3 * SHARE);
        run(&mut rate, &mut now, &says(Some(10_000_000), 5, 0), 1);
        assert_eq!(rate.bytes_per_s(), 34e3 * SHARE * 2.0);
        run(&mut rate, &mut now, &says(Some(10_000_000), 5, 0), 20);
        assert!(rate.bytes_per_s() > 8e6);
        run(&mut rate, &mut now, &says(Some(34_000), 5, 0), 12);
        assert!(rate.bytes_per_s() < 31e3);
    }

    #[test]
    fn a_few_losses_change_nothing_and_many_make_it_give_way() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        run(&mut rate, &mut now, &says(Some(50_000), 19, 1), 100);
        assert_eq!(rate.bytes_per_s(), 50e3 * SHARE);
        run(&mut rate, &mut now, &says(Some(50_000), 5, 5), 10);
        assert!(rate.bytes_per_s() < 47e3 * SHARE);
    }

    #[test]
    fn without_a_pace_it_grows_until_frames_are_late() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        let mut good = says(None, 5, 0);
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
        assert_eq!(rate.bytes_per_s(), 34e3 * GIVES_WAY);
    }

    #[test]
    fn silence_halves_it_down_to_where_it_began() {
        let mut now = Instant::now();
        let mut rate = Rate::new(RateLimits::default(), now);
        run(&mut rate, &mut now, &says(Some(10_000_000), 5, 0), 20);
        for _ in 0..20 {
            now += Duration::from_secs(1);
            rate.poll(now);
        }
        assert_eq!(rate.bytes_per_s(), RateLimits::default().first);
    }
}

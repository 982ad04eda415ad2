//! Owns how much is asked for at once, and in pieces of which size.
//!
//! What is asked for and not there yet waits somewhere on its way: in the sender, in routers, in the radio. So much is to
//! be asked for that the narrowest link is never idle, and hardly more, since the rest only waits in front of it, and
//! what is urgent may have to wait behind it. The two differ in how long a piece takes: as long as nothing waits, asking
//! for more makes more come; as soon as something waits, it only makes each piece take longer.
//!
//! So the limit is `rate * base + headroom`: what came per second in the last round trips, times what a piece takes when
//! nothing waits in front of it, plus one piece that waits. `base` is the least that a piece took lately. A queue of one's
//! own would in time be taken for a part of the way: every 15 s one piece goes alone, and is measured anew.
use std::time::{Duration, Instant};

use super::MAX_PIECE_BYTES;

/// The first pieces, on a link that nothing is known of.
const FIRST_PIECE: u32 = 2048;
/// The smallest pieces. A reply costs some 60 bytes of its own.
const MIN_PIECE: u32 = 1024;
/// How long a piece may occupy the link: what another transfer waits for it, or an urgent message on a link that knows no
/// priorities (ours does). With half as long ones, requests and headers took another 4 % of a Bluetooth link.
const PIECE_TIME: Duration = Duration::from_millis(128);
/// What may wait at the narrowest link even where a piece takes less: programs are not on time.
const SLACK: Duration = Duration::from_millis(5);
/// The most that is on its way, in bytes: what a transfer takes of memory at most, beside its place in a file.
pub const MAX_LIMIT_BYTES: u64 = 4 << 20;
/// The most requests at once.
const MAX_REQUESTS: u64 = 64;
/// How long the least time that a piece took is believed.
const BASE_AGE: Duration = Duration::from_secs(15);
/// The shortest and the longest time that a request has to be answered in.
const TIMEOUTS: (Duration, Duration) = (Duration::from_secs(2), Duration::from_secs(30));

/// How much may be on its way.
#[derive(Clone, Debug)]
pub struct Window {
    phase: Phase,
    piece: u32,
    limit: u64,
    base: Option<Base>,
    /// Bytes per second.
    rate: Option<f64>,
    /// What a piece takes, of late.
    smoothed: Option<Duration>,
    round: Option<Round>,
}

#[derive(Clone, Debug, PartialEq)]
enum Phase {
    /// Nothing waits yet, as far as can be seen: twice as much each round.
    Opening {
        /// The rounds in which the rate did not grow any more.
        flat: u32,
    },
    /// As the rate and the base say.
    Steady,
    /// One piece at a time, until one asked for since then has come.
    Draining { since: Instant },
}

/// What a piece takes when nothing waits in front of it.
#[derive(Clone, Copy, Debug)]
struct Base {
    least: Duration,
    at: Instant,
}

/// From one piece's arrival to that of the first that was asked for after it.
#[derive(Clone, Debug)]
struct Round {
    since: Instant,
    bytes: u64,
    least: Option<Duration>,
    /// There was more to ask for than the limit allowed.
    full: bool,
}

impl Default for Window {
    fn default() -> Self {
        Self {
            phase: Phase::Opening { flat: 0 },
            piece: FIRST_PIECE,
            limit: u64::from(FIRST_PIECE) * 2,
            base: None,
            rate: None,
            smoothed: None,
            round: None,
        }
    }
}

impl Window {
    /// How many bytes to ask for now at most, if so many are on their way; `None`: wait for what is.
    pub fn room(&mut self, now: Instant, on_the_way: u64) -> Option<u32> {
        let limit = match self.phase {
            Phase::Draining { .. } => u64::from(self.piece),
            _ => self.limit,
        };
        if on_the_way > 0 && on_the_way + u64::from(self.piece / 2) > limit {
            if let Some(round) = self.round.as_mut() {
                round.full = true;
            }
            return None;
        }
        self.round.get_or_insert(Round::new(now));
        Some(self.piece)
    }

    /// A piece came.
    pub fn on_piece(&mut self, now: Instant, asked_at: Instant, bytes: u32) {
        let took = now.saturating_duration_since(asked_at);
        self.smoothed = Some(match self.smoothed {
            Some(smoothed) => (smoothed * 7 + took) / 8,
            None => took,
        });
        // A shorter one, the last of all, takes less for no reason of the link's.
        let usual = bytes == self.piece;
        match self.phase {
            Phase::Draining { since } if asked_at >= since && usual => {
                self.base = Some(Base {
                    least: took,
                    at: now,
                });
                self.phase = Phase::Steady;
                // The rate of this round is that of one piece at a time.
                self.round = Some(Round::new(now));
                return;
            }
            _ if usual => self.on_usual(now, took),
            _ => {}
        }
        let round = self.round.get_or_insert(Round::new(now));
        round.bytes += u64::from(bytes);
        if usual {
            round.least = Some(round.least.map_or(took, |least| least.min(took)));
        }
        if asked_at >= round.since {
            let done = std::mem::replace(round, Round::new(now));
            self.on_round(now, &done);
        }
    }

    fn on_usual(&mut self, now: Instant, took: Duration) {
        let least = self.base.map(|base| base.least);
        // Nearly as little counts as the same, or a jitter of microseconds would make it older than it is.
        if least.is_none_or(|least| took <= least + least / 32) {
            let least = least.map_or(took, |least| least.min(took));
            self.base = Some(Base { least, at: now });
        }
    }

    fn on_round(&mut self, now: Instant, round: &Round) {
        let seconds = now.saturating_duration_since(round.since).as_secs_f64();
        let Some(base) = self.base.filter(|_| seconds > 0.0) else {
            return;
        };
        if !round.full || matches!(self.phase, Phase::Draining { .. }) {
            return;
        }
        let measured = round.bytes as f64 / seconds;
        let before = self.rate.replace(match (&self.phase, self.rate) {
            (Phase::Steady, Some(rate)) => (rate + measured) / 2.0,
            _ => measured,
        });
        let rate = self.rate.unwrap_or(measured).max(1.0);
        let headroom = f64::from(self.piece).max(rate * SLACK.as_secs_f64());
        let on_the_way = rate * base.least.as_secs_f64();
        let waited = round.least.map(|least| least.saturating_sub(base.least));
        match self.phase {
            Phase::Opening { flat } => {
                let grew = before.is_none_or(|before| measured > before * 1.25);
                let flat = if grew { 0 } else { flat + 1 };
                let waits = waited.is_some_and(|w| w.as_secs_f64() > 0.75 * headroom / rate);
                if waits || flat == 3 {
                    self.phase = Phase::Steady;
                    self.limit = (on_the_way + headroom) as u64;
                } else {
                    self.phase = Phase::Opening { flat };
                    self.limit = (on_the_way + on_the_way + headroom) as u64;
                }
            }
            _ => {
                let wanted = on_the_way + headroom;
                self.limit = ((self.limit as f64 + wanted) / 2.0) as u64;
                if now.saturating_duration_since(base.at) > BASE_AGE {
                    self.phase = Phase::Draining { since: now };
                }
            }
        }
        self.fit_piece(rate);
        let piece = u64::from(self.piece);
        let most = MAX_LIMIT_BYTES.min(piece * MAX_REQUESTS);
        self.limit = self.limit.clamp(piece * 2, most);
    }

    /// The piece that takes about [`PIECE_TIME`], and is not changed for little.
    fn fit_piece(&mut self, rate: f64) {
        let ideal = rate * PIECE_TIME.as_secs_f64();
        let before = self.piece;
        // At first the rate is what was asked for, not what the link has.
        let steady = self.phase == Phase::Steady;
        // Four times at once is enough: the first rounds know little.
        for _ in 0..2 {
            if ideal >= f64::from(self.piece) * 2.0 && self.piece < MAX_PIECE_BYTES {
                self.piece *= 2;
            } else if steady && ideal * 1.5 < f64::from(self.piece) && self.piece > MIN_PIECE {
                self.piece /= 2;
            }
        }
        // A larger one takes longer. A guess may be too long, since what comes shows that it was; too short it would stay
        // for a while. So nothing is taken off for a smaller one.
        if let Some(base) = self.base.as_mut().filter(|_| before < self.piece) {
            base.least += Duration::from_secs_f64(f64::from(self.piece - before) / rate);
        }
    }

    /// One request got lost, while others are answered: somewhere it is full.
    pub fn on_lost(&mut self) {
        self.limit = (self.limit / 2).max(u64::from(self.piece) * 2);
        self.round = None;
        if matches!(self.phase, Phase::Opening { .. }) {
            self.phase = Phase::Steady;
        }
    }

    /// Nothing is answered any more. The next way may be another one.
    pub fn on_cut(&mut self) {
        *self = Self::default();
    }

    /// How long to wait for an answer.
    pub fn timeout(&self) -> Duration {
        let (least, most) = TIMEOUTS;
        self.smoothed
            .map_or(least * 2, |s| (s * 4).clamp(least, most))
    }

    /// The most that may be on its way, in bytes.
    pub fn limit_bytes(&self) -> u64 {
        self.limit
    }

    /// What a request asks for, in bytes.
    pub fn piece_bytes(&self) -> u32 {
        self.piece
    }
}

impl Round {
    fn new(since: Instant) -> Self {
        Self {
            since,
            bytes: 0,
            least: None,
            full: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_piece_may_always_be_asked_for() {
        let (mut window, now) = (Window::default(), Instant::now());
        assert_eq!(window.room(now, 0), Some(FIRST_PIECE));
        assert_eq!(window.room(now, u64::from(FIRST_PIECE)), Some(FIRST_PIECE));
        assert_eq!(window.room(now, u64::from(FIRST_PIECE) * 2), None);
    }

    #[test]
    fn a_clock_that_jumps_does_not_upset_it() {
        let (mut window, now) = (Window::default(), Instant::now());
        let day = Duration::from_secs(86_400);
        for n in 0..1000u32 {
            window.room(now, 0);
            window.room(now, u64::MAX / 2);
            let (came, asked) = match n % 4 {
                0 => (now + day, now),
                1 => (now, now + day),
                2 => (now, now),
                _ => (now + Duration::from_millis(100), now),
            };
            window.on_piece(came, asked, window.piece_bytes());
            let (limit, piece) = (window.limit_bytes(), window.piece_bytes());
            assert!((u64::from(piece) * 2..=MAX_LIMIT_BYTES).contains(&limit));
            assert!((MIN_PIECE..=MAX_PIECE_BYTES).contains(&piece));
            assert!(window.timeout() <= TIMEOUTS.1 && window.timeout() >= TIMEOUTS.0);
        }
    }

    #[test]
    fn what_is_lost_halves_it_and_a_cut_begins_anew() {
        let (mut window, mut now) = (Window::default(), Instant::now());
        for _ in 0..200 {
            let asked = now;
            window.room(now, 0);
            window.room(now, u64::MAX / 2);
            now += Duration::from_millis(1);
            window.on_piece(now, asked, window.piece_bytes());
        }
        let limit = window.limit_bytes();
        assert!(limit > 100_000, "{window:?}");
        window.on_lost();
        assert!(window.limit_bytes() <= limit.div_ceil(2).max(u64::from(window.piece_bytes()) * 2));
        window.on_cut();
        assert_eq!(window.limit_bytes(), u64::from(FIRST_PIECE) * 2);
    }
}

//! Decides how many bytes of a transfer may be in flight, and the size of pieces.
//!
//! Requested bytes that have not arrived yet are queued somewhere: in the sender, in routers, in the radio. Enough must
//! be requested to keep the narrowest link busy, but hardly more, because the excess only queues in front of that link
//! and may delay urgent messages. The two cases differ in the time that a piece takes: as long as nothing queues,
//! requesting more increases the throughput; as soon as pieces queue, it only makes each piece take longer.
//!
//! So the limit is `rate * base + headroom`: the throughput of the last round trips, times the time that a piece takes
//! when nothing queues in front of it, plus one piece that queues. `base` is the shortest time that a piece took
//! recently. A permanent queue of the transfer itself would eventually be mistaken for a part of the delay. Therefore,
//! every 15 s, one piece is requested alone and the base is measured again.
use std::time::{Duration, Instant};

use super::MAX_PIECE_BYTES;

/// The size of the first pieces, while nothing is known of the link.
const FIRST_PIECE: u32 = 2048;
/// The minimum size of pieces. A reply has an overhead of about 60 bytes.
const MIN_PIECE: u32 = 1024;
/// The target duration of a piece on the link. It delays other transfers, and urgent messages on links without
/// priorities (RECT's links have them). With half of it, requests and headers took 4 % more of a Bluetooth link.
const PIECE_TIME: Duration = Duration::from_millis(128);
/// The minimum time for which data may queue at the narrowest link, because programs do not respond instantly.
const SLACK: Duration = Duration::from_millis(5);
/// The maximum number of bytes in flight, which is also the maximum memory of a transfer that is stored in a file.
pub const MAX_LIMIT_BYTES: u64 = 4 << 20;
/// The maximum number of requests in flight.
const MAX_REQUESTS: u64 = 64;
/// How long the shortest time of a piece remains valid.
const BASE_AGE: Duration = Duration::from_secs(15);
/// The minimum and the maximum timeout of a request.
const TIMEOUTS: (Duration, Duration) = (Duration::from_secs(2), Duration::from_secs(30));

/// The window of a transfer: how much may be in flight.
#[derive(Clone, Debug)]
pub struct Window {
    phase: Phase,
    piece: u32,
    limit: u64,
    base: Option<Base>,
    /// Throughput in bytes per second.
    rate: Option<f64>,
    /// Mean time that a piece took recently.
    smoothed: Option<Duration>,
    round: Option<Round>,
}

#[derive(Clone, Debug, PartialEq)]
enum Phase {
    /// Nothing seems to queue yet: the limit doubles each round.
    Opening {
        /// Number of rounds in which the throughput did not grow.
        flat: u32,
    },
    /// The limit follows from the throughput and the base.
    Steady,
    /// One piece at a time, until a piece that was requested since then has arrived.
    Draining { since: Instant },
}

/// The time that a piece takes when nothing queues in front of it.
#[derive(Clone, Copy, Debug)]
struct Base {
    shortest: Duration,
    at: Instant,
}

/// A round lasts from the arrival of a piece to the arrival of the first piece that was requested after it.
#[derive(Clone, Debug)]
struct Round {
    since: Instant,
    bytes: u64,
    shortest: Option<Duration>,
    /// Whether more could have been requested than the limit allowed.
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
    /// Returns the maximum number of bytes to request now, given the bytes in flight. `None` to wait until some of
    /// those have arrived.
    pub fn room(&mut self, now: Instant, in_flight: u64) -> Option<u32> {
        let limit = match self.phase {
            Phase::Draining { .. } => u64::from(self.piece),
            _ => self.limit,
        };
        if in_flight > 0 && in_flight + u64::from(self.piece / 2) > limit {
            if let Some(round) = self.round.as_mut() {
                round.full = true;
            }
            return None;
        }
        self.round.get_or_insert(Round::new(now));
        Some(self.piece)
    }

    /// Handles the arrival of a piece of `bytes` bytes that was requested at `requested_at`.
    pub fn on_piece(&mut self, now: Instant, requested_at: Instant, bytes: u32) {
        let elapsed = now.saturating_duration_since(requested_at);
        self.smoothed = Some(match self.smoothed {
            Some(smoothed) => (smoothed * 7 + elapsed) / 8,
            None => elapsed,
        });
        // The last piece may be shorter, and then takes less time for reasons that have nothing to do with the link.
        let is_full_size = bytes == self.piece;
        match self.phase {
            Phase::Draining { since } if requested_at >= since && is_full_size => {
                self.base = Some(Base {
                    shortest: elapsed,
                    at: now,
                });
                self.phase = Phase::Steady;
                // The throughput of this round is that of one piece at a time.
                self.round = Some(Round::new(now));
                return;
            }
            _ if is_full_size => self.on_full_size_piece(now, elapsed),
            _ => {}
        }
        let round = self.round.get_or_insert(Round::new(now));
        round.bytes += u64::from(bytes);
        if is_full_size {
            round.shortest = Some(
                round
                    .shortest
                    .map_or(elapsed, |shortest| shortest.min(elapsed)),
            );
        }
        if requested_at >= round.since {
            let done = std::mem::replace(round, Round::new(now));
            self.on_round(now, &done);
        }
    }

    /// Updates the base with the time that a piece took.
    fn on_full_size_piece(&mut self, now: Instant, elapsed: Duration) {
        let shortest = self.base.map(|base| base.shortest);
        // Almost the same time counts as equal; otherwise a jitter of microseconds would make the measurement look
        // outdated.
        if shortest.is_none_or(|shortest| elapsed <= shortest + shortest / 32) {
            let shortest = shortest.map_or(elapsed, |shortest| shortest.min(elapsed));
            self.base = Some(Base { shortest, at: now });
        }
    }

    /// Updates the throughput, the limit and the size of pieces at the end of a round.
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
        let in_flight = rate * base.shortest.as_secs_f64();
        let waited = round
            .shortest
            .map(|shortest| shortest.saturating_sub(base.shortest));
        match self.phase {
            Phase::Opening { flat } => {
                let grew = before.is_none_or(|before| measured > before * 1.25);
                let flat = if grew { 0 } else { flat + 1 };
                let queues = waited.is_some_and(|w| w.as_secs_f64() > 0.75 * headroom / rate);
                if queues || flat == 3 {
                    self.phase = Phase::Steady;
                    self.limit = (in_flight + headroom) as u64;
                } else {
                    self.phase = Phase::Opening { flat };
                    self.limit = (in_flight + in_flight + headroom) as u64;
                }
            }
            _ => {
                let target = in_flight + headroom;
                self.limit = ((self.limit as f64 + target) / 2.0) as u64;
                if now.saturating_duration_since(base.at) > BASE_AGE {
                    self.phase = Phase::Draining { since: now };
                }
            }
        }
        self.fit_piece(rate);
        let piece = u64::from(self.piece);
        let max = MAX_LIMIT_BYTES.min(piece * MAX_REQUESTS);
        self.limit = self.limit.clamp(piece * 2, max);
    }

    /// Adapts the size of pieces to [`PIECE_TIME`], with some hysteresis.
    fn fit_piece(&mut self, rate: f64) {
        let ideal = rate * PIECE_TIME.as_secs_f64();
        let before = self.piece;
        // At first, the throughput is limited by the requests and not by the link.
        let steady = self.phase == Phase::Steady;
        // At most a factor of four at once, because little is known in the first rounds.
        for _ in 0..2 {
            if ideal >= f64::from(self.piece) * 2.0 && self.piece < MAX_PIECE_BYTES {
                self.piece *= 2;
            } else if steady && ideal * 1.5 < f64::from(self.piece) && self.piece > MIN_PIECE {
                self.piece /= 2;
            }
        }
        // A larger piece takes longer, so the base is increased by an estimate. If that is too high, the next pieces
        // correct it; one that is too low would persist. So nothing is subtracted for a smaller piece.
        if let Some(base) = self.base.as_mut().filter(|_| before < self.piece) {
            base.shortest += Duration::from_secs_f64(f64::from(self.piece - before) / rate);
        }
    }

    /// Handles the loss of one request while others are answered, which indicates congestion.
    pub fn on_lost(&mut self) {
        self.limit = (self.limit / 2).max(u64::from(self.piece) * 2);
        self.round = None;
        if matches!(self.phase, Phase::Opening { .. }) {
            self.phase = Phase::Steady;
        }
    }

    /// Handles an interruption: no request is answered any more. The next route may be another one.
    pub fn on_interruption(&mut self) {
        *self = Self::default();
    }

    /// Returns the timeout of a request.
    pub fn timeout(&self) -> Duration {
        let (min, max) = TIMEOUTS;
        self.smoothed.map_or(min * 2, |s| (s * 4).clamp(min, max))
    }

    /// Returns the maximum number of bytes in flight.
    pub fn limit_bytes(&self) -> u64 {
        self.limit
    }

    /// Returns the current size of pieces, in bytes.
    pub fn piece_bytes(&self) -> u32 {
        self.piece
    }
}

impl Round {
    fn new(since: Instant) -> Self {
        Self {
            since,
            bytes: 0,
            shortest: None,
            full: false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_piece_can_always_be_requested() {
        let (mut window, now) = (Window::default(), Instant::now());
        assert_eq!(window.room(now, 0), Some(FIRST_PIECE));
        assert_eq!(window.room(now, u64::from(FIRST_PIECE)), Some(FIRST_PIECE));
        assert_eq!(window.room(now, u64::from(FIRST_PIECE) * 2), None);
    }

    #[test]
    fn stays_within_its_limits_if_the_clock_jumps() {
        let (mut window, now) = (Window::default(), Instant::now());
        let day = Duration::from_secs(86_400);
        for n in 0..1000u32 {
            window.room(now, 0);
            window.room(now, u64::MAX / 2);
            let (arrived, requested) = match n % 4 {
                0 => (now + day, now),
                1 => (now, now + day),
                2 => (now, now),
                _ => (now + Duration::from_millis(100), now),
            };
            window.on_piece(arrived, requested, window.piece_bytes());
            let (limit, piece) = (window.limit_bytes(), window.piece_bytes());
            assert!((u64::from(piece) * 2..=MAX_LIMIT_BYTES).contains(&limit));
            assert!((MIN_PIECE..=MAX_PIECE_BYTES).contains(&piece));
            assert!(window.timeout() <= TIMEOUTS.1 && window.timeout() >= TIMEOUTS.0);
        }
    }

    #[test]
    fn losses_halve_the_window_and_interruptions_reset_it() {
        let (mut window, mut now) = (Window::default(), Instant::now());
        for _ in 0..200 {
            let requested = now;
            window.room(now, 0);
            window.room(now, u64::MAX / 2);
            now += Duration::from_millis(1);
            window.on_piece(now, requested, window.piece_bytes());
        }
        let limit = window.limit_bytes();
        assert!(limit > 100_000, "{window:?}");
        window.on_lost();
        assert!(window.limit_bytes() <= limit.div_ceil(2).max(u64::from(window.piece_bytes()) * 2));
        window.on_interruption();
        assert_eq!(window.limit_bytes(), u64::from(FIRST_PIECE) * 2);
    }
}

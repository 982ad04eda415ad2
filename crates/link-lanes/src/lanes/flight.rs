//! Keeps track of the bytes in flight to the peer and limits them: enough to keep the radio busy and no more, because
//! urgent batches cannot overtake SDUs that were already handed to the kernel and the controller.
//!
//! The limit is adapted to the shortest time from an SDU to its acknowledgement within a round. If even that SDU waited
//! behind others, too much was in flight. (The shortest time is used rather than the mean, because a radio works in
//! connection events: an SDU that is sent just before one is fast, regardless of how long others wait.)
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{credits::ack_due_bytes, Lane, LANES};

/// How long an SDU may wait behind others, measured on the fastest SDU of a round.
const MAX_QUEUEING_DELAY: Duration = Duration::from_millis(7);
/// The shortest duration of a round: two to three of the connection intervals (30 to 50 ms) that Linux requests by
/// default.
const ROUND: Duration = Duration::from_millis(100);
/// The smallest number of acknowledgements in a round.
const MIN_ROUND_ACKS: u32 = 4;
/// The limit is reduced by its value divided by this number when too much was in flight.
const DECREASE_DIVISOR: u16 = 4;

/// An SDU in flight.
struct Sdu {
    lane: Lane,
    cost: u16,
    /// Bytes sent since the link began, including this SDU, modulo 2^16.
    total: u16,
    sent_at: Instant,
}

/// The measurements since the limit was last adapted.
struct Round {
    since: Instant,
    acks: u32,
    min_delay: Duration,
    /// Whether the limit was reached, so that another SDU of the largest size had to wait.
    was_full: bool,
}

/// The SDUs that were sent and not acknowledged yet, and the limit of their bytes.
pub struct Flight {
    sdus: VecDeque<Sdu>,
    costs: [u16; LANES],
    limit: u16,
    /// The smallest limit, in bytes. Three of the largest SDUs: one on the air, one to follow it, and one while an
    /// acknowledgement is returned. It is large enough that the sender never waits for an acknowledgement that is not due.
    floor: u16,
    /// Amount by which the limit is increased, in bytes: one of the largest SDUs.
    step: u16,
    window: u16,
    /// The shortest measured delay, which is taken for that of an SDU that waits behind no other.
    base_delay: Option<Duration>,
    round: Option<Round>,
}

impl Flight {
    /// Creates the state of a new link. `largest` is the cost of the largest SDU, and `window` the most that may be in
    /// flight, both in bytes.
    pub fn new(largest: u16, window: u16) -> Self {
        let until_acknowledged = ack_due_bytes(window).saturating_add(largest);
        let floor = largest.saturating_mul(3).max(until_acknowledged);
        let floor = floor.min(window);
        Self {
            sdus: VecDeque::new(),
            costs: [0; LANES],
            limit: floor,
            floor,
            step: largest,
            window,
            base_delay: None,
            round: None,
        }
    }

    /// Returns whether an SDU of that lane and cost may be sent. SDUs of less urgent lanes that are in flight do not
    /// count. If nothing else is in flight, an SDU of any cost may be sent.
    pub fn has_room(&self, lane: Lane, cost: u16) -> bool {
        let before = self.in_flight_bytes(lane);
        before == 0 || before + u32::from(cost) <= u32::from(self.limit)
    }

    /// Records that an SDU with a batch was sent, after which `total` bytes were sent since the link began.
    pub fn on_sent(&mut self, lane: Lane, cost: u16, total: u16, now: Instant) {
        self.sdus.push_back(Sdu {
            lane,
            cost,
            total,
            sent_at: now,
        });
        if let Some(lane_bytes) = self.costs.get_mut(lane.index()) {
            *lane_bytes = lane_bytes.saturating_add(cost);
        }
        let is_full =
            self.in_flight_bytes(Lane::last()) + u32::from(self.step) > u32::from(self.limit);
        if let Some(round) = self.round.as_mut() {
            round.was_full |= is_full;
        }
    }

    /// Handles an acknowledgement of `total` bytes since the link began. Returns the time since the last of their SDUs was
    /// sent, or `None` if `total` is not the total of an SDU in flight.
    pub fn on_ack(&mut self, total: u16, now: Instant) -> Option<Duration> {
        let mut last = None;
        while let Some(sdu) = self.sdus.front() {
            if total.wrapping_sub(sdu.total) > u16::MAX / 2 {
                break;
            }
            // Earlier SDUs waited at the receiver until the acknowledgement was due.
            last = (sdu.total == total).then_some(sdu.sent_at);
            if let Some(lane_bytes) = self.costs.get_mut(sdu.lane.index()) {
                *lane_bytes = lane_bytes.saturating_sub(sdu.cost);
            }
            self.sdus.pop_front();
        }
        let delay = now.saturating_duration_since(last?);
        self.base_delay = Some(self.base_delay.map_or(delay, |base| base.min(delay)));
        self.on_delay(delay, now);
        Some(delay)
    }

    /// Returns how many bytes may be in flight.
    pub fn limit(&self) -> u16 {
        self.limit
    }

    /// Adds a measurement to the round, and adapts the limit at the end of the round.
    fn on_delay(&mut self, delay: Duration, now: Instant) {
        let round = self.round.get_or_insert(Round {
            since: now,
            acks: 0,
            min_delay: delay,
            was_full: false,
        });
        round.acks += 1;
        round.min_delay = round.min_delay.min(delay);
        if round.acks < MIN_ROUND_ACKS || now.saturating_duration_since(round.since) < ROUND {
            return;
        }
        let (min_delay, was_full) = (round.min_delay, round.was_full);
        self.round = None;
        if was_full {
            self.adapt_limit(min_delay);
        }
    }

    /// Increases the limit if the fastest SDU of a round did not wait behind others, and reduces it otherwise.
    fn adapt_limit(&mut self, min_delay: Duration) {
        let base_delay = self.base_delay.unwrap_or(min_delay);
        if min_delay <= base_delay + MAX_QUEUEING_DELAY {
            self.limit = self.limit.saturating_add(self.step).min(self.window);
        } else if self.limit > self.floor {
            self.limit = (self.limit - self.limit / DECREASE_DIVISOR).max(self.floor);
        } else {
            // With so few bytes in flight, no SDU waits long. The path itself has become slower.
            self.base_delay = Some(min_delay);
        }
    }

    /// Returns the number of bytes in flight on that lane and on more urgent ones.
    fn in_flight_bytes(&self, lane: Lane) -> u32 {
        let costs = self.costs.iter().take(lane.index() + 1);
        costs.copied().map(u32::from).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COST: u16 = 760;
    const WINDOW: u16 = 12_000;

    /// A simulated path with a rate in bytes per second and a fixed delay.
    struct SimulatedPath {
        flight: Flight,
        now: Instant,
        total: u16,
        /// When the radio will have sent everything that was handed to it.
        free_at: Instant,
        acks: VecDeque<(Instant, u16)>,
        rate_bytes_per_s: f64,
        delay: Duration,
        /// The connection interval: acknowledgements arrive at multiples of it. Zero: at any time.
        interval: Duration,
        start: Instant,
    }

    impl SimulatedPath {
        fn new(rate_bytes_per_s: f64, delay: Duration, interval: Duration) -> Self {
            let now = Instant::now();
            Self {
                flight: Flight::new(COST, WINDOW),
                now,
                total: 0,
                free_at: now,
                acks: VecDeque::new(),
                rate_bytes_per_s,
                delay,
                interval,
                start: now,
            }
        }

        /// Sends as much as is allowed for `span`, and returns the number of bytes that were acknowledged.
        fn flood(&mut self, span: Duration) -> f64 {
            let (end, mut acknowledged) = (self.now + span, 0.0);
            let bulk = Lane::last();
            while self.now < end {
                while self.flight.has_room(bulk, COST) {
                    self.total = self.total.wrapping_add(COST);
                    self.flight.on_sent(bulk, COST, self.total, self.now);
                    let airtime = Duration::from_secs_f64(f64::from(COST) / self.rate_bytes_per_s);
                    self.free_at = self.free_at.max(self.now) + airtime;
                    let mut ack_at = self.free_at + self.delay;
                    if !self.interval.is_zero() {
                        let since = ack_at.duration_since(self.start).as_nanos();
                        let interval = self.interval.as_nanos();
                        ack_at += Duration::from_nanos((interval - since % interval) as u64);
                    }
                    self.acks.push_back((ack_at, self.total));
                }
                let (at, total) = self.acks.pop_front().expect("something is in flight");
                self.now = self.now.max(at);
                self.flight.on_ack(total, self.now);
                acknowledged += f64::from(COST);
            }
            acknowledged
        }

        fn limit_s(&self) -> f64 {
            f64::from(self.flight.limit()) / self.rate_bytes_per_s
        }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn radio_is_kept_busy_with_few_bytes_in_flight() {
        for rate in [34e3, 100e3, 170e3, 600e3] {
            for delay in [ms(1), ms(5), ms(12)] {
                let mut path = SimulatedPath::new(rate, delay, Duration::ZERO);
                path.flood(ms(3000));
                let share = path.flood(ms(10_000)) / (10.0 * rate);
                assert!(share > 0.98, "{rate} B/s, {delay:?}: {share}");
                let max_s = delay.as_secs_f64() + 0.010 + 4.5 * f64::from(COST) / rate;
                assert!(
                    path.limit_s() < max_s,
                    "{rate} B/s, {delay:?}: {} s",
                    path.limit_s()
                );
            }
        }
    }

    #[test]
    fn radio_that_answers_once_per_connection_interval_is_kept_busy() {
        for (rate, interval) in [(34e3, ms(50)), (90e3, ms(30)), (90e3, ms(50))] {
            let mut path = SimulatedPath::new(rate, ms(1), interval);
            path.flood(ms(3000));
            let share = path.flood(ms(10_000)) / (10.0 * rate);
            assert!(share > 0.95, "{rate} B/s, {interval:?}: {share}");
        }
    }

    #[test]
    fn limit_adapts_when_the_path_becomes_slower_or_faster() {
        let mut path = SimulatedPath::new(90e3, ms(2), Duration::ZERO);
        path.flood(ms(3000));
        path.delay = ms(60);
        path.flood(ms(5000));
        let share = path.flood(ms(10_000)) / (10.0 * 90e3);
        assert!(share > 0.95, "slower: {share}");
        path.delay = ms(2);
        path.flood(ms(5000));
        assert!(path.limit_s() < 0.050, "faster: {} s", path.limit_s());
    }

    #[test]
    fn urgent_lane_does_not_wait_for_less_urgent_ones() {
        let (mut flight, now) = (Flight::new(COST, WINDOW), Instant::now());
        let mut total = 0;
        while flight.has_room(Lane::last(), COST) {
            total += COST;
            flight.on_sent(Lane::last(), COST, total, now);
        }
        let urgent = Lane::new(1).expect("valid");
        assert!(flight.has_room(urgent, COST));
        while flight.has_room(urgent, COST) {
            total += COST;
            flight.on_sent(urgent, COST, total, now);
        }
        assert!(flight.has_room(Lane::new(0).expect("valid"), COST));
        assert!(flight.on_ack(total, now).is_some());
        assert!(flight.sdus.is_empty());
        assert_eq!(flight.costs, [0; LANES]);
    }
}

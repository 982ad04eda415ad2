//! Owns what is on its way to the peer, and how much of it may be: enough to keep the radio busy and no more, since what
//! was handed to the kernel and the controller cannot be overtaken any more.
//!
//! How much that is shows in how long an SDU takes to its acknowledgement, in the best moment of a while: when even that
//! one waited behind others, there was too much on the way. (It is the least, not the mean, because a radio works in
//! connection events: what comes just before one is quick, however much the others wait.)
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{credits::ack_due_bytes, Lane, LANES};

/// How long an SDU may wait behind others, in the best moment.
const WAIT: Duration = Duration::from_millis(7);
/// How long a best moment is looked for. Three of the connection intervals that BlueZ asks for.
const ROUND: Duration = Duration::from_millis(100);
/// The fewest acknowledgements that a round is judged by.
const ROUND_ACKS: u32 = 4;
/// What of the limit is taken off when too much was on its way, as a divisor.
const LESS: u16 = 4;

struct Sdu {
    lane: Lane,
    cost: u16,
    /// Bytes sent since the link began, this one included.
    total: u16,
    at: Instant,
}

/// What was seen since the limit was last thought over.
struct Round {
    since: Instant,
    acks: u32,
    least: Duration,
    /// Something had to wait for the limit.
    was_full: bool,
}

/// What was sent and not acknowledged yet.
pub struct Flight {
    sdus: VecDeque<Sdu>,
    costs: [u16; LANES],
    limit: u16,
    /// Three of the largest SDUs: one on the air, one to follow it, one while an acknowledgement comes back. Never so
    /// little that the sender waits for an acknowledgement before one is due.
    floor: u16,
    /// One of the largest SDUs.
    step: u16,
    window: u16,
    /// What an SDU takes that waits for none.
    base: Option<Duration>,
    round: Option<Round>,
}

impl Flight {
    /// `largest`: the cost of the largest SDU. `window`: the most that may be on its way, in bytes.
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
            base: None,
            round: None,
        }
    }

    /// Whether something of that lane may go. What is less urgent and went before does not count.
    pub fn has_room(&self, lane: Lane, cost: u16) -> bool {
        let before = self.on_its_way(lane);
        before == 0 || before + u32::from(cost) <= u32::from(self.limit)
    }

    /// An SDU with a batch went out; `total` bytes are now sent since the link began.
    pub fn on_sent(&mut self, lane: Lane, cost: u16, total: u16, now: Instant) {
        let at = now;
        self.sdus.push_back(Sdu {
            lane,
            cost,
            total,
            at,
        });
        if let Some(of_lane) = self.costs.get_mut(lane.index()) {
            *of_lane = of_lane.saturating_add(cost);
        }
        let is_full = self.on_its_way(Lane::last()) + u32::from(self.step) > u32::from(self.limit);
        if let Some(round) = self.round.as_mut() {
            round.was_full |= is_full;
        }
    }

    /// The peer has taken `total` bytes since the link began. Tells how long the last SDU of them took.
    pub fn on_ack(&mut self, total: u16, now: Instant) -> Option<Duration> {
        let mut last = None;
        while let Some(sdu) = self.sdus.front() {
            if total.wrapping_sub(sdu.total) > u16::MAX / 2 {
                break;
            }
            // The one before it waited for the acknowledgement, at the receiver.
            last = (sdu.total == total).then_some(sdu.at);
            if let Some(of_lane) = self.costs.get_mut(sdu.lane.index()) {
                *of_lane = of_lane.saturating_sub(sdu.cost);
            }
            self.sdus.pop_front();
        }
        let took = now.saturating_duration_since(last?);
        self.base = Some(self.base.map_or(took, |base| base.min(took)));
        self.look(took, now);
        Some(took)
    }

    /// What may be on its way, in bytes.
    pub fn limit(&self) -> u16 {
        self.limit
    }

    fn look(&mut self, took: Duration, now: Instant) {
        let round = self.round.get_or_insert(Round {
            since: now,
            acks: 0,
            least: took,
            was_full: false,
        });
        round.acks += 1;
        round.least = round.least.min(took);
        if round.acks < ROUND_ACKS || now.saturating_duration_since(round.since) < ROUND {
            return;
        }
        let (least, was_full) = (round.least, round.was_full);
        self.round = None;
        if was_full {
            self.think(least);
        }
    }

    fn think(&mut self, least: Duration) {
        let base = self.base.unwrap_or(least);
        if least <= base + WAIT {
            self.limit = self.limit.saturating_add(self.step).min(self.window);
        } else if self.limit > self.floor {
            self.limit = (self.limit - self.limit / LESS).max(self.floor);
        } else {
            // With so little on its way nothing waits long: the way itself has become slower.
            self.base = Some(least);
        }
    }

    fn on_its_way(&self, lane: Lane) -> u32 {
        let costs = self.costs.iter().take(lane.index() + 1);
        costs.copied().map(u32::from).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COST: u16 = 760;
    const WINDOW: u16 = 12_000;

    /// A way that carries so many bytes a second, and takes a fixed time besides.
    struct Way {
        flight: Flight,
        now: Instant,
        total: u16,
        /// When the radio will have carried what it was given.
        free_at: Instant,
        acks: VecDeque<(Instant, u16)>,
        rate_bytes_per_s: f64,
        besides: Duration,
        /// When the acknowledgements come: at the next multiple of it.
        event: Duration,
        start: Instant,
    }

    impl Way {
        fn new(rate_bytes_per_s: f64, besides: Duration, event: Duration) -> Self {
            let now = Instant::now();
            Self {
                flight: Flight::new(COST, WINDOW),
                now,
                total: 0,
                free_at: now,
                acks: VecDeque::new(),
                rate_bytes_per_s,
                besides,
                event,
                start: now,
            }
        }

        /// Sends all that may be sent, for so long; tells how many bytes were taken.
        fn flood(&mut self, span: Duration) -> f64 {
            let (end, mut taken) = (self.now + span, 0.0);
            let bulk = Lane::last();
            while self.now < end {
                while self.flight.has_room(bulk, COST) {
                    self.total = self.total.wrapping_add(COST);
                    self.flight.on_sent(bulk, COST, self.total, self.now);
                    let airtime = Duration::from_secs_f64(f64::from(COST) / self.rate_bytes_per_s);
                    self.free_at = self.free_at.max(self.now) + airtime;
                    let mut heard = self.free_at + self.besides;
                    if !self.event.is_zero() {
                        let since = heard.duration_since(self.start).as_nanos();
                        let event = self.event.as_nanos();
                        heard += Duration::from_nanos((event - since % event) as u64);
                    }
                    self.acks.push_back((heard, self.total));
                }
                let (at, total) = self.acks.pop_front().expect("something is on its way");
                self.now = self.now.max(at);
                self.flight.on_ack(total, self.now);
                taken += f64::from(COST);
            }
            taken
        }

        fn limit_s(&self) -> f64 {
            f64::from(self.flight.limit()) / self.rate_bytes_per_s
        }
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn the_radio_is_kept_busy_with_little_on_the_way() {
        for rate in [34e3, 100e3, 170e3, 600e3] {
            for besides in [ms(1), ms(5), ms(12)] {
                let mut way = Way::new(rate, besides, Duration::ZERO);
                way.flood(ms(3000));
                let share = way.flood(ms(10_000)) / (10.0 * rate);
                assert!(share > 0.98, "{rate} B/s, {besides:?}: {share}");
                let most = besides.as_secs_f64() + 0.010 + 4.5 * f64::from(COST) / rate;
                assert!(
                    way.limit_s() < most,
                    "{rate} B/s, {besides:?}: {} s",
                    way.limit_s()
                );
            }
        }
    }

    #[test]
    fn a_radio_that_answers_only_once_an_interval_is_kept_busy_too() {
        for (rate, interval) in [(34e3, ms(50)), (90e3, ms(30)), (90e3, ms(50))] {
            let mut way = Way::new(rate, ms(1), interval);
            way.flood(ms(3000));
            let share = way.flood(ms(10_000)) / (10.0 * rate);
            assert!(share > 0.95, "{rate} B/s, {interval:?}: {share}");
        }
    }

    #[test]
    fn a_way_that_becomes_slower_or_quicker_is_learnt_again() {
        let mut way = Way::new(90e3, ms(2), Duration::ZERO);
        way.flood(ms(3000));
        way.besides = ms(60);
        way.flood(ms(5000));
        let share = way.flood(ms(10_000)) / (10.0 * 90e3);
        assert!(share > 0.95, "slower: {share}");
        way.besides = ms(2);
        way.flood(ms(5000));
        assert!(way.limit_s() < 0.050, "quicker: {} s", way.limit_s());
    }

    #[test]
    fn what_is_urgent_waits_for_nothing_less_urgent() {
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

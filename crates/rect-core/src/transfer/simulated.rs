//! Simulates a link in virtual time for tests. Requests travel in one direction; replies share the rate of the other
//! direction and queue. The link may be interrupted and may lose requests. The seed determines everything.
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    ops::Range,
    time::{Duration, Instant},
};

use super::{
    answer::Fault,
    ranges::Ranges,
    receiver::{PieceRequest, Receiver, Step},
};

/// A xorshift generator.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 16) % limit
    }
}

/// An interruption of the link. `reported`: pending requests fail immediately, as when a router detects the
/// interruption; otherwise only the timeouts detect it.
#[derive(Clone)]
pub struct Interruption {
    pub at: Duration,
    pub lasts: Duration,
    pub reported: bool,
}

#[derive(Clone)]
pub struct Link {
    pub rate_bytes_per_s: f64,
    pub round_trip: Duration,
    /// Overhead of a reply, in bytes.
    pub overhead_bytes: u32,
    /// Messages arrive at multiples of this interval, like a radio's connection events. Zero for no such interval.
    pub interval: Duration,
    /// Number of requests per thousand that are lost silently.
    pub lost_per_mille: u64,
    pub interruptions: Vec<Interruption>,
    pub seed: u64,
    /// Time after which the rate changes, and the new rate.
    pub then: Option<(Duration, f64)>,
}

impl Link {
    pub fn new(rate_bytes_per_s: f64, round_trip_ms: u64) -> Self {
        Self {
            rate_bytes_per_s,
            round_trip: Duration::from_millis(round_trip_ms),
            overhead_bytes: 60,
            interval: Duration::ZERO,
            lost_per_mille: 0,
            interruptions: Vec::new(),
            seed: 1,
            then: None,
        }
    }
}

/// The result of one transfer.
#[derive(Debug, Default)]
pub struct Result {
    pub took: Duration,
    /// Bytes that the sender sent.
    pub sent_bytes: u64,
    /// Maximum number of bytes in flight.
    pub max_in_flight: u64,
    /// How long each reply queued in front of the link, sorted.
    pub waits: Vec<Duration>,
    pub ended: Option<std::result::Result<(), Fault>>,
}

impl Result {
    /// Returns a percentile of the waits.
    pub fn wait(&self, per_cent: usize) -> Duration {
        let last = self.waits.len().saturating_sub(1);
        self.waits
            .get(last * per_cent / 100)
            .copied()
            .unwrap_or_default()
    }
}

struct Flow {
    receiver: Receiver,
    result: Result,
    out: BTreeMap<u64, PieceRequest>,
    size: u64,
    wakes_at: Option<Instant>,
}

#[derive(Clone)]
enum Event {
    Request(usize, PieceRequest),
    Reply(usize, PieceRequest),
    TimedOut(usize, PieceRequest),
    Wake(usize),
    Interruption(bool),
}

/// Transfers over one link.
pub struct World {
    link: Link,
    pub start: Instant,
    pub now: Instant,
    events: BinaryHeap<Reverse<(Instant, u64)>>,
    pending: BTreeMap<u64, (u64, Event)>,
    next: u64,
    /// Incremented by each interruption. Messages of an earlier era never arrive.
    era: u64,
    busy_until: Instant,
    flows: Vec<Flow>,
    random: Random,
}

impl World {
    pub fn new(link: Link) -> Self {
        let start = Instant::now();
        let mut world = Self {
            start,
            now: start,
            events: BinaryHeap::new(),
            pending: BTreeMap::new(),
            next: 0,
            era: 0,
            busy_until: start,
            flows: Vec::new(),
            random: Random::new(link.seed),
            link,
        };
        for cut in world.link.interruptions.clone() {
            world.schedule(start + cut.at, Event::Interruption(cut.reported));
        }
        world
    }

    /// Adds a transfer.
    pub fn transfer(&mut self, size: u64) {
        self.resume(size, Ranges::default());
    }

    /// Adds a transfer that was partly received before.
    pub fn resume(&mut self, size: u64, held: Ranges) {
        let receiver = Receiver::new(self.now, size, held, Duration::from_secs(600));
        self.flows.push(Flow {
            receiver,
            result: Result::default(),
            out: BTreeMap::new(),
            size,
            wakes_at: None,
        });
    }

    /// Runs until all transfers have ended, or for at most `limit`, and returns the results.
    pub fn run(mut self, limit: Duration) -> Vec<Result> {
        (0..self.flows.len()).for_each(|flow| self.poll(flow));
        while let Some(Reverse((at, id))) = self.events.pop() {
            if at > self.start + limit || self.flows.iter().all(|f| f.result.ended.is_some()) {
                break;
            }
            self.now = at;
            if let Some((era, event)) = self.pending.remove(&id) {
                self.on_event(era, event);
            }
        }
        let done = |mut flow: Flow| {
            flow.result.waits.sort();
            flow.result
        };
        self.flows.into_iter().map(done).collect()
    }

    fn schedule(&mut self, at: Instant, event: Event) {
        self.events.push(Reverse((at, self.next)));
        self.pending.insert(self.next, (self.era, event));
        self.next += 1;
    }

    fn interruption_now(&self) -> Option<&Interruption> {
        let since = self.now - self.start;
        self.link
            .interruptions
            .iter()
            .find(|cut| (cut.at..cut.at + cut.lasts).contains(&since))
    }

    fn event_after(&self, at: Instant) -> Instant {
        let interval = self.link.interval.as_nanos().max(1);
        let since = (at - self.start).as_nanos().div_ceil(interval) * interval;
        self.start + Duration::from_nanos(since as u64)
    }

    fn rate(&self) -> f64 {
        match self.link.then {
            Some((after, rate)) if self.now - self.start >= after => rate,
            _ => self.link.rate_bytes_per_s,
        }
    }

    fn on_event(&mut self, era: u64, event: Event) {
        let one_way = self.link.round_trip / 2;
        match event {
            Event::Interruption(reported) => {
                self.era += 1;
                self.busy_until = self.now;
                let out = self.flows.iter().enumerate();
                let out = out.flat_map(|(n, flow)| {
                    flow.out.values().map(move |request| (n, request.clone()))
                });
                for (flow, request) in out.collect::<Vec<_>>() {
                    if reported {
                        self.schedule(self.now, Event::TimedOut(flow, request));
                    }
                }
            }
            Event::Request(flow, request) if era == self.era => {
                let bytes = request.range.end - request.range.start;
                self.flows[flow].result.sent_bytes += bytes;
                let starts = self.busy_until.max(self.now);
                self.flows[flow].result.waits.push(starts - self.now);
                let all = bytes + u64::from(self.link.overhead_bytes);
                self.busy_until = starts + Duration::from_secs_f64(all as f64 / self.rate());
                let arrives = self.event_after(self.busy_until + one_way);
                self.schedule(arrives, Event::Reply(flow, request));
            }
            Event::Reply(flow, request) if era == self.era => {
                let this = &mut self.flows[flow];
                this.out.remove(&request.id);
                let Range { start, end } = request.range;
                if this.receiver.on_reply(self.now, &request, end - start) {
                    this.receiver.on_written(start..end);
                }
                self.poll(flow);
            }
            Event::TimedOut(flow, request) => {
                let this = &mut self.flows[flow];
                this.out.remove(&request.id);
                this.receiver.on_no_reply(self.now, request.id);
                self.poll(flow);
            }
            Event::Wake(flow) => {
                self.flows[flow].wakes_at = None;
                self.poll(flow);
            }
            Event::Request(..) | Event::Reply(..) => {}
        }
    }

    /// Polls a receiver until it waits.
    fn poll(&mut self, flow: usize) {
        loop {
            let this = &mut self.flows[flow];
            match this.receiver.poll(self.now) {
                Step::Request(request) => {
                    this.out.insert(request.id, request.clone());
                    let out = this.receiver.in_flight_bytes();
                    this.result.max_in_flight = this.result.max_in_flight.max(out);
                    self.send(flow, request);
                }
                Step::Check => {
                    assert_eq!(this.receiver.held().bytes(), this.size);
                    this.receiver.on_checked(true);
                }
                Step::Wait(until) => {
                    if this.wakes_at.is_none_or(|at| until < at) {
                        this.wakes_at = Some(until);
                        let until = until.max(self.now + Duration::from_micros(1));
                        self.schedule(until, Event::Wake(flow));
                    }
                    return;
                }
                Step::Finished(how) => {
                    this.result.took = self.now - self.start;
                    this.result.ended.get_or_insert(how);
                    return;
                }
            }
        }
    }

    fn send(&mut self, flow: usize, request: PieceRequest) {
        if let Some(cut) = self.interruption_now() {
            if cut.reported {
                self.schedule(
                    self.now + Duration::from_millis(1),
                    Event::TimedOut(flow, request),
                );
            }
        } else if self.random.below(1000) >= self.link.lost_per_mille {
            let arrives = self.event_after(self.now + self.link.round_trip / 2);
            self.schedule(arrives, Event::Request(flow, request));
        }
    }
}

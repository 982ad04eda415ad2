//! A link in virtual time: requests go one way, replies share the rate of the other and wait for each other; it may be cut,
//! and lose requests. For tests; what happens follows from the seed.
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    ops::Range,
    time::{Duration, Instant},
};

use super::{
    answer::Fault,
    ranges::Ranges,
    receiver::{Ask, Receiver, Step},
};

/// Xorshift.
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

/// The link is away from `at` on, for so long. `told`: whoever has a request out is told at once, as a router does when it
/// notices; else only the timeouts tell.
#[derive(Clone)]
pub struct Cut {
    pub at: Duration,
    pub lasts: Duration,
    pub told: bool,
}

#[derive(Clone)]
pub struct Link {
    pub rate_bytes_per_s: f64,
    pub round_trip: Duration,
    /// What a reply costs beside its bytes.
    pub overhead_bytes: u32,
    /// Everything arrives at multiples of this, as with a radio's connection events; zero: at once.
    pub interval: Duration,
    /// Of a thousand requests, how many get lost without a word.
    pub lost_per_mille: u64,
    pub cuts: Vec<Cut>,
    pub seed: u64,
    /// After so long the rate is another one.
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
            cuts: Vec::new(),
            seed: 1,
            then: None,
        }
    }
}

/// What one transfer came to.
#[derive(Debug, Default)]
pub struct Result {
    pub took: Duration,
    /// What the sender sent.
    pub sent_bytes: u64,
    /// The most that was on its way.
    pub most_out: u64,
    /// How long each reply waited in front of the narrow link, in order of length.
    pub waits: Vec<Duration>,
    pub ended: Option<std::result::Result<(), Fault>>,
}

impl Result {
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
    out: BTreeMap<u64, Ask>,
    size: u64,
    wakes_at: Option<Instant>,
}

#[derive(Clone)]
enum Event {
    Request(usize, Ask),
    Reply(usize, Ask),
    Silence(usize, Ask),
    Wake(usize),
    Cut(bool),
}

/// Transfers over one link.
pub struct World {
    link: Link,
    pub start: Instant,
    pub now: Instant,
    events: BinaryHeap<Reverse<(Instant, u64)>>,
    what: BTreeMap<u64, (u64, Event)>,
    next: u64,
    /// What was under way before a cut never arrives.
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
            what: BTreeMap::new(),
            next: 0,
            era: 0,
            busy_until: start,
            flows: Vec::new(),
            random: Random::new(link.seed),
            link,
        };
        for cut in world.link.cuts.clone() {
            world.at(start + cut.at, Event::Cut(cut.told));
        }
        world
    }

    /// Adds a transfer of so many bytes.
    pub fn transfer(&mut self, size: u64) {
        self.resume(size, Ranges::default());
    }

    /// Adds one of which some is there.
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

    /// Until all have ended, or so long. What they came to.
    pub fn run(mut self, most: Duration) -> Vec<Result> {
        (0..self.flows.len()).for_each(|flow| self.turn(flow));
        while let Some(Reverse((at, id))) = self.events.pop() {
            if at > self.start + most || self.flows.iter().all(|f| f.result.ended.is_some()) {
                break;
            }
            self.now = at;
            if let Some((era, event)) = self.what.remove(&id) {
                self.happen(era, event);
            }
        }
        let done = |mut flow: Flow| {
            flow.result.waits.sort();
            flow.result
        };
        self.flows.into_iter().map(done).collect()
    }

    fn at(&mut self, at: Instant, event: Event) {
        self.events.push(Reverse((at, self.next)));
        self.what.insert(self.next, (self.era, event));
        self.next += 1;
    }

    fn cut_now(&self) -> Option<&Cut> {
        let since = self.now - self.start;
        self.link
            .cuts
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

    fn happen(&mut self, era: u64, event: Event) {
        let one_way = self.link.round_trip / 2;
        match event {
            Event::Cut(told) => {
                self.era += 1;
                self.busy_until = self.now;
                let out = self.flows.iter().enumerate();
                let out =
                    out.flat_map(|(n, flow)| flow.out.values().map(move |ask| (n, ask.clone())));
                for (flow, ask) in out.collect::<Vec<_>>() {
                    if told {
                        self.at(self.now, Event::Silence(flow, ask));
                    }
                }
            }
            Event::Request(flow, ask) if era == self.era => {
                let bytes = ask.range.end - ask.range.start;
                self.flows[flow].result.sent_bytes += bytes;
                let starts = self.busy_until.max(self.now);
                self.flows[flow].result.waits.push(starts - self.now);
                let all = bytes + u64::from(self.link.overhead_bytes);
                self.busy_until = starts + Duration::from_secs_f64(all as f64 / self.rate());
                let arrives = self.event_after(self.busy_until + one_way);
                self.at(arrives, Event::Reply(flow, ask));
            }
            Event::Reply(flow, ask) if era == self.era => {
                let this = &mut self.flows[flow];
                this.out.remove(&ask.ticket);
                let Range { start, end } = ask.range;
                if this.receiver.on_reply(self.now, &ask, end - start) {
                    this.receiver.on_kept(start..end);
                }
                self.turn(flow);
            }
            Event::Silence(flow, ask) => {
                let this = &mut self.flows[flow];
                this.out.remove(&ask.ticket);
                this.receiver.on_silence(self.now, ask.ticket);
                self.turn(flow);
            }
            Event::Wake(flow) => {
                self.flows[flow].wakes_at = None;
                self.turn(flow);
            }
            Event::Request(..) | Event::Reply(..) => {}
        }
    }

    fn turn(&mut self, flow: usize) {
        loop {
            let this = &mut self.flows[flow];
            match this.receiver.poll(self.now) {
                Step::Ask(ask) => {
                    this.out.insert(ask.ticket, ask.clone());
                    let out = this.receiver.on_the_way_bytes();
                    this.result.most_out = this.result.most_out.max(out);
                    self.send(flow, ask);
                }
                Step::Check => {
                    assert_eq!(this.receiver.held().bytes(), this.size);
                    this.receiver.on_checked(true);
                }
                Step::Wait(until) => {
                    if this.wakes_at.is_none_or(|at| until < at) {
                        this.wakes_at = Some(until);
                        let until = until.max(self.now + Duration::from_micros(1));
                        self.at(until, Event::Wake(flow));
                    }
                    return;
                }
                Step::Over(how) => {
                    this.result.took = self.now - self.start;
                    this.result.ended.get_or_insert(how);
                    return;
                }
            }
        }
    }

    fn send(&mut self, flow: usize, ask: Ask) {
        if let Some(cut) = self.cut_now() {
            if cut.told {
                self.at(
                    self.now + Duration::from_millis(1),
                    Event::Silence(flow, ask),
                );
            }
        } else if self.random.below(1000) >= self.link.lost_per_mille {
            let arrives = self.event_after(self.now + self.link.round_trip / 2);
            self.at(arrives, Event::Request(flow, ask));
        }
    }
}

//! Two routers and the links between them during outages, in virtual time. Zenoh's sessions are modelled as Zenoh 1.10 treats them:
//! a link that completes the handshake is added to the session with that peer, if there is one; a session that loses its
//! last link is closed some time later; and it may be closed a second time, by the peer's identifier.
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use zenoh_protocol::core::{WhatAmI, ZenohIdProto};

use super::{
    ledger::{HoldId, LastReceived, Ledger, Step},
    ZenohNode, ZenohPair, MAX_WAIT,
};

const MS: Duration = Duration::from_millis(1);
const TICK: Duration = Duration::from_millis(20);
const LEASE: Duration = Duration::from_secs(10);
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
/// The time between two messages of the handshake.
const LATENCY: Duration = Duration::from_millis(40);
/// How soon data has to be back after an outage if Zenoh closes its session without delay.
const BACK_WITHIN: Duration = Duration::from_millis(2500);
const OUTAGES: u64 = 500;

/// A generator of random numbers.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }

    fn ms(&mut self, range: std::ops::Range<u64>) -> Duration {
        Duration::from_millis(range.start + self.below(range.end - range.start))
    }

    fn is(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }
}

/// The effect of a new link on an earlier one with the same peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// `ble/` or `any/`: the hello of the new link ends the earlier one.
    Replaced,
    /// `tcp/`: the new link knows nothing of the earlier one.
    Independent,
}

/// Whether links wait for their predecessors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rule {
    Succession,
    None,
}

type LinkNumber = usize;

/// One end of a link.
struct End {
    received: Arc<LastReceived>,
    ended_at: Option<Instant>,
    hold: Option<HoldId>,
    is_released: bool,
}

struct Link {
    dialler: usize,
    ends: [End; 2],
    stage: Stage,
    stage_since: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// The accepting side has received the first message.
    Accepting,
    /// The dialling side has received the answer.
    Dialling,
    Open,
    Failed,
}

/// A session of one side with the other.
struct Session {
    links: Vec<LinkNumber>,
    founder: LinkNumber,
    hold: HoldId,
    /// When Zenoh closes it, after its last link.
    closes_at: Option<Instant>,
    /// When Zenoh forgets it.
    is_closed: bool,
    /// When the last of Zenoh's tasks ends.
    released_at: Option<Instant>,
    closes_again_at: Option<Instant>,
}

struct Side {
    pair: ZenohPair,
    ledger: Ledger,
    /// Zenoh's session with the peer, by its index.
    current: Option<usize>,
    sessions: Vec<Session>,
    dials: bool,
    dials_at: Instant,
    /// Since when Zenoh has no routes for the current session.
    is_without_routes: bool,
}

struct World {
    now: Instant,
    is_up: bool,
    kind: Kind,
    rule: Rule,
    sides: [Side; 2],
    links: Vec<Link>,
    random: Random,
    /// The longest time that Zenoh takes to close a session, in this run.
    close_ms: u64,
    last_keep_alive: Instant,
}

impl World {
    fn new(seed: u64, kind: Kind, rule: Rule) -> Self {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
        let now = Instant::now();
        let nodes = [(); 2].map(|()| ZenohNode {
            zid: ZenohIdProto::rand(),
            whatami: WhatAmI::Router,
        });
        let both_dial = random.is(50);
        let side = |own: usize| Side {
            pair: ZenohPair {
                own: nodes[own],
                peer: nodes[1 - own],
            },
            ledger: Ledger::default(),
            current: None,
            sessions: Vec::new(),
            dials: own == 0 || both_dial,
            dials_at: now,
            is_without_routes: false,
        };
        // A reader that has stopped and bulk on the way delay the close.
        let close_ms = match random.below(4) {
            0 => 4000,
            1 => 600,
            _ => 50,
        };
        Self {
            now,
            is_up: true,
            kind,
            rule,
            sides: [side(0), side(1)],
            links: Vec::new(),
            random,
            close_ms,
            last_keep_alive: now,
        }
    }

    /// Runs for that time, or until data flows if `until_flowing`.
    fn run(&mut self, time: Duration, until_flowing: bool) {
        let end = self.now + time;
        while self.now < end && !(until_flowing && self.flows()) {
            self.now += TICK;
            self.tick();
        }
    }

    fn tick(&mut self) {
        let now = self.now;
        let keeps_alive = now >= self.last_keep_alive + KEEP_ALIVE;
        if keeps_alive {
            self.last_keep_alive = now;
        }
        for number in 0..self.links.len() {
            self.tick_link(number, keeps_alive);
        }
        for own in 0..2 {
            self.tick_sessions(own);
            let side = &mut self.sides[own];
            if !side.dials || now < side.dials_at {
                continue;
            }
            side.dials_at = now + self.random.ms(200..1000);
            let is_connected =
                |link: &Link| link.stage != Stage::Failed && link.ends[own].ended_at.is_none();
            if self.is_up && !self.links.iter().any(is_connected) {
                self.dial(own);
            }
        }
    }

    fn dial(&mut self, dialler: usize) {
        let number = self.links.len();
        let fresh = || End {
            received: Arc::new(LastReceived::new(self.now)),
            ended_at: None,
            hold: None,
            is_released: false,
        };
        let link = Link {
            dialler,
            ends: [fresh(), fresh()],
            stage: Stage::Accepting,
            stage_since: self.now + LATENCY,
        };
        self.links.push(link);
        if self.kind == Kind::Replaced {
            for earlier in 0..number {
                self.end(earlier, 1 - dialler);
            }
        }
    }

    fn tick_link(&mut self, number: LinkNumber, keeps_alive: bool) {
        let now = self.now;
        let link = &self.links[number];
        if now < link.stage_since {
            return;
        }
        let (stage, dialler, waits_since) = (link.stage, link.dialler, link.stage_since);
        match stage {
            Stage::Failed => {}
            Stage::Open => {
                for side in 0..2 {
                    let peer_is_open = self.links[number].ends[1 - side].ended_at.is_none();
                    if self.is_up && peer_is_open && keeps_alive {
                        self.links[number].ends[side].received.set(now);
                    }
                    let end = &self.links[number].ends[side];
                    let is_silent = now >= end.received.get() + LEASE - LEASE / 20;
                    // A radio shows the end of a link at once. TCP repeats it at growing intervals.
                    let percent = match self.kind {
                        Kind::Replaced => 20,
                        Kind::Independent => 2,
                    };
                    let is_notified = self.is_up && !peer_is_open && self.random.is(percent);
                    if end.ended_at.is_none() && (is_silent || is_notified) {
                        self.end(number, side);
                    }
                }
            }
            Stage::Accepting | Stage::Dialling => {
                let side = match stage {
                    Stage::Accepting => 1 - dialler,
                    _ => dialler,
                };
                let is_ended = self.links[number]
                    .ends
                    .iter()
                    .any(|end| end.ended_at.is_some());
                if is_ended || !self.is_up || now >= waits_since + MAX_WAIT {
                    self.links[number].stage = Stage::Failed;
                    return;
                }
                let at = &mut self.sides[side];
                let step = match self.rule {
                    Rule::Succession => at.ledger.step(at.pair, waits_since, now),
                    Rule::None => Step::Proceed,
                };
                match step {
                    Step::Wait(_) => {}
                    Step::End(holds) => {
                        let is_held = |link: &Link| {
                            link.ends[side]
                                .hold
                                .is_some_and(|hold| holds.contains(&hold))
                        };
                        let silent: Vec<_> = (0..self.links.len())
                            .filter(|n| is_held(&self.links[*n]))
                            .collect();
                        silent.into_iter().for_each(|n| self.end(n, side));
                    }
                    Step::Proceed if stage == Stage::Accepting => {
                        self.links[number].stage = Stage::Dialling;
                        self.links[number].stage_since = now + LATENCY;
                    }
                    Step::Proceed => {
                        self.links[number].stage = Stage::Open;
                        let added = [1 - dialler, dialler].map(|side| self.add(number, side));
                        if added.contains(&false) {
                            self.end(number, 0);
                            self.end(number, 1);
                        }
                    }
                }
            }
        }
    }

    /// Adds a link to Zenoh's session, as Zenoh does. Returns `false` if Zenoh refuses it.
    fn add(&mut self, number: LinkNumber, side: usize) -> bool {
        let now = self.now;
        let is_inbound = self.links[number].dialler != side;
        let current = self.sides[side].current;
        if let Some(current) = current {
            let session = &self.sides[side].sessions[current];
            let is_other_inbound = |n: &LinkNumber| self.links[*n].dialler != side;
            if is_inbound && session.links.iter().any(is_other_inbound) {
                return false;
            }
        }
        self.links[number].ends[side].received.set(now);
        let received = Arc::clone(&self.links[number].ends[side].received);
        let at = &mut self.sides[side];
        self.links[number].ends[side].hold = Some(at.ledger.on_link(at.pair, received, LEASE));
        match current {
            Some(current) => at.sessions[current].links.push(number),
            None => {
                at.current = Some(at.sessions.len());
                at.is_without_routes = false;
                at.sessions.push(Session {
                    links: vec![number],
                    founder: number,
                    hold: at.ledger.on_session(at.pair),
                    closes_at: None,
                    is_closed: false,
                    released_at: None,
                    closes_again_at: None,
                });
            }
        }
        true
    }

    /// Ends a link on one side.
    fn end(&mut self, number: LinkNumber, side: usize) {
        let end = &mut self.links[number].ends[side];
        if end.ended_at.is_none() {
            end.ended_at = Some(self.now);
            if let Some(hold) = end.hold {
                self.sides[side].ledger.on_link_ended(hold);
            }
        }
    }

    /// Lets Zenoh notice the ends of its links, and close its sessions.
    fn tick_sessions(&mut self, side: usize) {
        let now = self.now;
        for index in 0..self.sides[side].sessions.len() {
            let links = self.sides[side].sessions[index].links.clone();
            for number in links {
                let end = &mut self.links[number].ends[side];
                let is_noticed = end.ended_at.is_some_and(|at| now >= at + 100 * MS);
                if !is_noticed || end.is_released {
                    continue;
                }
                end.is_released = true;
                let at = &mut self.sides[side];
                let session = &mut at.sessions[index];
                session.links.retain(|one| *one != number);
                if session.links.is_empty() && session.closes_at.is_none() {
                    let closes_at = now + self.random.ms(0..self.close_ms);
                    session.closes_at = Some(closes_at);
                    let is_late = self.random.is(20);
                    let late = if is_late { 0..900 } else { 0..30 };
                    session.released_at = Some(closes_at + self.random.ms(late));
                    if is_late {
                        session.closes_again_at = session.released_at;
                    }
                }
                if let Some(hold) = self.links[number].ends[side].hold.take() {
                    at.ledger.on_released(hold, now);
                }
            }
            let at = &mut self.sides[side];
            let session = &mut at.sessions[index];
            if session.closes_at.is_some_and(|at| at <= now) && !session.is_closed {
                session.is_closed = true;
                let _ = at.ledger.on_session_closed(session.hold, now);
                // Links that were added meanwhile end with it.
                let added = std::mem::take(&mut session.links);
                at.current = at.current.filter(|current| *current != index);
                added.into_iter().for_each(|number| {
                    self.end(number, side);
                    self.links[number].ends[side].is_released = true;
                    if let Some(hold) = self.links[number].ends[side].hold.take() {
                        self.sides[side].ledger.on_released(hold, now);
                    }
                });
            }
            let at = &mut self.sides[side];
            let session = &mut at.sessions[index];
            if session.closes_again_at.is_some_and(|at| at <= now) {
                session.closes_again_at = None;
                let damaged = at.ledger.on_session_closed(session.hold, now);
                if at.current.is_some() {
                    at.is_without_routes = true;
                    at.current = None;
                }
                if self.rule == Rule::Succession {
                    let is_damaged = |link: &Link| {
                        link.ends[side]
                            .hold
                            .is_some_and(|hold| damaged.contains(&hold))
                    };
                    let numbers: Vec<_> = (0..self.links.len())
                        .filter(|n| is_damaged(&self.links[*n]))
                        .collect();
                    numbers
                        .into_iter()
                        .for_each(|number| self.end(number, side));
                }
            }
            let at = &mut self.sides[side];
            let session = &mut at.sessions[index];
            if session.released_at.is_some_and(|at| at <= now) {
                session.released_at = None;
                at.ledger.on_released(session.hold, now);
            }
        }
    }

    /// Returns the sessions of both sides, if both have one.
    fn sessions(&self) -> Option<[&Session; 2]> {
        let [one, two] = &self.sides;
        Some([&one.sessions[one.current?], &two.sessions[two.current?]])
    }

    /// Returns whether data flows: both sides have one session, which began with the same links.
    fn flows(&self) -> bool {
        let Some([one, two]) = self.sessions() else {
            return false;
        };
        let is_open = |number: &LinkNumber| {
            let link = &self.links[*number];
            link.stage == Stage::Open && link.ends.iter().all(|end| end.ended_at.is_none())
        };
        let mut shared = one.links.iter().filter(|number| two.links.contains(number));
        let has_routes = !self.sides.iter().any(|side| side.is_without_routes);
        self.is_up && has_routes && self.is_consistent() && shared.any(is_open)
    }

    /// Returns whether the sessions of both sides are the same one.
    fn is_consistent(&self) -> bool {
        self.sessions().is_none_or(|[one, two]| {
            let founded_together = one.founder == two.founder;
            founded_together
                || (one.links.contains(&two.founder) && two.links.contains(&one.founder))
        })
    }
}

/// The results of many outages.
#[derive(Debug, Default)]
struct Outcome {
    /// Outages after which data did not flow for a minute, or did not flow ten seconds later.
    dead: u64,
    /// Outages after which it took longer than [`BACK_WITHIN`], although Zenoh closed its session at once.
    slow: u64,
    longest: Duration,
    /// The seed of the first outage that went wrong.
    seed: Option<u64>,
}

fn outages(kind: Kind, rule: Rule) -> Outcome {
    let mut outcome = Outcome::default();
    for seed in 0..OUTAGES {
        let mut world = World::new(seed, kind, rule);
        world.run(Duration::from_secs(20), true);
        assert!(world.flows(), "seed {seed}: no link");
        let time = world.random_time(3);
        world.run(time, false);
        world.is_up = false;
        // One side may see the end first.
        if world.random.is(30) {
            let (first, at) = (world.random.below(2) as usize, world.random.ms(0..10_000));
            world.run(at, false);
            (0..world.links.len()).for_each(|number| world.end(number, first));
            let time = world.random_time(50);
            world.run(time, false);
        } else {
            world.run(Duration::from_secs(2), false);
            let time = world.random_time(58);
            world.run(time, false);
        }
        world.is_up = true;
        let (back, closes_at_once) = (world.now, world.close_ms <= 50);
        world.run(Duration::from_secs(60), true);
        let took = world.now - back;
        let is_alive = world.flows();
        // A side that has noticed nothing is believed to be alive until it has been silent for a while.
        let limit = match kind {
            Kind::Replaced => BACK_WITHIN,
            Kind::Independent => BACK_WITHIN + 2 * MAX_WAIT + Duration::from_secs(2),
        };
        world.run(Duration::from_secs(10), false);
        let is_dead = !is_alive || !world.flows();
        let is_slow = closes_at_once && took > limit;
        outcome.longest = outcome.longest.max(took);
        outcome.dead += u64::from(is_dead);
        outcome.slow += u64::from(is_slow);
        if is_dead || is_slow {
            outcome.seed.get_or_insert(seed);
        }
    }
    outcome
}

impl World {
    fn random_time(&mut self, max_s: u64) -> Duration {
        self.random.ms(0..max_s * 1000)
    }
}

#[test]
fn data_flows_after_each_outage() {
    for kind in [Kind::Replaced, Kind::Independent] {
        let outcome = outages(kind, Rule::Succession);
        assert_eq!(
            (outcome.dead, outcome.slow),
            (0, 0),
            "{kind:?}: {outcome:?}"
        );
    }
}

#[test]
fn without_the_rule_links_stay_dead() {
    for kind in [Kind::Replaced, Kind::Independent] {
        let outcome = outages(kind, Rule::None);
        assert!(outcome.dead > OUTAGES / 100, "{kind:?}: {outcome:?}");
    }
}

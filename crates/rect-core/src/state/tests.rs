//! Runs the state of three robots in virtual time: values change while links are cut, programs and routers crash, robots get other
//! names, and their clocks are set. In some runs, several programs of a robot publish the same topic.
//! Run them with `cargo test -p rect-core state`.
use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use zenoh_keyexpr::{keyexpr, OwnedKeyExpr};

use super::{
    keeper::{Disk, Item, StateKeeper},
    page::{Kept, Order, Page, Question},
    program::ProgramState,
    retain::{Outcome, Retain},
    Origin, Position,
};
use crate::{
    catalogue::{token::Token, Instance},
    driver::{Action, Answer, Declaration, Driver, Event, Id, QueryId, Sample, Step},
    message::{
        attachment::Sent,
        encoding::Encoding,
        payload::Payload,
        retained::{live::Live, value::Value, Arrival},
        urgency::Urgency,
        Delivery, Inbound, Message,
    },
    name::{
        key::KeySpace,
        topic::{Pattern, Topic},
        Name,
    },
    stream::simulation::Random,
};

const ROBOTS: usize = 3;
const TOPICS: u64 = 7;
const YEAR_2026_MS: u64 = 1_795_000_000_000;
/// The patterns of the programs of a robot.
const PATTERNS: [&str; 3] = ["*/**", "*/t1", "*/t2"];

fn name(text: &str) -> Name {
    Name::new(text).expect("valid name")
}

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

fn place(robot: &str) -> KeySpace {
    KeySpace {
        fleet: name("rect"),
        robot: name(robot),
    }
}

/// Returns whether a program subscribes to a topic.
fn selects(program: usize, topic: &str) -> bool {
    program == 0 || PATTERNS[program].ends_with(&format!("/{topic}"))
}

fn topic(number: u64) -> Topic {
    Topic::new(&format!("t{number}")).expect("valid topic")
}

type Key = (Name, Topic);

struct Router {
    keeper: StateKeeper,
    run: u32,
    declared: BTreeMap<Id, Declaration>,
    /// The tokens that were reported to it, by subscription.
    seen: BTreeMap<Id, BTreeSet<String>>,
    /// The open queries: who asked, and with which id.
    queries: HashMap<QueryId, (Node, u64, Id)>,
}

struct Program {
    run: u32,
    state: ProgramState,
    /// The number of its subscription, unless it has ended it.
    subscription: Option<u64>,
    inbound: Inbound,
    /// The publication in progress, and those that follow.
    retain: Option<(Retain, Topic, Order)>,
    is_registered: bool,
    got: BTreeMap<Key, Origin>,
    all: BTreeSet<(Key, Origin)>,
}

/// A router, or a program of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Node {
    Router(usize),
    Program(usize, usize),
}

/// The links that something travels over, each with the number of its changes.
type Path = Vec<(usize, u64)>;

enum Happening {
    Poll(Node, u64),
    PollRetain(usize, usize, u64),
    /// To a router, by a path with the epochs of its links.
    Query {
        to: usize,
        run: u32,
        from: (Node, u64, Id),
        key: String,
        payload: Payload,
    },
    Event(Node, u64, Event),
    RetainEvent(usize, usize, u64, Event),
    Published(usize, u32, Sample, Path),
    Tokens,
    Set,
    Cut,
    Mend,
    CrashRouter,
    StartRouter(usize),
    Connect(usize, usize, u64),
    CrashProgram,
    StartProgram(usize, usize),
    Resubscribe(usize, usize),
    Unsubscribe(usize, usize, u64, u64),
    Subscribe(usize, usize, u64),
    Rename,
    SetClock,
}

struct World {
    now: Instant,
    random: Random,
    next: u64,
    happenings: BTreeMap<(Instant, u64), Box<(Happening, Path)>>,
    /// The links a-b, b-c and a-c: whether each is up, and how often that has changed.
    links: [(bool, u64); 3],
    has_mesh: bool,
    /// The names of the robots.
    names: [Name; ROBOTS],
    fleet: Name,
    /// The programs of each robot.
    programs_each: usize,
    /// Whether several programs publish the same topics.
    is_shared: bool,
    routers: [Option<Router>; ROBOTS],
    /// The bytes that each router has saved.
    disks: [Option<Vec<u8>>; ROBOTS],
    /// The time of day of each robot, in milliseconds since 1970. It stands still until it is set.
    clocks: [Arc<AtomicU64>; ROBOTS],
    programs: BTreeMap<(usize, usize), Program>,
    epochs: HashMap<Node, u64>,
    /// When each run of a node is polled next.
    planned: HashMap<(Node, u64), Instant>,
    faults: bool,
    /// Whether tokens may have changed since they were reported.
    has_new_tokens: bool,
    /// The order in which each keeper has published values.
    history: HashMap<Key, Vec<Origin>>,
    bytes: usize,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut world = Self {
            now: Instant::now(),
            random: Random(seed),
            next: 0,
            happenings: BTreeMap::new(),
            links: [(true, 0), (true, 0), (seed % 2 == 0, 0)],
            has_mesh: seed % 2 == 0,
            names: ["a", "b", "c"].map(name),
            fleet: name("rect"),
            programs_each: if seed % 5 == 0 { 3 } else { 2 },
            is_shared: seed % 3 != 0,
            routers: [None, None, None],
            disks: [None, None, None],
            clocks: std::array::from_fn(|_| Arc::new(AtomicU64::new(YEAR_2026_MS))),
            programs: BTreeMap::new(),
            epochs: HashMap::new(),
            planned: HashMap::new(),
            faults: true,
            has_new_tokens: false,
            history: HashMap::new(),
            bytes: 0,
        };
        for robot in 0..ROBOTS {
            world.start_router(robot);
            for program in 0..world.programs_each {
                world.start_program(robot, program);
            }
        }
        world
    }

    fn with_faults(seed: u64) -> Self {
        let mut world = Self::new(seed);
        // Fewer in most runs, which take half as long with them.
        let changes = if seed % 4 == 0 { 60 } else { 25 };
        for _ in 0..changes {
            world.within(0..60_000, Happening::Set);
        }
        for _ in 0..6 {
            world.within(1000..60_000, Happening::Cut);
        }
        for _ in 0..2 {
            world.within(1000..60_000, Happening::CrashRouter);
            world.within(1000..60_000, Happening::CrashProgram);
        }
        for _ in 0..4 {
            world.within(1000..60_000, Happening::SetClock);
        }
        // Only where each topic has one publisher: an older one can return if a router is restarted again before a program has reached it.
        let subscriptions = if world.is_shared { 0 } else { 10 };
        for _ in 0..subscriptions {
            let robot = world.below(ROBOTS as u64) as usize;
            let program = world.below(world.programs_each as u64) as usize;
            world.within(1000..60_000, Happening::Resubscribe(robot, program));
        }
        if seed % 7 < 2 {
            for _ in 0..=seed % 7 {
                world.within(1000..60_000, Happening::Rename);
            }
        }
        world
    }

    fn within(&mut self, range: std::ops::Range<u64>, happening: Happening) {
        let after = range.start + self.below(range.end - range.start);
        self.after(ms(after), happening, Vec::new());
    }

    fn after(&mut self, after: Duration, happening: Happening, path: Path) {
        self.next += 1;
        let happening = Box::new((happening, path));
        (self.happenings).insert((self.now + after, self.next), happening);
    }

    fn tokens_after(&mut self, range: std::ops::Range<u64>) {
        self.has_new_tokens = true;
        self.within(range, Happening::Tokens);
    }

    fn below(&mut self, end: u64) -> u64 {
        self.random.next() % end
    }

    /// Polls a node at that time, unless it is polled before.
    fn poll_at(&mut self, node: Node, epoch: u64, at: Instant) {
        let at = at.max(self.now);
        let planned = self.planned.get(&(node, epoch));
        if planned.is_none_or(|planned| *planned <= self.now || *planned > at) {
            self.planned.insert((node, epoch), at);
            let wait = at.saturating_duration_since(self.now);
            self.after(wait, Happening::Poll(node, epoch), Vec::new());
        }
    }

    fn place(&self, robot: usize) -> KeySpace {
        KeySpace {
            fleet: self.fleet.clone(),
            robot: self.names[robot].clone(),
        }
    }

    fn epoch(&mut self, node: Node) -> u64 {
        *self.epochs.entry(node).or_default()
    }

    fn restart(&mut self, node: Node) -> u64 {
        let epoch = self.epochs.entry(node).or_default();
        *epoch += 1;
        *epoch
    }

    /// Returns the links between two robots with their epochs, if there is a way.
    fn path(&self, from: usize, to: usize) -> Option<Path> {
        let link = |a: usize, b: usize| match (a.min(b), a.max(b)) {
            (0, 1) => 0,
            (1, 2) => 1,
            _ => 2,
        };
        if from == to {
            return Some(Vec::new());
        }
        let is_up = |a: usize, b: usize| {
            let link = link(a, b);
            let alive = self.routers[a].is_some() && self.routers[b].is_some();
            (alive && self.links[link].0).then_some((link, self.links[link].1))
        };
        if let Some(direct) = is_up(from, to) {
            return Some(vec![direct]);
        }
        let by = 3 - from - to;
        Some(vec![is_up(from, by)?, is_up(by, to)?])
    }

    fn start_router(&mut self, robot: usize) {
        let run = self.below(u64::from(u32::MAX)) as u32;
        let disk = Disk::Saved(self.disks[robot].clone());
        let clock = Arc::clone(&self.clocks[robot]);
        let time_of_day = Box::new(move || clock.load(Ordering::Relaxed));
        let (place, is_served) = (self.place(robot), Box::new(|_: &Topic| false));
        let keeper = StateKeeper::new(place, run, disk, is_served, time_of_day, self.now);
        self.routers[robot] = Some(Router {
            keeper,
            run,
            declared: BTreeMap::new(),
            seen: BTreeMap::new(),
            queries: HashMap::new(),
        });
        let epoch = self.restart(Node::Router(robot));
        self.after(
            ms(0),
            Happening::Poll(Node::Router(robot), epoch),
            Vec::new(),
        );
        self.tokens_after(100..300);
        for program in 0..self.programs_each {
            if self.programs.contains_key(&(robot, program)) {
                let epoch = self.epoch(Node::Program(robot, program));
                let connect = Happening::Connect(robot, program, epoch);
                self.within(100..3000, connect);
            }
        }
    }

    fn start_program(&mut self, robot: usize, program: usize) {
        let run = self.below(u64::from(u32::MAX)) as u32;
        let place = self.place(robot);
        let mut state = ProgramState::new(place.clone(), run, self.now);
        let (subscription, inbound) = subscribe(&mut state, place, program, self.now);
        let started = Program {
            run,
            state,
            subscription: Some(subscription),
            inbound,
            retain: None,
            is_registered: false,
            got: BTreeMap::new(),
            all: BTreeSet::new(),
        };
        self.programs.insert((robot, program), started);
        let node = Node::Program(robot, program);
        let epoch = self.restart(node);
        self.after(ms(0), Happening::Poll(node, epoch), Vec::new());
        self.after(ms(1), Happening::Connect(robot, program, epoch), Vec::new());
    }

    fn token(robot: &Name, run: u32) -> String {
        let token = Token {
            robot: robot.clone(),
            program: None,
            instance: Instance(run),
            revision: 0,
        };
        token.key(&name("rect"))
    }

    /// Reports the tokens to the routers that they see now, and those that they do not see any more.
    fn on_tokens(&mut self) {
        if !std::mem::take(&mut self.has_new_tokens) {
            return;
        }
        let tokens: Vec<_> = (0..ROBOTS).map(|robot| self.tokens_of(robot)).collect();
        for robot in 0..ROBOTS {
            let reachable = (0..ROBOTS).filter(|other| self.path(robot, *other).is_some());
            let visible: Vec<_> = reachable.flat_map(|other| &tokens[other]).collect();
            let mut events = Vec::new();
            if let Some(router) = &mut self.routers[robot] {
                for (&id, declaration) in &router.declared {
                    let Declaration::LivelinessSubscriber { key } = declaration else {
                        continue;
                    };
                    let of = keyexpr::new(key).expect("valid");
                    let seen = visible.iter().filter(|key| of.intersects(key));
                    let now: BTreeSet<_> = seen.map(ToString::to_string).collect();
                    let before = router.seen.entry(id).or_default();
                    let gone = before.difference(&now).map(|key| (key.clone(), true));
                    let new = now.difference(before).map(|key| (key.clone(), false));
                    events.extend(gone.chain(new).map(|(key, is_deleted)| Event::Sample {
                        id,
                        sample: Sample {
                            key,
                            payload: Payload::new("", Encoding::BYTES),
                            attachment: None,
                            is_deleted,
                            priority: Sample::PRIORITY,
                        },
                    }));
                    *before = now;
                }
            }
            for event in events {
                self.on_event(Node::Router(robot), event);
            }
        }
    }

    /// Returns the tokens of the router and the programs of a robot.
    fn tokens_of(&self, robot: usize) -> Vec<OwnedKeyExpr> {
        let Some(router) = &self.routers[robot] else {
            return Vec::new();
        };
        let name = &self.names[robot];
        let presence = format!("rect/{name}/@rect/alive/{:08x}", router.run);
        let declared = router.declared.values();
        let of_router = declared.filter_map(|declaration| match declaration {
            Declaration::LivelinessToken { key } => Some(key.clone()),
            _ => None,
        });
        let programs = self.programs.iter();
        let registered = programs.filter(|((of, _), one)| *of == robot && one.is_registered);
        let of_programs = registered.map(|(_, program)| Self::token(name, program.run));
        let tokens = [presence].into_iter().chain(of_router).chain(of_programs);
        (tokens.map(|key| OwnedKeyExpr::autocanonize(key).expect("valid"))).collect()
    }

    fn on_event(&mut self, node: Node, event: Event) {
        let now = self.now;
        match node {
            Node::Router(robot) => {
                if let Some(router) = &mut self.routers[robot] {
                    let _ = router.keeper.on_event(now, event);
                }
            }
            Node::Program(robot, program) => {
                if let Some(program) = self.programs.get_mut(&(robot, program)) {
                    let _ = program.state.on_event(now, event);
                }
            }
        }
        self.poll(node);
    }

    fn poll(&mut self, node: Node) {
        let epoch = self.epoch(node);
        loop {
            let now = self.now;
            match node {
                Node::Router(robot) => {
                    let Some(router) = &mut self.routers[robot] else {
                        return;
                    };
                    match router.keeper.poll(now) {
                        Step::Act(action) => self.act_router(robot, action),
                        Step::Deliver(Item::Save(saved)) => self.disks[robot] = Some(saved),
                        Step::Deliver(Item::Warning(text)) => panic!("{text}"),
                        Step::Wait(at) => {
                            if let Some(at) = at {
                                self.poll_at(node, epoch, at);
                            }
                            return;
                        }
                        Step::Finished(()) => return,
                    }
                }
                Node::Program(robot, number) => {
                    let Some(program) = self.programs.get_mut(&(robot, number)) else {
                        return;
                    };
                    match program.state.poll(now) {
                        Step::Act(Action::Get { id, get }) => {
                            let payload = get.payload.expect("a payload");
                            self.ask(node, epoch, id, robot, get.selector, payload);
                        }
                        Step::Act(_) => {}
                        Step::Deliver(arrival) => self.on_arrival(robot, number, &arrival),
                        Step::Wait(at) => {
                            if let Some(at) = at {
                                self.poll_at(node, epoch, at);
                            }
                            return;
                        }
                        Step::Finished(()) => return,
                    }
                }
            }
        }
    }

    fn on_arrival(&mut self, robot: usize, number: usize, arrival: &Arrival) {
        let program = self.programs.get_mut(&(robot, number)).expect("it runs");
        let origin = match arrival {
            Arrival::Value { value, .. } => value.origin,
            Arrival::Complete { .. } => Origin(0, 0),
        };
        for message in program.inbound.on_retained(arrival) {
            self.on_message(robot, number, message, origin);
        }
    }

    fn on_live(&mut self, robot: usize, number: usize, sample: &Sample) {
        let program = self.programs.get_mut(&(robot, number)).expect("it runs");
        let delivery = Delivery {
            key: &sample.key,
            payload: sample.payload.clone(),
            attachment: sample.attachment.as_deref(),
            priority: 5,
            is_deleted: sample.is_deleted,
            subscription: 0,
        };
        let live = Live::decode(sample.attachment.as_deref().expect("retained"));
        let message = program.inbound.on_delivery(delivery, Instant::now);
        if let Ok(message) = message {
            self.on_message(robot, number, message, live.expect("retained").origin);
        }
    }

    fn on_message(&mut self, robot: usize, number: usize, message: Message, origin: Origin) {
        let program = self.programs.get_mut(&(robot, number)).expect("it runs");
        if program.subscription.is_none() {
            return;
        }
        let retained = message.retained.expect("it is retained");
        let key = (message.sender, message.topic);
        if retained.is_forgotten {
            let had = program.got.remove(&key);
            assert!(had.is_some(), "{key:?} is forgotten twice");
            return;
        }
        let order = &self.history[&key];
        let place = |origin| order.iter().position(|one| *one == origin);
        let is_first = program.all.insert((key.clone(), origin));
        assert!(
            is_first,
            "{robot} {number}: {key:?} {:?} is repeated",
            origin
        );
        if let Some(before) = program.got.insert(key.clone(), origin) {
            assert!(
                place(origin) > place(before),
                "{robot} {number}: {key:?}: {:?} after {before:?} of {order:?}",
                origin
            );
        }
    }

    fn act_router(&mut self, robot: usize, action: Action) {
        let node = Node::Router(robot);
        let epoch = self.epoch(node);
        let place = self.place(robot);
        let router = self.routers[robot].as_mut().expect("it runs");
        match action {
            Action::Declare { id, declaration } => {
                router.declared.insert(id, declaration);
                self.tokens_after(100..300);
            }
            Action::Undeclare { id } => {
                router.declared.remove(&id);
                router.seen.remove(&id);
            }
            Action::PutRetained {
                key,
                payload,
                attachment,
                ..
            } => {
                let live = Live::decode(&attachment).expect("an attachment");
                let address = place.parse(&key).expect("an address");
                let key_of = (address.sender, address.topic);
                self.history.entry(key_of).or_default().push(live.origin);
                let is_deleted = payload.is_none();
                let sample = Sample {
                    key,
                    payload: payload.unwrap_or_else(|| Payload::new("", Encoding::BYTES)),
                    attachment: Some(attachment.into()),
                    is_deleted,
                    priority: Sample::PRIORITY,
                };
                for other in 0..ROBOTS {
                    let run = self.routers[other].as_ref().map(|router| router.run);
                    if let (Some(path), Some(run)) = (self.path(robot, other), run) {
                        if other != robot {
                            self.bytes += 60 + sample.payload.bytes.len();
                        }
                        let wait = self.hop(&path);
                        let published =
                            Happening::Published(other, run, sample.clone(), path.clone());
                        self.after(wait, published, path);
                    }
                }
            }
            Action::PutOnce { .. } => panic!("a value is not kept"),
            Action::Get { id, get } => {
                let mut robots = self.names.iter();
                let robot = place.robot_of(&get.selector);
                let to = robots.position(|name| Some(name) == robot.as_ref());
                let payload = get.payload.expect("a payload");
                match to {
                    Some(to) => self.ask(node, epoch, id, to, get.selector, payload),
                    None => self.send_event(node, epoch, Event::Ended { id }, ms(1), Vec::new()),
                }
            }
            Action::Answer { query, answer } => {
                let Some((from, epoch, id)) = router.queries.remove(&query) else {
                    return;
                };
                let to = match from {
                    Node::Router(to) | Node::Program(to, _) => to,
                };
                let Some(path) = self.path(robot, to) else {
                    self.send_event(from, epoch, Event::Ended { id }, ms(10_000), Vec::new());
                    return;
                };
                let wait = self.hop(&path);
                let reply = match answer {
                    Answer::Reply { key, payload } => {
                        if robot != to {
                            self.bytes += 40 + payload.bytes.len();
                        }
                        Some(Ok(Sample {
                            key,
                            payload,
                            attachment: None,
                            is_deleted: false,
                            priority: Sample::PRIORITY,
                        }))
                    }
                    Answer::Error(payload) => Some(Err(payload)),
                    Answer::None => None,
                };
                if let Some(reply) = reply {
                    let reply = Event::Reply { id, reply };
                    self.send_event(from, epoch, reply, wait, path);
                }
                // The end of a query arrives in any case.
                let ended = Event::Ended { id };
                self.send_event(from, epoch, ended, wait + ms(1), Vec::new());
            }
            _ => {}
        }
    }

    fn send_event(&mut self, to: Node, epoch: u64, event: Event, wait: Duration, path: Path) {
        // The ids of publications are those of another driver, which is not in step with the first one.
        let happening = match to {
            Node::Program(robot, program) if epoch >= RETAIN => {
                let wait = wait + ms(self.below(4));
                let event = Happening::RetainEvent(robot, program, epoch - RETAIN, event);
                return self.after(wait, event, path);
            }
            _ => Happening::Event(to, epoch, event),
        };
        self.after(wait, happening, path);
    }

    fn hop(&mut self, path: &[(usize, u64)]) -> Duration {
        match path.is_empty() {
            true => ms(1),
            // In order, as on a link without loss.
            false => ms(30 * path.len() as u64),
        }
    }

    fn ask(&mut self, from: Node, epoch: u64, id: Id, to: usize, key: String, payload: Payload) {
        let own = match from {
            Node::Router(own) | Node::Program(own, _) => own,
        };
        let connected = match from {
            Node::Program(robot, program) => self
                .programs
                .get(&(robot, program))
                .is_some_and(|program| program.is_registered),
            Node::Router(_) => true,
        };
        let path = self.path(own, to).filter(|_| connected);
        let run = self.routers[to].as_ref().map(|router| router.run);
        let (Some(path), Some(run)) = (path, run) else {
            return self.send_event(from, epoch, Event::Ended { id }, ms(1), Vec::new());
        };
        if own != to {
            self.bytes += 60 + payload.bytes.len();
        }
        let wait = self.hop(&path);
        let query = Happening::Query {
            to,
            run,
            from: (from, epoch, id),
            key,
            payload,
        };
        self.after(wait, query, path);
    }

    fn happen(&mut self, happening: Happening, path: &[(usize, u64)]) {
        let is_lost = path
            .iter()
            .any(|&(link, epoch)| self.links[link].1 != epoch);
        match happening {
            Happening::Poll(node, epoch) => {
                if self.epoch(node) == epoch {
                    self.poll(node);
                }
            }
            Happening::PollRetain(robot, program, epoch) => {
                if self.epoch(Node::Program(robot, program)) == epoch {
                    self.poll_retain(robot, program);
                }
            }
            Happening::Query {
                to,
                run,
                from,
                key,
                payload,
            } => {
                let (node, epoch, id) = from;
                let router = self.routers[to].as_mut().filter(|router| router.run == run);
                let queryable = router.as_ref().and_then(|router| {
                    router
                        .declared
                        .iter()
                        .find_map(|(id, declaration)| match declaration {
                            Declaration::Queryable { key: of, .. } if *of == key => Some(*id),
                            _ => None,
                        })
                });
                let (Some(router), Some(queryable), false) = (router, queryable, is_lost) else {
                    let ended = Event::Ended { id };
                    return self.send_event(node, epoch, ended, ms(100), Vec::new());
                };
                self.next += 1;
                let query = QueryId(self.next);
                router.queries.insert(query, from);
                let event = Event::Query {
                    id: queryable,
                    query,
                    key,
                    payload,
                    attachment: None,
                };
                self.on_event(Node::Router(to), event);
            }
            Happening::Event(node, epoch, event) => {
                if self.epoch(node) == epoch && !is_lost {
                    self.on_event(node, event);
                }
            }
            Happening::RetainEvent(robot, program, epoch, event) => {
                if self.epoch(Node::Program(robot, program)) == epoch {
                    let now = self.now;
                    let program_of = self.programs.get_mut(&(robot, program));
                    if let Some((retain, ..)) = program_of.and_then(|one| one.retain.as_mut()) {
                        let _ = retain.on_event(now, event);
                    }
                    self.poll_retain(robot, program);
                }
            }
            Happening::Published(to, run, sample, path) => {
                let is_lost = path
                    .iter()
                    .any(|&(link, epoch)| self.links[link].1 != epoch);
                let router = self.routers[to].as_ref().filter(|router| router.run == run);
                let (Some(router), false) = (router, is_lost) else {
                    return;
                };
                let key = keyexpr::new(sample.key.as_str()).expect("valid");
                let matches = router.declared.iter().filter_map(|(id, declaration)| {
                    let Declaration::Subscriber { key: of } = declaration else {
                        return None;
                    };
                    keyexpr::new(of)
                        .expect("valid")
                        .intersects(key)
                        .then_some(*id)
                });
                let matches: Vec<_> = matches.collect();
                let program_is_first = self.below(2) == 0;
                for is_program in [program_is_first, !program_is_first] {
                    if is_program {
                        let topic = sample.key.rsplit('/').next().expect("a topic");
                        for number in 0..self.programs_each {
                            let program = self.programs.get(&(to, number));
                            if selects(number, topic)
                                && program.is_some_and(|program| program.is_registered)
                            {
                                self.on_live(to, number, &sample);
                            }
                        }
                        continue;
                    }
                    for &id in &matches {
                        let sample = sample.clone();
                        self.on_event(Node::Router(to), Event::Sample { id, sample });
                    }
                }
            }
            Happening::Tokens => self.on_tokens(),
            Happening::Set => self.set(),
            Happening::Cut => {
                let link = self.below(if self.has_mesh { 3 } else { 2 }) as usize;
                if self.faults {
                    self.links[link] = (false, self.links[link].1 + 1);
                    self.tokens_after(100..300);
                    self.within(50..8000, Happening::Mend);
                }
            }
            Happening::Mend => {
                for link in 0..2 + usize::from(self.has_mesh) {
                    self.links[link].0 = true;
                }
                self.tokens_after(100..300);
            }
            Happening::CrashRouter => {
                let robot = self.below(ROBOTS as u64) as usize;
                if self.faults {
                    self.crash_router(robot);
                    self.within(500..4000, Happening::StartRouter(robot));
                }
            }
            Happening::StartRouter(robot) => {
                if self.routers[robot].is_none() {
                    self.start_router(robot);
                }
            }
            Happening::Connect(robot, program, epoch) => {
                let node = Node::Program(robot, program);
                if self.epoch(node) != epoch || self.routers[robot].is_none() {
                    return;
                }
                let one = self.programs.get_mut(&(robot, program)).expect("it runs");
                one.is_registered = true;
                self.tokens_after(1..50);
                let (method, address) = ("tcp".to_owned(), String::new());
                let up = true;
                self.on_event(
                    node,
                    Event::Link {
                        up,
                        method,
                        address,
                    },
                );
            }
            Happening::CrashProgram => {
                let robot = self.below(ROBOTS as u64) as usize;
                let program = self.below(self.programs_each as u64) as usize;
                if self.faults && self.programs.remove(&(robot, program)).is_some() {
                    self.restart(Node::Program(robot, program));
                    self.tokens_after(100..200);
                    self.within(500..4000, Happening::StartProgram(robot, program));
                }
            }
            Happening::StartProgram(robot, program) => {
                if !self.programs.contains_key(&(robot, program)) {
                    self.start_program(robot, program);
                }
            }
            Happening::Resubscribe(robot, program) => self.resubscribe(robot, program),
            Happening::Unsubscribe(robot, program, epoch, subscription) => {
                let node = Node::Program(robot, program);
                if self.epoch(node) == epoch {
                    self.unsubscribe(robot, program, subscription);
                }
            }
            Happening::Subscribe(robot, program, epoch) => {
                let node = Node::Program(robot, program);
                if self.epoch(node) == epoch {
                    self.subscribe(robot, program);
                }
            }
            Happening::SetClock => {
                let robot = self.below(ROBOTS as u64) as usize;
                let time = match self.below(3) {
                    0 => self.below(86_400_000),
                    _ => YEAR_2026_MS - 86_400_000 + self.below(2 * 86_400_000),
                };
                self.clocks[robot].store(time, Ordering::Relaxed);
            }
            Happening::Rename => {
                let robot = self.below(ROBOTS as u64) as usize;
                if self.faults {
                    self.rename(robot);
                }
            }
        }
    }

    fn crash_router(&mut self, robot: usize) {
        let Some(router) = self.routers[robot].take() else {
            return;
        };
        self.restart(Node::Router(robot));
        for (from, epoch, id) in router.queries.into_values() {
            self.send_event(from, epoch, Event::Ended { id }, ms(20), Vec::new());
        }
        for link in 0..3 {
            self.links[link].1 += 1;
        }
        for program in 0..self.programs_each {
            if let Some(program) = self.programs.get_mut(&(robot, program)) {
                program.is_registered = false;
            }
        }
        self.tokens_after(100..300);
    }

    /// Ends the router and the programs of a robot, and starts them under another name, or under the first one again.
    fn rename(&mut self, robot: usize) {
        self.crash_router(robot);
        for program in 0..self.programs_each {
            self.programs.remove(&(robot, program));
            self.restart(Node::Program(robot, program));
            self.within(500..4000, Happening::StartProgram(robot, program));
        }
        let first = ["a", "b", "c"][robot];
        let renamed = match self.names[robot].as_str() == first {
            true => name(&format!("{first}2")),
            false => name(first),
        };
        let before = std::mem::replace(&mut self.names[robot], renamed.clone());
        // The values on disk appear under the new name.
        for topic in (0..TOPICS).map(topic) {
            let order = self.history.get(&(before.clone(), topic.clone()));
            if let Some(order) = order.cloned() {
                self.history.insert((renamed.clone(), topic), order);
            }
        }
        for program in self.programs.values_mut() {
            program.all.retain(|((robot, _), _)| *robot != renamed);
        }
        self.within(500..4000, Happening::StartRouter(robot));
    }

    /// Ends the subscription of a program and begins a new one: shortly before, at the same time, or later.
    fn resubscribe(&mut self, robot: usize, number: usize) {
        let node = Node::Program(robot, number);
        let epoch = self.epoch(node);
        let program = self.programs.get(&(robot, number));
        let Some(before) = program.and_then(|program| program.subscription) else {
            return;
        };
        let longest = if self.below(2) == 0 { 6 } else { 200 };
        let gap = self.below(longest);
        let begin = Happening::Subscribe(robot, number, epoch);
        match self.below(2) {
            0 => {
                self.unsubscribe(robot, number, before);
                self.after(ms(gap), begin, Vec::new());
            }
            _ => {
                self.subscribe(robot, number);
                let end = Happening::Unsubscribe(robot, number, epoch, before);
                self.after(ms(gap), end, Vec::new());
            }
        }
        // Again, while questions about the first one are in flight.
        if self.below(3) > 0 {
            self.within(0..300, Happening::Resubscribe(robot, number));
        }
    }

    fn unsubscribe(&mut self, robot: usize, number: usize, subscription: u64) {
        if let Some(program) = self.programs.get_mut(&(robot, number)) {
            program.state.unsubscribe(subscription, self.now);
            program
                .subscription
                .take_if(|current| *current == subscription);
            self.poll(Node::Program(robot, number));
        }
    }

    fn subscribe(&mut self, robot: usize, number: usize) {
        let place = self.place(robot);
        if let Some(program) = self.programs.get_mut(&(robot, number)) {
            let (subscription, inbound) = subscribe(&mut program.state, place, number, self.now);
            (program.subscription, program.inbound) = (Some(subscription), inbound);
            program.got.clear();
            program.all.clear();
            self.poll(Node::Program(robot, number));
        }
    }

    /// Makes a program publish one of its topics, or forget it.
    fn set(&mut self) {
        let robot = self.below(ROBOTS as u64) as usize;
        let topic_number = self.below(TOPICS);
        let programs = self.programs_each as u64;
        let number = match self.is_shared {
            true => self.below(programs),
            false => topic_number % programs,
        };
        let (number, topic) = (number as usize, topic(topic_number));
        let forget = self.below(8) == 0;
        let disk = topic_number % 3 == 0;
        let (now, place) = (self.now, self.place(robot));
        let Some(program) = self.programs.get_mut(&(robot, number)) else {
            return;
        };
        if program.retain.is_some() {
            return;
        }
        let order = match forget {
            true => program.state.forget(&topic, Sent::At(0)),
            false => {
                let payload = Payload::new(vec![b'x'; 40], Encoding::TEXT);
                (program.state).set(&topic, payload, Urgency::Normal, disk, Sent::At(0))
            }
        };
        let retain = Retain::new(&place, &order, now);
        program.retain = Some((retain, topic, order));
        self.poll_retain(robot, number);
    }

    fn poll_retain(&mut self, robot: usize, number: usize) {
        let now = self.now;
        let node = Node::Program(robot, number);
        let epoch = self.epoch(node);
        loop {
            let Some(program) = self.programs.get_mut(&(robot, number)) else {
                return;
            };
            let Some((retain, ..)) = &mut program.retain else {
                return;
            };
            match retain.poll(now) {
                Step::Act(Action::Get { id, get }) => {
                    let payload = get.payload.expect("a payload");
                    self.ask(node, epoch + RETAIN, id, robot, get.selector, payload);
                }
                Step::Wait(Some(at)) => {
                    let wait = at.saturating_duration_since(now);
                    self.after(
                        wait,
                        Happening::PollRetain(robot, number, epoch),
                        Vec::new(),
                    );
                    return;
                }
                Step::Finished(outcome) => {
                    let (_, topic, order) = program.retain.take().expect("it publishes");
                    match outcome {
                        Outcome::Kept(kept) => program.state.on_kept(topic, &order, kept, now),
                        Outcome::NoKeeper => {}
                        outcome => panic!("{outcome:?}"),
                    }
                    self.poll(node);
                    return;
                }
                _ => return,
            }
        }
    }

    fn run_for(&mut self, time: Duration) {
        let end = self.now + time;
        let mut happened = 0;
        while let Some(entry) = self.happenings.first_entry() {
            let at = entry.key().0;
            if at > end {
                break;
            }
            let (happening, path) = *entry.remove();
            self.now = self.now.max(at);
            self.happen(happening, &path);
            happened += 1;
            assert!(happened < 1_000_000, "an endless loop");
        }
        self.now = end;
    }

    /// Compares what each program has with what each keeper has. Programs also have values of robots that have another name now.
    fn check(&self) {
        let mut kept = BTreeMap::new();
        for other in 0..ROBOTS {
            let router = self.routers[other].as_ref().expect("all run");
            let robot = &self.names[other];
            for value in (router.keeper.page(None, &[keys(robot)], self.now, true)).records {
                kept.insert((robot.clone(), value.topic), value.origin);
            }
        }
        for ((robot, number), program) in &self.programs {
            let is_subscribed = |key: &Key| selects(*number, key.1.as_str());
            let expected = kept.iter().filter(|(key, _)| is_subscribed(key));
            let got = program.got.iter();
            let got = got.filter(|((robot, _), _)| self.names.contains(robot));
            assert!(
                got.eq(expected),
                "robot {robot}, program {number}: {:?}, and not {kept:?}",
                program.got
            );
            // Otherwise it would give an old value to a router that is restarted.
            for (topic, origin) in program.state.own() {
                let key = (self.names[*robot].clone(), topic.clone());
                assert_eq!(
                    kept.get(&key),
                    Some(&origin),
                    "robot {robot}, program {number}: {key:?}"
                );
            }
        }
    }
}

/// Begins the subscription of a program.
fn subscribe(
    state: &mut ProgramState,
    place: KeySpace,
    program: usize,
    now: Instant,
) -> (u64, Inbound) {
    let pattern = Pattern::new(PATTERNS[program]).expect("valid pattern");
    let selected = place.subscriptions(&pattern);
    let number = state.subscribe(&[selected[0].key.clone()], now);
    (number, Inbound::new(place, selected, now))
}

/// Added to the epoch of a program for the queries of its publications.
const RETAIN: u64 = 1 << 32;

fn keys(robot: &Name) -> OwnedKeyExpr {
    OwnedKeyExpr::autocanonize(format!("rect/{robot}/**")).expect("valid")
}

#[test]
fn all_programs_have_the_last_values_after_cuts_and_crashes() {
    let first: u64 = std::env::var("RECT_SEED")
        .ok()
        .and_then(|seed| seed.parse().ok())
        .unwrap_or(0);
    let mut failed = Vec::new();
    let count = std::env::var("RECT_SEEDS")
        .ok()
        .and_then(|seeds| seeds.parse().ok());
    for seed in first..first + count.unwrap_or(1000) {
        let mut world = World::with_faults(seed);
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            world.run_for(Duration::from_secs(60));
            world.faults = false;
            world.within(0..1, Happening::Mend);
            world.run_for(Duration::from_secs(60));
            world.check();
        }));
        if caught.is_err() {
            failed.push(seed);
        }
    }
    assert!(failed.is_empty(), "RECT_SEED={failed:?}");
}

#[test]
fn nothing_is_sent_while_nothing_changes() {
    let mut world = World::new(0);
    for _ in 0..20 {
        world.within(0..1000, Happening::Set);
    }
    world.run_for(Duration::from_secs(60));
    world.check();
    let bytes = std::mem::take(&mut world.bytes);
    assert!(bytes > 0);
    world.run_for(Duration::from_secs(600));
    assert_eq!(world.bytes, 0);
}

/// The keeper of `b`, whose only program subscribes to everything, and knows that `a` keeps values. Returns it with the id of its question.
fn copying() -> (StateKeeper, Id, Instant) {
    let now = Instant::now();
    let disk = Disk::Saved(None);
    let mut keeper = keeper("b", 1, disk, now);
    let poll = Order::Poll {
        program: 2,
        since: None,
        keys: vec!["rect/*/**".to_owned()],
    };
    let _ = keeper.on_event(
        now,
        Event::Query {
            id: Id(0),
            query: QueryId(1),
            key: String::new(),
            payload: super::page::write(&poll),
            attachment: None,
        },
    );
    let actions = actions(&mut keeper, now);
    let tokens = actions.iter().find_map(|action| match action {
        Action::Declare {
            id,
            declaration: Declaration::LivelinessSubscriber { key },
        } if key == "rect/*/@rect/s/*" => Some(*id),
        _ => None,
    });
    let sample = Sample {
        key: "rect/a/@rect/s/0000002a".to_owned(),
        payload: Payload::new("", Encoding::BYTES),
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    };
    let id = tokens.expect("it observes others");
    let _ = keeper.on_event(now, Event::Sample { id, sample });
    let (asked, to) = questions(&mut keeper, now).remove(0);
    assert_eq!(to, "rect/a/@rect/state");
    (keeper, asked, now)
}

fn keeper(robot: &str, run: u32, disk: Disk, now: Instant) -> StateKeeper {
    let (is_served, time_of_day) = (Box::new(|_: &Topic| false), Box::new(|| YEAR_2026_MS));
    StateKeeper::new(place(robot), run, disk, is_served, time_of_day, now)
}

fn actions(keeper: &mut StateKeeper, now: Instant) -> Vec<Action> {
    let mut actions = Vec::new();
    loop {
        match keeper.poll(now) {
            Step::Act(action) => actions.push(action),
            Step::Deliver(_) => {}
            _ => return actions,
        }
    }
}

/// Gives the keeper of `a` an order, and returns its reply.
fn order<T: serde::de::DeserializeOwned>(
    keeper: &mut StateKeeper,
    order: &Order,
    now: Instant,
) -> T {
    let _ = keeper.on_event(
        now,
        Event::Query {
            id: Id(0),
            query: QueryId(1),
            key: String::new(),
            payload: super::page::write(order),
            attachment: None,
        },
    );
    let mut actions = actions(keeper, now).into_iter();
    let reply = actions.find_map(|action| match action {
        Action::Answer {
            answer: Answer::Reply { payload, .. },
            ..
        } => Some(payload),
        _ => None,
    });
    super::page::read(&reply.expect("a reply").bytes).expect("a valid reply")
}

/// Returns the bytes that a keeper of `a` saves when a program publishes `t1`.
fn saved(program: &mut ProgramState, now: Instant) -> Option<Vec<u8>> {
    let disk = Disk::Saved(None);
    let mut keeper = keeper("a", 1, disk, now);
    let payload = Payload::new("old", Encoding::TEXT);
    let set = program.set(&topic(1), payload, Urgency::Normal, true, Sent::At(0));
    let payload = super::page::write(&set);
    let (id, query, key, attachment) = (Id(0), QueryId(1), String::new(), None);
    let _ = keeper.on_event(
        now,
        Event::Query {
            id,
            query,
            key,
            payload,
            attachment,
        },
    );
    loop {
        match keeper.poll(now) {
            Step::Deliver(Item::Save(saved)) => return Some(saved),
            Step::Wait(_) => return None,
            _ => {}
        }
    }
}

#[test]
fn value_that_waited_for_the_router_replaces_the_one_on_disk() {
    let now = Instant::now();
    let mut program = ProgramState::new(place("a"), 7, now);
    let disk = Disk::Saved(saved(&mut program, now));
    let mut keeper = keeper("a", 2, disk, now);
    let payload = Payload::new("new", Encoding::TEXT);
    let new = program.set(&topic(1), payload, Urgency::Normal, true, Sent::At(0));
    let kept: Kept = order(&mut keeper, &new.after(Duration::from_secs(3)), now);
    assert!(!kept.is_replaced);
    // A call that began before that one is too late.
    let mut other = ProgramState::new(place("a"), 8, now);
    let payload = Payload::new("late", Encoding::TEXT);
    let late = other.set(&topic(1), payload, Urgency::Normal, false, Sent::At(0));
    let kept: Kept = order(&mut keeper, &late.after(Duration::from_secs(4)), now);
    assert!(kept.is_replaced);
    let values = keeper.page(None, &[keys(&name("a"))], now, true).records;
    assert_eq!(values[0].payload, Payload::new("new", Encoding::TEXT));
}

/// The answer to the question of a subscription that has just begun does not contain topics that are forgotten.
#[test]
fn program_with_a_new_subscription_does_not_give_a_forgotten_value_to_a_restarted_router() {
    let now = Instant::now();
    let mut keeper = keeper("a", 1, Disk::Saved(None), now);
    let mut program = ProgramState::new(place("a"), 7, now);
    for number in [1, 2] {
        let payload = Payload::new("value", Encoding::TEXT);
        let set = program.set(&topic(number), payload, Urgency::Normal, false, Sent::At(0));
        let kept = order(&mut keeper, &set, now);
        program.on_kept(topic(number), &set, kept, now);
    }
    let mut other = ProgramState::new(place("a"), 8, now);
    let _: Kept = order(&mut keeper, &other.forget(&topic(1), Sent::At(0)), now);
    program.subscribe(&["rect/*/**".to_owned()], now);
    let later = now + ms(2);
    let (id, question) = loop {
        match program.poll(later) {
            Step::Act(Action::Get { id, get }) => break (id, get.payload.expect("a payload")),
            Step::Act(_) => {}
            _ => panic!("the program asks nothing"),
        }
    };
    let question = super::page::read(&question.bytes).expect("an order");
    let answer: Page = order(&mut keeper, &question, later);
    let sample = Sample {
        key: String::new(),
        payload: super::page::write(&answer),
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    };
    let reply = Ok(sample);
    let _ = program.on_event(later, Event::Reply { id, reply });
    let own: Vec<_> = program.own().map(|(topic, _)| topic.clone()).collect();
    assert_eq!(own, [topic(2)]);
}

fn questions(keeper: &mut StateKeeper, now: Instant) -> Vec<(Id, String)> {
    let actions = actions(keeper, now).into_iter();
    let questions = actions.filter_map(|action| match action {
        Action::Get { id, get } => Some((id, get.selector)),
        _ => None,
    });
    questions.collect()
}

fn answer(keeper: &mut StateKeeper, id: Id, now: Instant, payload: Payload) {
    let sample = Sample {
        key: "rect/a/@rect/state".to_owned(),
        payload,
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    };
    let reply = Ok(sample);
    let _ = keeper.on_event(now, Event::Reply { id, reply });
    let _ = keeper.on_event(now, Event::Ended { id });
}

fn value(number: u64, bytes: usize) -> Value {
    Value {
        robot: None,
        topic: topic(number),
        number,
        origin: Origin(7, number),
        payload: Payload::new(vec![1; bytes], Encoding::BYTES),
        urgency: Urgency::Normal,
        sent: Sent::At(0),
        age: Duration::ZERO,
        has_ended: false,
        is_forgotten: false,
        kept: None,
    }
}

fn page(at: u64, more: bool, records: Vec<Value>) -> Page {
    Page {
        run: 42,
        at,
        more,
        complete: vec![(String::new(), Position(42, at))],
        records,
    }
}

/// Returns the topics of `a` of which the keeper has copies.
fn copies(keeper: &StateKeeper, now: Instant) -> Vec<String> {
    let page = keeper.page(None, &[keys(&name("a"))], now, false);
    page.records
        .iter()
        .map(|value| value.topic.to_string())
        .collect()
}

#[test]
fn router_that_answers_with_values_of_others_is_not_believed() {
    let (mut keeper, id, now) = copying();
    let foreign = Value {
        robot: Some(name("c")),
        ..value(1, 4)
    };
    answer(
        &mut keeper,
        id,
        now,
        super::page::write(&page(2, false, vec![foreign, value(2, 4)])),
    );
    assert_eq!(copies(&keeper, now), [] as [&str; 0]);
    // It is asked again after a pause.
    assert!(questions(&mut keeper, now).is_empty());
    assert_eq!(
        questions(&mut keeper, now + Duration::from_secs(1)).len(),
        1
    );
}

#[test]
fn answers_that_are_no_pages_are_asked_for_again_less_and_less() {
    let (mut keeper, mut id, mut now) = copying();
    let mut pauses = Vec::new();
    for _ in 0..3 {
        answer(
            &mut keeper,
            id,
            now,
            Payload::new("no page", Encoding::TEXT),
        );
        let before = now;
        id = loop {
            now += Duration::from_secs(1);
            if let Some((next, _)) = questions(&mut keeper, now).pop() {
                break next;
            }
        };
        pauses.push(now.duration_since(before).as_secs());
    }
    assert_eq!(pauses, [1, 2, 4]);
}

#[test]
fn endless_answer_ends_and_its_values_are_bounded() {
    let (mut keeper, mut id, now) = copying();
    let mut asked = 0;
    for at in 1..5000 {
        answer(
            &mut keeper,
            id,
            now,
            super::page::write(&page(at, true, vec![value(at, 8000)])),
        );
        match questions(&mut keeper, now).pop() {
            Some((next, _)) => (id, asked) = (next, asked + 1),
            None => break,
        }
    }
    assert!(asked < 200, "{asked}");
    let copied = copies(&keeper, now).len();
    assert!(copied * 8000 <= super::MAX_ROBOT, "{copied}");
    // A page that does not go on is the last one.
    let (mut keeper, mut id, now) = copying();
    let mut asked = 0;
    loop {
        let stuck = page(5, true, vec![value(5, 8)]);
        answer(&mut keeper, id, now, super::page::write(&stuck));
        match questions(&mut keeper, now).pop() {
            Some((next, _)) => (id, asked) = (next, asked + 1),
            None => break,
        }
    }
    assert!(asked < 5, "{asked}");
}

#[test]
fn numbers_of_the_future_do_not_hide_later_values() {
    let (mut keeper, id, now) = copying();
    answer(
        &mut keeper,
        id,
        now,
        super::page::write(&page(u64::MAX, false, vec![value(u64::MAX, 4)])),
    );
    assert_eq!(copies(&keeper, now).len(), 1);
    // A check with the true numbers makes it ask, and what another run answers replaces everything.
    let check = Question::Check {
        of: "a".to_owned(),
        at: Position(43, 3),
        digest: 0,
        is_complete: true,
    };
    let _ = keeper.on_event(
        now,
        Event::Query {
            id: Id(1),
            query: QueryId(9),
            key: String::new(),
            payload: super::page::write(&check),
            attachment: None,
        },
    );
    let (id, _) = questions(&mut keeper, now).pop().expect("it asks");
    let other_run = Page {
        run: 43,
        ..page(3, false, vec![value(3, 4)])
    };
    answer(&mut keeper, id, now, super::page::write(&other_run));
    assert_eq!(copies(&keeper, now), [topic(3).to_string()]);
}

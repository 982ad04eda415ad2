//! Tests servers and clients of actions together, in virtual time: the model of a robot with its router, whose programs, links and
//! routers end at random.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use ciborium::Value;

use super::{
    order::{Cancel, Order, Start},
    result::GoalResult,
    run::ActionRun,
    server::{ActionServer, Outcome, Publication, Rules, Work},
    state::{Feedback, GoalState, KnownGoal, Phase},
    *,
};
use crate::{
    message::{retained::Retained, Message},
    name::Name,
    registry::connection::Event,
    state::retain::NO_KEEPER,
    stop::MARKED_WITHIN,
    stream::simulation::Random,
};

const STEP: Duration = Duration::from_millis(100);
/// The time after which a program has given its values to a router that has restarted.
const GIVEN_AGAIN: Duration = Duration::from_millis(500);

fn name(text: &str) -> Name {
    Name::new(text).expect("a name")
}

fn start(id: &str, goal: i64) -> Payload {
    Order::Start(Start {
        id: id.to_owned(),
        goal: Value::from(goal),
        by: "scout".to_owned(),
        feedback_per_s: None,
    })
    .write()
}

fn cancel(id: &str) -> Payload {
    Order::Cancel(Cancel {
        id: id.to_owned(),
        by: String::new(),
    })
    .write()
}

/// A run of the program with the action.
struct Program {
    run: u64,
    server: ActionServer,
    /// The goal whose handler runs, until when it does, whether it was asked to end, and whether it notices that.
    handler: Option<(String, Instant, bool, bool)>,
    /// The states that it has given to the router.
    given: BTreeMap<String, Payload>,
}

/// The history of a goal.
#[derive(Debug, Default)]
struct History {
    began: u32,
    has_returned: bool,
    was_cancelled: bool,
    /// The runs of the program that had it.
    runs: Vec<u64>,
}

/// A robot, and a client of another one.
struct World {
    now: Instant,
    random: Random,
    is_linked: bool,
    rules: Rules,
    program: Option<Program>,
    runs: u64,
    /// The states that the router keeps, with the runs of the programs that have given them.
    kept: BTreeMap<String, (Payload, u64)>,
    /// When a program that runs gives its states to a router that has restarted.
    give_at: Option<Instant>,
    client: Option<Client>,
    ended: Vec<(String, Phase)>,
    history: BTreeMap<String, History>,
    goals: u32,
    orders: u64,
}

/// A client with one goal.
struct Client {
    id: String,
    /// The run of the program that may carry it out.
    run: u64,
    /// The number of the order that waits for a reply, and until when it is repeated.
    order: Option<(u64, Instant)>,
    following: Option<ActionRun>,
    seen: Option<Payload>,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut random = Random(seed);
        let rules = Rules {
            refuses: random.next() % 4 == 0,
            lost_after: (random.next() % 2 == 0).then_some(Duration::from_secs(5)),
        };
        let mut world = Self {
            now: Instant::now(),
            random,
            is_linked: true,
            rules,
            program: None,
            runs: 0,
            kept: BTreeMap::new(),
            give_at: None,
            client: None,
            ended: Vec::new(),
            history: BTreeMap::new(),
            goals: 0,
            orders: 0,
        };
        world.start_program();
        world
    }

    fn chance(&mut self, one_of: u64) -> bool {
        self.random.next() % one_of == 0
    }

    fn start_program(&mut self) {
        self.runs += 1;
        let mut server = ActionServer::new(Some(&name("digger")), self.rules.clone());
        for (id, (payload, _)) in &self.kept {
            server.on_earlier(id, payload, self.now, 0);
        }
        self.program = Some(Program {
            run: self.runs,
            server,
            handler: None,
            given: BTreeMap::new(),
        });
        self.give_at = None;
    }

    fn tell_client(&mut self, event: &Event) {
        let now = self.now;
        let following = self
            .client
            .as_mut()
            .and_then(|client| client.following.as_mut());
        if let Some(run) = following {
            run.on_event(event, now);
        }
    }

    fn tell_server(&mut self, event: &Event) {
        let now = self.now;
        if let Some(program) = &mut self.program {
            program.server.on_event(event, now);
        }
    }

    fn set_linked(&mut self, is_linked: bool) {
        if std::mem::replace(&mut self.is_linked, is_linked) == is_linked {
            return;
        }
        let (robot, laptop) = (name("wombat-2"), name("wombat-1"));
        let scout = name("scout");
        if is_linked {
            self.tell_client(&Event::PeerUp { robot });
            self.tell_server(&Event::PeerUp {
                robot: laptop.clone(),
            });
            self.tell_server(&Event::ProgramUp {
                robot: laptop,
                program: scout,
            });
        } else {
            self.tell_client(&Event::PeerDown { robot });
            self.tell_server(&Event::ProgramDown {
                robot: laptop.clone(),
                program: scout,
            });
            self.tell_server(&Event::PeerDown { robot: laptop });
        }
    }

    fn kill_program(&mut self) {
        if self.program.take().is_some() && self.is_linked {
            let (robot, program) = (name("wombat-2"), name("digger"));
            self.tell_client(&Event::ProgramDown { robot, program });
        }
    }

    fn restart_router(&mut self) {
        self.kept.clear();
        self.give_at = Some(self.now + GIVEN_AGAIN);
        if self.is_linked {
            self.set_linked(false);
            self.set_linked(true);
        }
    }

    fn message(&self, id: &str) -> Option<Message> {
        let (payload, run) = self.kept.get(id)?;
        let topic = topic("dig", id).parse().expect("a topic");
        let has_ended = self
            .program
            .as_ref()
            .is_none_or(|program| program.run != *run);
        Some(Message {
            retained: Some(Retained {
                age: Duration::ZERO,
                has_ended,
                is_forgotten: false,
            }),
            ..Message::new(name("wombat-2"), topic, payload.clone())
        })
    }

    /// Begins a goal, unless the client has one.
    fn start_goal(&mut self) {
        let Some(program) = &self.program else { return };
        self.goals += 1;
        let id = format!("g{}", self.goals);
        self.client = Some(Client {
            id,
            run: program.run,
            order: Some((0, self.now + Duration::from_secs(10))),
            following: None,
            seen: None,
        });
    }

    fn order(&mut self, payload: &Payload) -> u64 {
        self.orders += 1;
        let number = self.orders;
        if let Some(program) = &mut self.program {
            let laptop = name("wombat-1");
            program.server.on_order(number, Some(&laptop), payload, 0);
        }
        number
    }

    /// Repeats the order of the client until it is answered.
    fn repeat_order(&mut self) {
        let Some(client) = &self.client else { return };
        let Some((_, until)) = client.order else {
            return;
        };
        let (id, run) = (client.id.clone(), client.run);
        if self.now > until {
            // The client learns that the goal may have begun, and looks for it no more.
            self.client = None;
            return;
        }
        let is_same = self
            .program
            .as_ref()
            .is_some_and(|program| program.run == run);
        if !self.is_linked || self.orders > 0 && self.random.next() % 5 > 0 {
            return;
        }
        if !is_same {
            // Interrupted: no other run of the program carries it out.
            self.client = None;
            return;
        }
        let history = self.history.entry(id.clone()).or_default();
        if !history.runs.contains(&run) {
            history.runs.push(run);
        }
        let number = self.order(&start(&id, 3));
        if let Some(client) = &mut self.client {
            client.order = Some((number, until));
        }
    }

    fn on_reply(&mut self, number: u64, refused: Option<String>) {
        let now = self.now;
        let Some(client) = &mut self.client else {
            return;
        };
        if client.order.is_none_or(|(order, _)| order != number) || !self.is_linked {
            return;
        }
        client.order = None;
        let robot = name("wombat-2");
        client.following = Some(match refused {
            Some(reason) => ActionRun::refused(robot, &reason, now),
            None => ActionRun::new(robot, now),
        });
    }

    fn work(&mut self) {
        while let Some(program) = &mut self.program {
            match program.server.work(self.now, 0) {
                Work::Wait(_) => break,
                Work::Reply { order, refused } => self.on_reply(order, refused),
                Work::Run { id, by, .. } => {
                    assert_eq!(by, "wombat-1/scout");
                    let history = self.history.entry(id.clone()).or_default();
                    history.began += 1;
                    assert_eq!(history.began, 1, "{id} began twice");
                    assert!(
                        self.kept.contains_key(&id) || self.give_at.is_some(),
                        "{id} is not kept"
                    );
                    let ends =
                        self.now + STEP * u32::try_from(self.random.next() % 200).expect("small");
                    let notices = self.random.next() % 3 > 0;
                    assert!(program.handler.is_none(), "two goals at a time");
                    program.handler = Some((id, ends, false, notices));
                }
                Work::Cancel { id, .. } => {
                    if let Some(handler) = &mut program.handler {
                        assert_eq!(handler.0, id);
                        handler.2 = true;
                    }
                    self.history.entry(id).or_default().was_cancelled = true;
                }
            }
        }
        self.run_handler();
        self.publish();
    }

    fn run_handler(&mut self) {
        let now = self.now;
        let Some(program) = &mut self.program else {
            return;
        };
        let Some((id, ends, is_asked, notices)) = program.handler.clone() else {
            return;
        };
        program
            .server
            .on_feedback(&id, Feedback::new(Value::Null, Some(0.5)));
        let outcome = match (is_asked && notices, now >= ends) {
            (true, _) => Outcome::Cancelled,
            (false, true) => {
                self.history.entry(id.clone()).or_default().has_returned = true;
                let (result, noticed) = (GoalResult::Value(Value::from(7)), false);
                Outcome::Done { result, noticed }
            }
            (false, false) => return,
        };
        program.handler = None;
        program.server.on_end(&id, outcome, 0);
    }

    fn publish(&mut self) {
        while let Some(program) = &mut self.program {
            match program.server.publication(self.now) {
                Publication::Serve { .. } => unreachable!("no result is large"),
                Publication::Wait(_) => break,
                Publication::Feedback { payload, .. } => {
                    assert!(Feedback::read(&payload).is_ok());
                }
                Publication::Forget { id } => {
                    program.given.remove(&id);
                    self.kept.remove(&id);
                }
                Publication::State { id, payload, .. } => {
                    // A program may end in the middle.
                    if self.random.next() % 50 == 0 {
                        return self.kill_program();
                    }
                    program.given.insert(id.clone(), payload.clone());
                    if self.give_at.is_none() {
                        self.kept.insert(id.clone(), (payload, program.run));
                    }
                    let result = match self.give_at {
                        None => Ok(()),
                        Some(_) => Err(format!("it is not retained: {NO_KEEPER}")),
                    };
                    program.server.on_published(&id, result, self.now, 0);
                }
            }
        }
    }

    /// Delivers the state to the client if it has changed.
    fn deliver(&mut self) {
        if !self.is_linked {
            return;
        }
        let now = self.now;
        let Some(client) = &self.client else { return };
        let message = self.message(&client.id);
        let Some(client) = &mut self.client else {
            return;
        };
        let payload = message.as_ref().map(|message| message.payload.clone());
        let has_changed = payload != client.seen;
        let Some(run) = &mut client.following else {
            return;
        };
        if has_changed {
            let forgotten = || Message {
                retained: Some(Retained {
                    is_forgotten: true,
                    ..Retained::default()
                }),
                ..Message::new(
                    name("wombat-2"),
                    topic("dig", &client.id).parse().expect("a topic"),
                    Payload::new("", Encoding::BYTES),
                )
            };
            run.on_message(&message.clone().unwrap_or_else(forgotten), now);
            client.seen = payload;
        }
        if run.asks(now) {
            run.on_answer(message.as_ref(), now);
        }
    }

    /// Notes the end of the client's goal.
    fn end(&mut self) {
        let following = self
            .client
            .as_ref()
            .and_then(|client| client.following.as_ref());
        let Some(run) = following.filter(|run| run.has_ended()) else {
            return;
        };
        let (phase, id) = (run.state().phase, self.client.take().expect("a client").id);
        self.check(&id, phase);
        self.ended.push((id, phase));
    }

    /// Checks that an end is the true one.
    fn check(&self, id: &str, phase: Phase) {
        let history = self.history.get(id).expect("a history");
        let died = |run: &u64| {
            self.program
                .as_ref()
                .is_none_or(|program| program.run != *run)
        };
        match phase {
            Phase::Done => assert!(history.has_returned, "{id} has not returned"),
            Phase::Refused => assert_eq!(history.began, 0, "{id} was refused, and began"),
            Phase::Cancelled | Phase::Preempted => {
                assert!(!history.has_returned, "{id} has returned");
            }
            Phase::Lost => assert!(history.runs.iter().all(died), "{id} is not lost"),
            _ => panic!("{id}: {phase}"),
        }
    }

    fn step(&mut self) {
        self.now += STEP;
        if self.give_at.is_some_and(|at| at <= self.now) {
            self.give_at = None;
            if let Some(program) = &self.program {
                for (id, payload) in &program.given {
                    self.kept.insert(id.clone(), (payload.clone(), program.run));
                }
            }
        }
        self.repeat_order();
        self.work();
        self.deliver();
        self.end();
    }

    /// Something that happens at random.
    fn chaos(&mut self) {
        match self.random.next() % 12 {
            0 if self.client.is_none() => self.start_goal(),
            1 => self.set_linked(false),
            2 | 3 => self.set_linked(true),
            4 if self.chance(3) => self.kill_program(),
            5 | 6 if self.program.is_none() => self.start_program(),
            7 if self.chance(3) => self.restart_router(),
            8 if self.is_linked => {
                let id = self.client.as_ref().map(|client| client.id.clone());
                if let Some(id) = id {
                    self.order(&cancel(&id));
                }
            }
            // Another client.
            9 if self.is_linked && self.chance(2) => {
                self.goals += 1;
                let id = format!("other{}", self.goals);
                let run = self.runs;
                self.history.entry(id.clone()).or_default().runs.push(run);
                self.order(&start(&id, 1));
            }
            10 if self.chance(4) => {
                let stopped = self.chance(2).then(|| "stopped by laptop".to_owned());
                if let Some(program) = &mut self.program {
                    program.server.on_stop(stopped, 0);
                }
            }
            // The client begins again, and finds its goal.
            11 if self.chance(3) => {
                let now = self.now;
                if let Some(client) = &mut self.client {
                    if client.following.is_some() {
                        client.following = Some(ActionRun::new(name("wombat-2"), now));
                        client.seen = None;
                        if !self.is_linked {
                            let robot = name("wombat-2");
                            self.tell_client(&Event::PeerDown { robot });
                        }
                    }
                }
            }
            _ => {}
        }
    }
}

#[test]
fn each_goal_begins_at_most_once_and_has_one_true_end_in_10000_runs() {
    let mut ends: BTreeMap<&str, u32> = BTreeMap::new();
    for seed in 0..10_000 {
        let mut world = World::new(seed);
        for _ in 0..120 {
            for _ in 0..=world.random.next() % 5 {
                world.step();
            }
            world.chaos();
        }
        // A client that is reachable within the stated time learns of the end.
        world.set_linked(true);
        for _ in 0..600 {
            world.step();
        }
        if let Some(client) = &world.client {
            let run = client.following.as_ref();
            panic!(
                "seed {seed}: {} has no end: {:?}",
                client.id,
                run.map(ActionRun::state)
            );
        }
        for (_, phase) in world.ended {
            *ends.entry(phase.as_str()).or_default() += 1;
        }
    }
    // Each end occurs.
    for phase in ["done", "refused", "cancelled", "preempted", "lost"] {
        assert!(
            ends.get(phase).is_some_and(|count| *count > 100),
            "{ends:?}"
        );
    }
}

/// A server, and what its router keeps.
struct Bench {
    server: ActionServer,
    now: Instant,
}

impl Bench {
    fn new(rules: Rules) -> Self {
        Self {
            server: ActionServer::new(Some(&name("digger")), rules),
            now: Instant::now(),
        }
    }

    fn order(&mut self, number: u64, payload: &Payload) -> Vec<Work> {
        let laptop = name("wombat-1");
        self.server.on_order(number, Some(&laptop), payload, 5);
        self.settle()
    }

    fn settle(&mut self) -> Vec<Work> {
        let mut all = Vec::new();
        loop {
            match self.server.work(self.now, 5) {
                Work::Wait(_) => match self.server.publication(self.now) {
                    Publication::State { id, .. } => {
                        self.server.on_published(&id, Ok(()), self.now, 5);
                    }
                    Publication::Wait(_) => return all,
                    _ => {}
                },
                work => all.push(work),
            }
        }
    }

    fn phase(&self, id: &str) -> Option<Phase> {
        self.server.phase(id)
    }
}

#[test]
fn a_newer_goal_waits_for_the_end_of_the_one_that_it_preempts() {
    let mut bench = Bench::new(Rules::default());
    let begun = bench.order(1, &start("a", 1));
    assert!(
        matches!(
            &begun[..],
            [Work::Reply { refused: None, .. }, Work::Run { .. }]
        ),
        "{begun:?}"
    );
    let second = bench.order(2, &start("b", 2));
    assert!(
        matches!(&second[..], [Work::Cancel { .. }, Work::Reply { .. }]),
        "{second:?}"
    );
    assert_eq!(bench.phase("b"), Some(Phase::Waiting));
    // One more: the one that waits never begins.
    bench.order(3, &start("c", 3));
    assert_eq!(bench.phase("b"), Some(Phase::Preempted));
    bench.server.on_end("a", Outcome::Cancelled, 5);
    assert_eq!(bench.phase("a"), Some(Phase::Preempted));
    let next = bench.settle();
    assert!(
        matches!(&next[..], [Work::Run { id, .. }] if id == "c"),
        "{next:?}"
    );
}

#[test]
fn a_handler_that_did_not_notice_the_cancel_is_done() {
    for (noticed, phase) in [(false, Phase::Done), (true, Phase::Cancelled)] {
        let mut bench = Bench::new(Rules::default());
        bench.order(1, &start("a", 1));
        bench.order(2, &cancel("a"));
        assert_eq!(bench.phase("a"), Some(Phase::Cancelling));
        let result = GoalResult::Value(Value::from(1));
        bench
            .server
            .on_end("a", Outcome::Done { result, noticed }, 5);
        assert_eq!(bench.phase("a"), Some(phase));
    }
}

#[test]
fn a_goal_without_its_client_is_cancelled_unless_the_rules_say_otherwise() {
    let down = Event::ProgramDown {
        robot: name("wombat-1"),
        program: name("scout"),
    };
    for (lost_after, phase) in [
        (None, Phase::Running),
        (Some(LOST_AFTER), Phase::Cancelling),
    ] {
        let refuses = false;
        let mut bench = Bench::new(Rules {
            refuses,
            lost_after,
        });
        bench.order(1, &start("a", 1));
        bench.server.on_event(&down, bench.now);
        bench.now += LOST_AFTER;
        bench.settle();
        assert_eq!(bench.phase("a"), Some(phase));
    }
    let mut bench = Bench::new(Rules::default());
    bench.order(1, &start("a", 1));
    bench.server.on_event(&down, bench.now);
    let up = Event::ProgramUp {
        robot: name("wombat-1"),
        program: name("scout"),
    };
    bench.server.on_event(&up, bench.now);
    bench.now += LOST_AFTER;
    bench.settle();
    assert_eq!(bench.phase("a"), Some(Phase::Running));
}

#[test]
fn a_stop_cancels_all_goals_and_refuses_new_ones() {
    let mut bench = Bench::new(Rules::default());
    bench.order(1, &start("a", 1));
    bench
        .server
        .on_stop(Some("stopped by laptop".to_owned()), 5);
    bench.settle();
    assert_eq!(bench.phase("a"), Some(Phase::Cancelling));
    let refused = bench.order(2, &start("b", 1));
    assert!(
        matches!(&refused[..], [Work::Reply { refused: Some(reason), .. }] if reason == "stopped by laptop"),
        "{refused:?}"
    );
    bench.server.on_end("a", Outcome::Cancelled, 5);
    bench.server.on_stop(None, 5);
    let begun = bench.order(3, &start("c", 1));
    assert!(
        matches!(
            &begun[..],
            [Work::Reply { refused: None, .. }, Work::Run { .. }]
        ),
        "{begun:?}"
    );
}

#[test]
fn a_flood_of_goals_is_refused_and_the_ended_ones_are_forgotten() {
    let mut bench = Bench::new(Rules::default());
    for number in 0..1000 {
        bench.order(number, &start(&format!("g{number}"), 1));
    }
    assert!(bench.server.open().len() <= 2);
    bench.server.on_end("g0", Outcome::Cancelled, 5);
    bench.settle();
    assert!(
        bench.server.known() <= MAX_KEPT + 2,
        "{}",
        bench.server.known()
    );
    bench.now += KEPT_FOR + Duration::from_secs(1);
    bench.settle();
    assert_eq!(bench.server.known(), 1);
}

#[test]
fn hostile_orders_and_states_are_refused() {
    let mut bench = Bench::new(Rules::default());
    let json = |text: &str| Payload::new(text.to_owned(), Encoding::JSON);
    for wrong in [
        json("{}"),
        json(r#"{"start": {"id": "a/b"}}"#),
        json(r#"{"start": {"id": ""}}"#),
        json(r#"{"begin": {"id": "a"}}"#),
        json(&format!(
            r#"{{"start": {{"id": "a", "by": "{}"}}}}"#,
            "x".repeat(61)
        )),
        Payload::new(vec![b' '; 200_000], Encoding::JSON),
        Payload::new(vec![0x9f; 5000], Encoding::CBOR),
    ] {
        let answer = bench.order(1, &wrong);
        assert!(
            matches!(
                &answer[..],
                [Work::Reply {
                    refused: Some(_),
                    ..
                }]
            ),
            "{answer:?}"
        );
    }
    let forged = bench.order(2, &cancel("unknown"));
    assert!(matches!(
        &forged[..],
        [Work::Reply {
            refused: Some(_),
            ..
        }]
    ));
    let state =
        json(r#"{"phase": "running", "by": "\u001b[2J", "reason": "\u202e", "progress": 3}"#);
    let read = GoalState::read(&state).expect("a state");
    assert_eq!((read.by.as_str(), read.reason.as_str()), ("[2J", ""));
    assert!(GoalState::read(&json(r#"{"phase": "flying"}"#)).is_err());
    let feedback = Feedback::read(&json(r#"{"progress": 7}"#)).expect("feedback");
    assert_eq!(feedback.progress, Some(1.0));
}

#[test]
fn values_of_programs_become_parts_of_messages_and_return() {
    let json = Payload::new(r#"{"x": 1.5}"#, Encoding::JSON);
    let value = to_value(&json).expect("a value");
    let returned: serde_json::Value = to_payload(&value).value().expect("a value");
    assert_eq!(returned, serde_json::json!({"x": 1.5}));
    let nothing = ().to_payload().expect("a payload");
    assert_eq!(to_value(&nothing), Ok(Value::Null));
    let bytes = Payload::new(vec![1, 2], Encoding::BYTES);
    assert_eq!(to_payload(&to_value(&bytes).expect("a value")), bytes);
    assert_eq!(
        to_optional_value(&Payload::new("", Encoding::TEXT)),
        Ok(Value::Null)
    );
    assert_eq!(
        to_value(&Payload::new("x", Encoding::TEXT)),
        Ok(Value::from("x"))
    );
    assert!(to_value(&Payload::new(vec![0; MAX_VALUE + 1], Encoding::BYTES)).is_err());
    assert_eq!(of_topic("actions/dig/12"), Some(("dig", "12")));
    assert_eq!(of_topic(&feedback_topic("dig", "12")), None);
}

#[test]
fn the_end_of_a_program_is_believed_when_it_was_seen_twice() {
    let now = Instant::now();
    let mut run = ActionRun::new(name("wombat-2"), now);
    let message = |has_ended| Message {
        retained: Some(Retained {
            has_ended,
            ..Retained::default()
        }),
        ..Message::new(
            name("wombat-2"),
            topic("dig", "a").parse().expect("a topic"),
            GoalState {
                program: "digger".to_owned(),
                ..GoalState::new(Phase::Running)
            }
            .write(),
        )
    };
    assert!(run.on_message(&message(false), now));
    let (robot, program) = (name("wombat-2"), name("digger"));
    run.on_event(&Event::ProgramDown { robot, program }, now);
    assert!(run.asks(now + MARKED_WITHIN));
    // Its router has just restarted.
    assert!(!run.on_answer(Some(&message(true)), now) && !run.has_ended());
    assert!(!run.on_message(&message(false), now));
    run.on_no_answer(now);
    for _ in 0..2 {
        let at = run.deadline().expect("it asks");
        assert!(run.asks(at));
        run.on_answer(Some(&message(true)), at);
    }
    assert_eq!(run.state().phase, Phase::Lost);
}

#[test]
fn a_result_waits_for_a_router_that_restarts_and_is_left_out_where_there_is_no_room() {
    for (reason, result) in [(NO_KEEPER, Some(Value::from(7))), ("no room", None)] {
        let mut bench = Bench::new(Rules::default());
        bench.order(1, &start("a", 1));
        let outcome = Outcome::Done {
            result: GoalResult::Value(Value::from(7)),
            noticed: false,
        };
        bench.server.on_end("a", outcome, 5);
        let Publication::State { id, .. } = bench.server.publication(bench.now) else {
            panic!("nothing to publish");
        };
        let failed = Err(reason.to_owned());
        bench.server.on_published(&id, failed, bench.now, 5);
        assert!(!bench.server.is_finished());
        bench.now += Duration::from_secs(10);
        let Publication::State { payload, .. } = bench.server.publication(bench.now) else {
            panic!("nothing to publish");
        };
        let state = GoalState::read(&payload).expect("a state");
        assert_eq!((state.phase, state.result), (Phase::Done, result));
        bench.server.on_published(&id, Ok(()), bench.now, 5);
        assert!(bench.server.is_finished());
    }
}

#[test]
fn the_phase_of_a_found_goal_began_when_the_router_received_it_and_feedback_shows_that_it_runs() {
    let now = Instant::now() + Duration::from_secs(3600);
    let mut run = ActionRun::new(name("wombat-2"), now);
    run.on_feedback(Feedback::new(Value::Null, Some(0.5)), now);
    assert_eq!(run.state().phase, Phase::Running);
    let age = Duration::from_secs(60);
    let message = Message {
        retained: Some(Retained {
            age,
            ..Retained::default()
        }),
        ..Message::new(
            name("wombat-2"),
            topic("dig", "a").parse().expect("a topic"),
            GoalState::new(Phase::Cancelling).write(),
        )
    };
    assert!(run.on_answer(Some(&message), now));
    assert_eq!(run.since(), now - age);
    let known = KnownGoal::of(&message).expect("a goal");
    assert_eq!(known.state.age, age);
}

//! Tests a program that keeps large results and one that receives them together, in virtual time.
use std::collections::BTreeMap;

use super::*;
use crate::{
    action::{
        result::GoalResult,
        results::Results,
        state::{GoalState, Phase},
        KEPT_FOR, MAX_RESULT, MAX_VALUE,
    },
    driver::{Answer, Declaration, Get, QueryId, Sample},
    message::{
        attachment::Sent,
        retained::{value::Value, Origin},
        urgency::Urgency,
    },
    state::page::{write, Page},
};

/// The bytes per second of the link.
const RATE: u64 = 34_000;
const LATENCY: Duration = Duration::from_millis(30);

fn name(text: &str) -> Name {
    Name::new(text).expect("a name")
}

fn place(robot: &str) -> KeySpace {
    KeySpace {
        fleet: name("rect"),
        robot: name(robot),
    }
}

fn result(size: usize) -> (LargeResult, bytes::Bytes) {
    let bytes: Vec<u8> = (0..size).map(|n| ((n * n) >> 7) as u8).collect();
    match GoalResult::new("7f", Payload::new(bytes, Encoding::BYTES)) {
        Ok(GoalResult::Large(described, bytes)) => (described, bytes),
        other => panic!("not a large result: {other:?}"),
    }
}

fn done(result: &LargeResult) -> GoalState {
    GoalState {
        transfer: Some(result.clone()),
        ..GoalState::new(Phase::Done)
    }
}

/// A robot with a program that has results, and a program of another robot that receives one.
struct World {
    now: Instant,
    /// `None`: the program has ended.
    results: Option<Results>,
    declared: BTreeMap<String, Id>,
    is_linked: bool,
    /// The state that the router keeps.
    state: Option<GoalState>,
    pull: ResultPull,
    events: BTreeMap<(Instant, u64), Event>,
    /// When the link has sent what it has.
    free_at: Instant,
    sent_bytes: u64,
    questions: u32,
}

impl World {
    fn new(result: &LargeResult, bytes: bytes::Bytes) -> Self {
        let now = Instant::now();
        let mut results = Results::new(place("wombat-2"));
        results.keep(result, bytes, now);
        let (here, robot) = (place("wombat-1"), name("wombat-2"));
        let pull = ResultPull::new(&here, &robot, "dig", "7f", result, now);
        let mut world = Self {
            now,
            results: Some(results),
            declared: BTreeMap::new(),
            is_linked: true,
            state: Some(done(result)),
            pull: pull.expect("a result"),
            events: BTreeMap::new(),
            free_at: now,
            sent_bytes: 0,
            questions: 0,
        };
        world.serve();
        world
    }

    /// Executes the program that has the results. Returns its answer to a query.
    fn serve(&mut self) -> Option<Answer> {
        let mut answered = None;
        while let Some(Step::Act(action)) = self.results.as_mut().map(|one| one.poll(self.now)) {
            match action {
                Action::Declare {
                    id,
                    declaration: Declaration::Queryable { key, .. },
                } => drop(self.declared.insert(key, id)),
                Action::Undeclare { id } => self.declared.retain(|_, known| *known != id),
                Action::Answer { answer, .. } => answered = Some(answer),
                other => panic!("{other:?}"),
            }
        }
        answered
    }

    fn get(&mut self, id: Id, get: Get) {
        let reply = match self.is_linked {
            false => None,
            true if id.0 % 2 == 1 => Some(Ok(self.page())),
            true => self.piece(&get).and_then(|answer| match answer {
                Answer::Reply { payload, .. } => Some(Ok(payload)),
                Answer::Error(payload) => Some(Err(payload)),
                Answer::None => None,
            }),
        };
        let size = reply.as_ref().map_or(0, |reply| match reply {
            Ok(payload) | Err(payload) => payload.bytes.len() as u64,
        });
        self.sent_bytes += size;
        let sending = Duration::from_secs_f64(size as f64 / RATE as f64);
        self.free_at = self.free_at.max(self.now) + sending;
        let (at, number) = (self.free_at + LATENCY, self.events.len() as u64);
        let key = match id.0 % 2 {
            0 => get.selector,
            _ => place("wombat-2").own(Some(&name("wombat-2")), crate::state::STATE),
        };
        if let Some(reply) = reply {
            let reply = reply.map(|payload| Sample {
                key,
                payload,
                attachment: None,
                is_deleted: false,
                priority: Sample::PRIORITY,
            });
            let event = Event::Reply { id, reply };
            self.events.insert((at, number * 2 + id.0 * 1000), event);
        }
        let event = Event::Ended { id };
        self.events
            .insert((at, number * 2 + 1 + id.0 * 1000), event);
    }

    fn piece(&mut self, get: &Get) -> Option<Answer> {
        let id = *self.declared.get(&get.selector)?;
        assert_eq!(get.qos, Urgency::Bulk.qos());
        let results = self.results.as_mut()?;
        let event = Event::Query {
            id,
            query: QueryId(1),
            key: get.selector.clone(),
            payload: get.payload.clone()?,
            attachment: None,
        };
        let _ = results.on_event(self.now, event);
        self.serve()
    }

    /// Returns the answer of the router.
    fn page(&mut self) -> Payload {
        self.questions += 1;
        let record = self.state.as_ref().map(|state| Value {
            robot: None,
            topic: Topic::new(&topic("dig", "7f")).expect("a topic"),
            number: 1,
            origin: Origin(1, 1),
            payload: state.write(),
            urgency: Urgency::Normal,
            sent: Sent::At(0),
            age: Duration::ZERO,
            has_ended: self.results.is_none(),
            is_forgotten: false,
            kept: None,
        });
        write(&Page {
            records: record.into_iter().collect(),
            ..Page::default()
        })
    }

    /// Runs for `time`, or until the pull has finished.
    fn run(&mut self, time: Duration) -> Option<Result<Payload, PullError>> {
        let until = self.now + time;
        loop {
            let next = match self.pull.poll(self.now) {
                Step::Act(Action::Get { id, get }) => {
                    self.get(id, get);
                    continue;
                }
                Step::Wait(next) => next.expect("it never waits for ever"),
                Step::Finished(output) => return Some(output),
                other => panic!("{other:?}"),
            };
            let event = self.events.first_key_value().map(|((at, _), _)| *at);
            let next = event.map_or(next, |at| at.min(next));
            if next > until {
                self.now = until;
                return None;
            }
            self.now = next.max(self.now);
            while let Some(entry) = self.events.first_entry() {
                if entry.key().0 > self.now {
                    break;
                }
                let event = entry.remove();
                // A link that is cut loses what is on the way.
                if self.is_linked || matches!(event, Event::Ended { .. }) {
                    let _ = self.pull.on_event(self.now, event);
                }
            }
        }
    }

    fn run_to_end(&mut self) -> Result<Payload, PullError> {
        let output = self.run(Duration::from_secs(600));
        output.expect("it has ended")
    }
}

fn secs(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

fn reason(output: Result<Payload, PullError>) -> String {
    match output {
        Err(PullError::Unavailable(reason)) => reason,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_large_result_arrives_although_the_link_is_cut_for_a_minute() {
    let (described, bytes) = result(1 << 20);
    let mut world = World::new(&described, bytes.clone());
    assert_eq!(world.run(secs(10)), None);
    let before = world.pull.progress().received_bytes;
    assert!(before > 200_000, "{before}");
    world.is_linked = false;
    assert_eq!(world.run(secs(60)), None);
    assert!(world.pull.expected().contains("of 1048 kB have arrived"));
    world.is_linked = true;
    let received = world.run_to_end().expect("the result");
    assert_eq!(received, Payload::new(bytes, Encoding::BYTES));
    // Bytes that had arrived were not sent again.
    assert!(
        world.sent_bytes < (1 << 20) + 100_000,
        "{}",
        world.sent_bytes
    );
}

#[test]
fn a_result_whose_program_has_ended_is_lost_and_a_cut_says_nothing_about_that() {
    let (described, bytes) = result(1 << 20);
    let mut world = World::new(&described, bytes);
    world.run(secs(5));
    world.results = None;
    world.is_linked = false;
    assert_eq!(world.run(secs(120)), None);
    world.is_linked = true;
    let before = world.now;
    assert_eq!(
        reason(world.run_to_end()),
        "its result of 1048 kB is lost: the program that carried it out has ended"
    );
    assert!(world.now - before < secs(10), "{:?}", world.now - before);
}

#[test]
fn a_state_that_the_router_has_lost_for_a_moment_is_no_end() {
    let (described, bytes) = result(100_000);
    let mut world = World::new(&described, bytes);
    let declared = std::mem::take(&mut world.declared);
    world.state = None;
    while world.questions == 0 {
        assert_eq!(world.run(Duration::from_millis(100)), None);
    }
    (world.state, world.declared) = (Some(done(&described)), declared);
    assert!(world.run_to_end().is_ok());

    let mut world = World::new(&described, bytes::Bytes::new());
    world.results = None;
    world.state = None;
    let text = reason(world.run_to_end());
    assert!(text.ends_with("does not know it any more"), "{text}");
    assert_eq!(world.questions, GONE_AFTER);
}

#[test]
fn a_result_that_nobody_serves_does_not_make_programs_wait_for_ever() {
    let (described, bytes) = result(100_000);
    let mut world = World::new(&described, bytes);
    world.declared.clear();
    let text = reason(world.run_to_end());
    assert!(text.ends_with("try again"), "{text}");
}

#[test]
fn damaged_bytes_are_no_result() {
    let (described, bytes) = result(100_000);
    let mut damaged = bytes.to_vec();
    damaged[50_000] ^= 1;
    let mut world = World::new(&described, damaged.into());
    let text = reason(world.run_to_end());
    assert!(text.contains("the checksum is wrong"), "{text}");
}

#[test]
fn newer_results_take_the_room_of_the_oldest_and_each_is_kept_for_its_time() {
    let (described, bytes) = result(MAX_RESULT);
    let mut world = World::new(&described, bytes.clone());
    for number in 0..5 {
        let newer = LargeResult {
            id: format!("{number:016x}"),
            ..described.clone()
        };
        let results = world.results.as_mut().expect("a program");
        results.keep(&newer, bytes.clone(), world.now);
    }
    world.serve();
    assert_eq!(world.declared.len(), 6);
    let text = reason(world.run_to_end());
    assert!(
        text.ends_with("newer results have taken its room"),
        "{text}"
    );
    world.now += KEPT_FOR + secs(61);
    world.serve();
    assert!(world.declared.is_empty());
}

#[test]
fn a_flood_of_results_is_bounded() {
    let (described, bytes) = result(MAX_VALUE + 1);
    let mut world = World::new(&described, bytes.clone());
    for number in 0..1000 {
        let newer = LargeResult {
            id: format!("{number:016x}"),
            ..described.clone()
        };
        let results = world.results.as_mut().expect("a program");
        results.keep(&newer, bytes.clone(), world.now);
        world.serve();
    }
    assert!(world.declared.len() <= 64, "{}", world.declared.len());
}

#[test]
fn sizes_and_descriptions_are_checked_before_memory_is_reserved() {
    let of = |payload| GoalResult::new("7f", payload);
    let bytes = |size| Payload::new(vec![b' '; size], Encoding::BYTES);
    assert!(matches!(of(bytes(MAX_VALUE)), Ok(GoalResult::Value(_))));
    assert!(matches!(of(bytes(MAX_RESULT)), Ok(GoalResult::Large(..))));
    let refused = of(bytes(MAX_RESULT + 1)).expect_err("too large");
    assert!(refused.contains("send it as a transfer"), "{refused}");
    let long = Payload::new(vec![0; MAX_VALUE + 1], Encoding::new("x".repeat(201)));
    assert!(of(long).is_err());

    let (valid, _) = result(100_000);
    let payload = done(&valid).write();
    assert!(payload.bytes.len() < crate::action::URGENT_END);
    let read = GoalState::read(&payload).expect("a state");
    assert_eq!(
        (&read.transfer, read.result()),
        (&Some(valid.clone()), None)
    );
    let changed = |change: fn(&mut LargeResult)| {
        let mut changed = valid.clone();
        change(&mut changed);
        let (here, robot) = (place("wombat-1"), name("wombat-2"));
        let pull = ResultPull::new(&here, &robot, "dig", "7f", &changed, Instant::now());
        pull.map(drop)
    };
    assert_eq!(changed(|_| {}), Ok(()));
    for change in [
        (|wrong| wrong.size_bytes = u64::MAX) as fn(&mut LargeResult),
        |wrong| wrong.size_bytes = MAX_RESULT as u64 + 1,
        |wrong| wrong.id = "../../@rect/inbox".to_owned(),
        |wrong| wrong.id = "+00000000000000f".to_owned(),
        |wrong| wrong.id = String::new(),
        |wrong| wrong.sha256 = "äöüäöüäöüäöüäöüäöüäöüäöüäöüäöüäö".to_owned(),
        |wrong| wrong.sha256.truncate(62),
        |wrong| wrong.encoding = "x".repeat(201),
        |wrong| wrong.encoding = "text/plain\u{1b}[2J".to_owned(),
    ] {
        assert!(changed(change).is_err());
    }
    for wrong in [
        r#"{"phase": "done", "transfer": 5}"#,
        r#"{"phase": "done", "transfer": {"id": "00"}}"#,
        r#"{"phase": "done", "transfer": {"id": "", "size_bytes": -1, "sha256": "", "encoding": ""}}"#,
    ] {
        assert!(GoalState::read(&Payload::new(wrong, Encoding::JSON)).is_err());
    }
}

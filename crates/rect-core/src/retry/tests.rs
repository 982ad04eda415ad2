//! Runs repeated requests in virtual time through a model of two robots whose link is cut, and whose programs and routers crash.
//! Run them with `cargo test -p rect-core retry`.
use std::{
    collections::{BTreeMap, BTreeSet, HashMap},
    time::{Duration, Instant},
};

use super::{
    once::{Admission, Execution, Once, KEEP, MAX_BYTES, MAX_KEPT, MAX_RUNNING, MAX_RUNS},
    request::{Outcome, RetriedRequest},
};
use crate::{
    catalogue::{token::Token, Instance, Program, ServiceEntry},
    driver::{Action, Answer, Driver, Event, Get, Id, Sample, Step},
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{error_from_payload, error_to_payload, RequestHeader, RequestId},
        urgency::Urgency,
    },
    name::{key::KeySpace, topic::Topic, Name},
    registry::catalogue_query::Catalogues,
    session::{
        inquiry::{Inquiry, ReplyKind},
        request_ids::RequestIds,
    },
    stream::simulation::Random,
};

fn name(text: &str) -> Name {
    Name::new(text).expect("valid name")
}

fn topic() -> Topic {
    Topic::new("grab").expect("valid topic")
}

fn place() -> KeySpace {
    KeySpace {
        fleet: name("rect"),
        robot: name("laptop"),
    }
}

fn text(text: impl Into<String>) -> Payload {
    Payload::new(text.into(), Encoding::TEXT)
}

fn sample(key: String, payload: Payload) -> Sample {
    Sample {
        key,
        payload,
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    }
}

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

/// A program that serves the topic.
struct Server {
    run: Instance,
    once: Once<usize>,
    /// The requests that it carries out, with their first queries.
    running: HashMap<RequestId, (Execution<usize>, usize)>,
    /// Whether it has a token and stands in the catalogue: not while its router is down, and a moment after that.
    is_connected: bool,
    is_registered: bool,
}

/// A query that the requester has sent.
struct Query {
    call: usize,
    id: Id,
    get: Get,
    /// The runs of programs that have not ended it.
    at: BTreeSet<Instance>,
    has_ended: bool,
}

/// A call of the requester.
struct Call {
    id: RequestId,
    driver: RetriedRequest,
    deadline: Instant,
    sent: usize,
    outcome: Option<Outcome>,
    is_abandoned: bool,
}

enum Happening {
    Request,
    Poll(usize),
    Arrive(usize),
    Answer(usize, Instance, Answer),
    End(usize),
    TimeOut(usize),
    Done(Instance, RequestId),
    Cut(bool),
    CrashServer,
    StartServer,
    CrashRouter,
    StartRouter,
    Connect(Instance),
    Register(Instance),
    CrashRequester,
}

struct World {
    now: Instant,
    random: Random,
    next: u64,
    happenings: BTreeMap<(Instant, u64), Happening>,
    is_cut: bool,
    router_runs: bool,
    allows_several: bool,
    has_crashed: bool,
    servers: Vec<Server>,
    requester: (RequestIds, Catalogues),
    calls: Vec<Call>,
    queries: Vec<Query>,
    /// The results of the requests that were carried out; `None`: there was no reply.
    executed: HashMap<RequestId, Vec<(Instance, Option<Answer>)>>,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut world = Self {
            now: Instant::now(),
            random: Random(seed),
            next: 0,
            happenings: BTreeMap::new(),
            is_cut: false,
            router_runs: true,
            allows_several: seed % 4 == 0,
            has_crashed: false,
            servers: Vec::new(),
            requester: (RequestIds::new(Instance(1), true), Catalogues::default()),
            calls: Vec::new(),
            queries: Vec::new(),
            executed: HashMap::new(),
        };
        for _ in 0..1 + usize::from(world.allows_several) {
            world.happens(Duration::ZERO, Happening::StartServer);
        }
        for _ in 0..8 {
            world.happens_within(500..20_000, Happening::Request);
        }
        // Each run has some of these.
        for _ in 0..world.below(6) {
            let happening = match world.below(10) {
                0..5 => Happening::Cut(true),
                5..8 => Happening::CrashServer,
                8 => Happening::CrashRouter,
                _ => Happening::CrashRequester,
            };
            world.happens_within(500..25_000, happening);
        }
        world
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.random.next() % limit
    }

    fn happens(&mut self, after: Duration, happening: Happening) {
        self.next += 1;
        let at = (self.now + after, self.next);
        self.happenings.insert(at, happening);
    }

    fn happens_within(&mut self, range: std::ops::Range<u64>, happening: Happening) {
        let after = range.start + self.below(range.end - range.start);
        self.happens(ms(after), happening);
    }

    fn is_reachable(&self) -> bool {
        self.router_runs && !self.is_cut
    }

    fn run(&mut self) {
        while let Some(((at, _), happening)) = self.happenings.pop_first() {
            self.now = at;
            self.on_happening(happening);
        }
    }

    fn on_happening(&mut self, happening: Happening) {
        match happening {
            Happening::Request => self.request(),
            Happening::Poll(call) => self.poll(call),
            Happening::Arrive(query) => self.arrive(query),
            Happening::Answer(query, run, answer) => self.on_answer(query, run, answer),
            Happening::End(query) => self.end(query),
            Happening::TimeOut(query) => {
                if !self.queries[query].has_ended {
                    self.reply(query, Err(text("Timeout")));
                    self.end(query);
                }
            }
            Happening::Done(run, id) => self.on_done(run, id),
            Happening::Cut(is_cut) => {
                self.is_cut = is_cut;
                self.has_crashed = true;
                if is_cut {
                    self.end_queries();
                    self.happens_within(10..6000, Happening::Cut(false));
                }
            }
            Happening::StartServer => {
                let run = Instance(self.random.next() as u32);
                self.servers.push(Server {
                    run,
                    once: Once::new(name("wombat-1"), run),
                    running: HashMap::new(),
                    is_connected: self.router_runs,
                    is_registered: self.router_runs,
                });
            }
            Happening::CrashServer => {
                self.has_crashed = true;
                if let Some(server) = self.servers.pop() {
                    let run = server.run;
                    let at = |query: &Query| query.at.contains(&run);
                    for query in 0..self.queries.len() {
                        if at(&self.queries[query]) {
                            self.happens_within(0..50, Happening::Answer(query, run, Answer::None));
                        }
                    }
                    if self.below(4) > 0 {
                        self.happens_within(1..3000, Happening::StartServer);
                    }
                }
            }
            Happening::CrashRouter => {
                (self.router_runs, self.has_crashed) = (false, true);
                for server in &mut self.servers {
                    (server.is_connected, server.is_registered) = (false, false);
                }
                self.end_queries();
                self.happens_within(10..4000, Happening::StartRouter);
            }
            Happening::StartRouter => {
                self.router_runs = true;
                for run in self
                    .servers
                    .iter()
                    .map(|server| server.run)
                    .collect::<Vec<_>>()
                {
                    self.happens_within(0..1500, Happening::Connect(run));
                }
            }
            Happening::Connect(run) => {
                self.server(run, |server| server.is_connected = true);
                self.happens_within(0..800, Happening::Register(run));
            }
            Happening::Register(run) => self.server(run, |server| server.is_registered = true),
            Happening::CrashRequester => {
                for call in self.calls.iter_mut().filter(|call| call.outcome.is_none()) {
                    call.is_abandoned = true;
                }
                let run = Instance(self.random.next() as u32);
                self.requester = (RequestIds::new(run, true), Catalogues::default());
            }
        }
    }

    fn server(&mut self, run: Instance, change: impl FnOnce(&mut Server)) {
        if let Some(server) = self.servers.iter_mut().find(|server| server.run == run) {
            change(server);
        }
    }

    /// A link or a router has ended: no replies follow to the queries that were under way.
    fn end_queries(&mut self) {
        for query in 0..self.queries.len() {
            if !self.queries[query].has_ended {
                self.happens_within(0..50, Happening::End(query));
            }
        }
    }

    fn request(&mut self) {
        let timeout = ms(500 + self.below(20_000));
        let (ids, catalogues) = &self.requester;
        let inquiry = Inquiry::new(place(), Some(name("wombat-1")), topic(), timeout, ids);
        let get = inquiry.get(text("3"), Urgency::Normal);
        let header = get.attachment.as_deref().and_then(RequestHeader::decode);
        let driver = RetriedRequest::new(
            self.now,
            inquiry,
            name("wombat-1"),
            text("3"),
            Urgency::Normal,
            catalogues.clone(),
        );
        self.calls.push(Call {
            id: header.expect("a header").id,
            driver: driver.expect("a short timeout"),
            deadline: self.now + timeout,
            sent: 0,
            outcome: None,
            is_abandoned: false,
        });
        self.poll(self.calls.len() - 1);
    }

    fn poll(&mut self, call: usize) {
        loop {
            let calling = &mut self.calls[call];
            if calling.outcome.is_some() || calling.is_abandoned {
                return;
            }
            match calling.driver.poll(self.now) {
                Step::Act(Action::Get { id, get }) => self.send(call, id, get),
                Step::Wait(None) => return,
                Step::Wait(Some(until)) => {
                    let after = until - self.now;
                    return self.happens(after, Happening::Poll(call));
                }
                Step::Finished(outcome) => {
                    assert!(self.now <= calling.deadline, "a result after the deadline");
                    calling.outcome = Some(outcome);
                }
                Step::Act(action) => panic!("{action:?}"),
            }
        }
    }

    fn on_event(&mut self, call: usize, event: Event) {
        let calling = &mut self.calls[call];
        if calling.outcome.is_none() && calling.driver.on_event(self.now, event).polls {
            self.poll(call);
        }
    }

    fn send(&mut self, call: usize, id: Id, get: Get) {
        let (timeout, is_request) = (get.timeout, get.attachment.is_some());
        self.calls[call].sent += usize::from(is_request);
        let query = self.queries.len();
        self.queries.push(Query {
            call,
            id,
            get,
            at: BTreeSet::new(),
            has_ended: false,
        });
        self.happens(timeout, Happening::TimeOut(query));
        if self.is_reachable() {
            // A busy link delays some of them.
            let longest = if self.below(10) == 0 { 4000 } else { 60 };
            self.happens_within(1..longest, Happening::Arrive(query));
        } else {
            self.happens_within(0..5, Happening::End(query));
        }
    }

    /// A query arrives at the robot of the service. It may have been on the way when the link was cut.
    fn arrive(&mut self, query: usize) {
        let get = self.queries[query].get.clone();
        if !self.router_runs {
            return self.end(query);
        }
        let header = get.attachment.as_deref().and_then(RequestHeader::decode);
        let Some(header) = header else {
            for reply in self.registry_replies(&get) {
                self.reply(query, Ok(reply));
            }
            return self.end(query);
        };
        let connected = self.servers.iter().filter(|server| server.is_connected);
        self.queries[query].at = connected.map(|server| server.run).collect();
        for run in self.queries[query].at.clone() {
            self.admit(run, query, &header);
        }
        if self.queries[query].at.is_empty() {
            self.end(query);
        }
    }

    fn registry_replies(&self, get: &Get) -> Vec<Sample> {
        let robot = name("wombat-1");
        let connected = self.servers.iter().filter(|server| server.is_connected);
        if get.liveliness && get.selector.contains("/p/") {
            let token = |server: &Server| Token {
                robot: robot.clone(),
                program: None,
                instance: server.run,
                revision: 1,
            };
            let key = |server: &Server| token(server).key(&place().fleet);
            return connected
                .map(|server| sample(key(server), text("")))
                .collect();
        }
        if get.liveliness {
            return Vec::new();
        }
        let program = |server: &Server| Program {
            name: None,
            instance: server.run,
            services: vec![ServiceEntry::new(topic(), "", self.allows_several)],
        };
        let registered = connected.filter(|server| server.is_registered);
        let programs: Vec<_> = registered.map(|server| program(server).to_json()).collect();
        let json = format!("[{}]", programs.join(","));
        vec![sample(
            "rect/wombat-1/@rect/catalogue".to_owned(),
            text(json),
        )]
    }

    fn admit(&mut self, run: Instance, query: usize, header: &RequestHeader) {
        let now = self.now;
        let Some(server) = self.servers.iter_mut().find(|server| server.run == run) else {
            return;
        };
        match server.once.on_request(now, Some(header), query) {
            Admission::Execute(query, execution) => {
                let execution = execution.expect("the request names a run");
                server.running.insert(header.id, (execution, query));
                self.happens_within(0..2500, Happening::Done(run, header.id));
                let key = "rect/wombat-1/grab".to_owned();
                let count = self.executed.values().flatten().count();
                let result = text(format!("{run} {count}"));
                let answer = match self.below(20) {
                    0 => None,
                    1 => Some(Answer::Error(error_to_payload(&name("wombat-1"), result))),
                    _ => Some(Answer::Reply {
                        key,
                        payload: result,
                    }),
                };
                let executed = self.executed.entry(header.id).or_default();
                executed.push((run, answer));
            }
            Admission::Wait(replaced) => {
                if let Some(replaced) = replaced {
                    self.on_answer(replaced, run, Answer::None);
                }
            }
            Admission::Answer(query, answer) => {
                self.happens_within(0..60, Happening::Answer(query, run, answer));
            }
        }
    }

    fn on_done(&mut self, run: Instance, id: RequestId) {
        let Some(server) = self.servers.iter_mut().find(|server| server.run == run) else {
            return;
        };
        let (execution, query) = server.running.remove(&id).expect("it is being carried out");
        let answer = self.executed[&id].iter().find(|(by, _)| *by == run);
        let (_, answer) = answer.expect("it was carried out").clone();
        let waiting = answer
            .as_ref()
            .and_then(|answer| execution.on_result(answer));
        drop(execution);
        for query in [Some(query), waiting].into_iter().flatten() {
            let answer = answer.clone().unwrap_or(Answer::None);
            self.happens_within(0..60, Happening::Answer(query, run, answer));
        }
    }

    /// A program has answered a query and ended it.
    fn on_answer(&mut self, query: usize, run: Instance, answer: Answer) {
        if self.is_reachable() {
            match answer {
                Answer::Reply { key, payload } => self.reply(query, Ok(sample(key, payload))),
                Answer::Error(error) => self.reply(query, Err(error)),
                Answer::None => {}
            }
        }
        self.queries[query].at.remove(&run);
        if self.queries[query].at.is_empty() {
            self.end(query);
        }
    }

    fn reply(&mut self, query: usize, reply: Result<Sample, Payload>) {
        let Query {
            call,
            id,
            has_ended,
            ..
        } = self.queries[query];
        if !has_ended {
            self.on_event(call, Event::Reply { id, reply });
        }
    }

    fn end(&mut self, query: usize) {
        let query = &mut self.queries[query];
        if !std::mem::replace(&mut query.has_ended, true) {
            let (call, id) = (query.call, query.id);
            self.on_event(call, Event::Ended { id });
        }
    }

    /// Checks what the requester was informed of. Returns the outcomes, and how many requests were repeated.
    fn check(&self, counts: &mut BTreeMap<&'static str, usize>, seed: u64) {
        for call in &self.calls {
            let executed = self.executed.get(&call.id).map_or(&[][..], Vec::as_slice);
            assert!(
                executed.len() <= 1,
                "seed {seed}: {:?} was carried out twice",
                call.id
            );
            let result = executed.first().and_then(|(_, result)| result.as_ref());
            let outcome = match &call.outcome {
                None => {
                    assert!(
                        call.is_abandoned,
                        "seed {seed}: {:?} has no outcome",
                        call.id
                    );
                    "abandoned"
                }
                Some(Outcome::Replied(ReplyKind::Answer { payload, .. })) => {
                    let replied =
                        matches!(result, Some(Answer::Reply { payload: of, .. }) if of == payload);
                    assert!(replied, "seed {seed}: {payload:?}, but {result:?}");
                    "answer"
                }
                Some(Outcome::Replied(ReplyKind::Error { payload, .. })) => {
                    let of = match result {
                        Some(Answer::Error(error)) => Some(error_from_payload(error.clone()).1),
                        _ => None,
                    };
                    assert_eq!(of.as_ref(), Some(payload), "seed {seed}");
                    "error"
                }
                Some(Outcome::Replied(ReplyKind::TimedOut)) => "timed out",
                Some(Outcome::Interrupted) => {
                    assert!(call.sent > 0, "seed {seed}: nothing was sent");
                    let has_no_reply = executed.iter().any(|(_, result)| result.is_none());
                    assert!(
                        self.has_crashed || has_no_reply,
                        "seed {seed}: nothing has ended"
                    );
                    "interrupted"
                }
                Some(Outcome::Plain) => {
                    assert_eq!((call.sent, executed.len()), (0, 0), "seed {seed}");
                    "plain"
                }
                Some(outcome) => panic!("seed {seed}: {outcome:?}"),
            };
            *counts.entry(outcome).or_default() += 1;
            if call.sent > 1 && matches!(outcome, "answer" | "error") {
                *counts.entry("repeated").or_default() += 1;
            }
        }
    }
}

#[test]
fn requests_are_carried_out_at_most_once_and_each_outcome_is_true() {
    let mut counts = BTreeMap::new();
    for seed in 0..1000 {
        let mut world = World::new(seed);
        world.run();
        world.check(&mut counts, seed);
    }
    // The model reaches everything.
    for outcome in [
        "answer",
        "error",
        "timed out",
        "interrupted",
        "plain",
        "abandoned",
        "repeated",
    ] {
        assert!(counts.get(outcome) >= Some(&20), "{counts:?}");
    }
}

fn header(run: u32, number: u32, timeout_ms: u32) -> RequestHeader {
    RequestHeader {
        sender: name("laptop"),
        timeout_ms,
        id: RequestId {
            run: Instance(run),
            number,
        },
        is_announced: true,
        is_stream: false,
        once_by: Some(Instance(9)),
    }
}

fn once() -> (Once<u32>, Instant) {
    (Once::new(name("wombat-1"), Instance(9)), Instant::now())
}

/// Sends a request. Returns whether it was carried out, or else the text of the reply.
fn ask(once: &Once<u32>, now: Instant, header: &RequestHeader, result: &Answer) -> Option<String> {
    match once.on_request(now, Some(header), 0) {
        Admission::Execute(_, Some(execution)) => {
            execution.on_result(result);
            None
        }
        Admission::Answer(_, Answer::Reply { payload, .. } | Answer::Error(payload)) => {
            Some(String::from_utf8_lossy(&payload.bytes).into_owned())
        }
        admission => panic!("{admission:?}"),
    }
}

fn reply(text: impl Into<String>) -> Answer {
    Answer::Reply {
        key: "rect/wombat-1/grab".to_owned(),
        payload: self::text(text),
    }
}

#[test]
fn the_first_reply_is_repeated_also_to_the_query_that_waits() {
    let (once, now) = once();
    let request = header(1, 7, 1000);
    let Admission::Execute(1, Some(execution)) = once.on_request(now, Some(&request), 1) else {
        panic!("the first request is carried out");
    };
    for (query, replaced) in [(2, None), (3, Some(2))] {
        let admission = once.on_request(now, Some(&request), query);
        assert!(matches!(admission, Admission::Wait(of) if of == replaced));
    }
    assert_eq!(execution.on_result(&reply("first")), Some(3));
    assert_eq!(execution.on_result(&reply("second")), None);
    drop(execution);
    assert_eq!(
        ask(&once, now, &request, &reply("")).as_deref(),
        Some("first")
    );
}

#[test]
fn request_without_a_reply_is_not_carried_out_again() {
    let (once, now) = once();
    drop(once.on_request(now, Some(&header(1, 7, 1000)), 1));
    let again = ask(&once, now, &header(1, 7, 1000), &reply(""));
    assert!(again.is_some_and(|text| text.contains("not kept")));
}

#[test]
fn requests_without_an_id_or_for_another_run_are_not_remembered() {
    let (once, now) = once();
    let each_time = RequestHeader {
        once_by: None,
        ..header(1, 7, 1000)
    };
    for header in [None, Some(&each_time), Some(&each_time)] {
        let admission = once.on_request(now, header, 1);
        assert!(matches!(admission, Admission::Execute(1, None)));
    }
    let other = RequestHeader {
        once_by: Some(Instance(8)),
        ..header(1, 7, 1000)
    };
    let refused = ask(&once, now, &other, &reply(""));
    assert!(refused.is_some_and(|text| text.contains("another run")));
    assert_eq!(ask(&once, now, &header(1, 7, 1000), &reply("")), None);
}

#[test]
fn flood_of_ids_is_bounded_and_never_leads_to_a_second_execution() {
    let (once, now) = once();
    let kept = u32::try_from(MAX_KEPT).expect("small");
    for number in 0..1000 {
        assert_eq!(
            ask(&once, now, &header(1, number, 1000), &reply("done")),
            None
        );
    }
    for number in 0..1000 {
        let again = ask(&once, now, &header(1, number, 1000), &reply(""));
        let is_kept = again.as_deref() == Some("done");
        assert_eq!(is_kept, number >= 1000 - kept, "{number}: {again:?}");
    }
    // One that the newer ones have overtaken might have been carried out.
    let holes = header(2, 500, 1000);
    for number in (0..1000).filter(|number| *number != 500) {
        assert_eq!(
            ask(&once, now, &header(2, number, 1000), &reply("done")),
            None
        );
    }
    let overtaken = ask(&once, now, &holes, &reply(""));
    assert!(overtaken.is_some_and(|text| text.contains("not kept")));
}

#[test]
fn flood_of_runs_is_refused_until_they_are_silent() {
    let (once, now) = once();
    let runs = u32::try_from(MAX_RUNS).expect("small");
    for run in 0..runs {
        assert_eq!(ask(&once, now, &header(run, 0, 1000), &reply("done")), None);
    }
    let last = now + KEEP + ms(999);
    let busy = ask(&once, last, &header(runs, 0, 1000), &reply(""));
    assert!(busy.is_some_and(|text| text.contains("try again later")));
    // Those that are remembered are still served, and stay.
    assert_eq!(
        ask(&once, last, &header(0, 0, 1000), &reply("")).as_deref(),
        Some("done")
    );
    assert_eq!(
        ask(&once, last + ms(1), &header(runs, 0, 1000), &reply("")),
        None
    );
    assert_eq!(
        ask(&once, last + ms(1), &header(0, 0, 1000), &reply("")).as_deref(),
        Some("done")
    );
}

#[test]
fn requests_that_are_being_carried_out_are_never_forgotten() {
    let (once, now) = once();
    let (first, later) = (header(0, 0, 1000), now + 100 * KEEP);
    let running = once.on_request(now, Some(&first), 1);
    let number_of = |number: usize| u32::try_from(number).expect("small");
    let others: Vec<_> = (1..MAX_RUNNING)
        .map(|number| once.on_request(now, Some(&header(1, number_of(number), 1000)), 1))
        .collect();
    let one_more = ask(
        &once,
        now,
        &header(1, number_of(MAX_RUNNING), 1000),
        &reply(""),
    );
    assert!(one_more.is_some_and(|text| text.contains("try again later")));
    drop(others);
    for number in 0..200 {
        let request = header(number + 2, 0, 1000);
        assert_eq!(
            ask(&once, later + 2 * KEEP * number, &request, &reply("")),
            None
        );
    }
    let again = once.on_request(later, Some(&first), 2);
    assert!(matches!(again, Admission::Wait(None)), "{again:?}");
    drop(running);
}

#[test]
fn replies_are_kept_up_to_a_size_in_all() {
    let (once, now) = once();
    let half = reply("x".repeat(MAX_BYTES / 2 - 100));
    for number in 0..3 {
        assert_eq!(ask(&once, now, &header(1, number, 1000), &half), None);
    }
    let too_large = reply("x".repeat(MAX_BYTES));
    assert_eq!(ask(&once, now, &header(1, 3, 1000), &too_large), None);
    let is_kept = |number| {
        let again = ask(&once, now, &header(1, number, 1000), &half);
        !again.expect("it was carried out").contains("not kept")
    };
    assert_eq!([0, 1, 2, 3].map(is_kept), [false, true, true, false]);
}

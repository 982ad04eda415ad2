//! Observes the fleet while a browser shows the page: robots, their links, topics and events.
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    sync::Arc,
    time::{Duration, Instant},
};

use rect::{Connection, ConnectionState, Event, Events, Name, Program, Robot};
use rect_core::registry::{topics::Topics, usage::on_air};
use rect_recording::report::EventReport;
use serde_json::Value;
use tokio::{
    task::JoinSet,
    time::{interval, MissedTickBehavior},
};

use crate::{
    programs,
    protocol::{now_ms, RobotState, ShownConnection, State, TimedEvent, TopicRow},
    topics, App, Failure,
};

/// How often the states are sent to browsers.
const SHOWN_EVERY: Duration = Duration::from_secs(1);
/// How often this robot's router is asked for its connections. That puts nothing on the air.
const OWN_EVERY: Duration = Duration::from_secs(2);
/// How often the router of another robot is asked: an answer has about 600 bytes for each connection.
const OTHERS_EVERY: Duration = Duration::from_secs(15);
/// How often this robot's router is asked for topics.
const OWN_TOPICS_EVERY: Duration = Duration::from_secs(3);
/// How often all routers are asked for topics: an answer has about 45 bytes for each topic.
const TOPICS_EVERY: Duration = Duration::from_secs(12);
/// How often the programs of all robots are asked for. Only a change puts something on the air.
const PROGRAMS_EVERY: Duration = Duration::from_secs(2);
/// For how long routers count messages after a question.
const KEEP: Duration = Duration::from_secs(18);
/// How long a router counts messages before it is asked again for the first time.
const COUNTED: Duration = Duration::from_secs(1);
/// The number of events that are kept.
const MAX_EVENTS: usize = 200;
/// The number of robots that are asked at the same time.
const MAX_ASKING: usize = 8;

/// The record of a robot.
#[derive(Default)]
struct RobotRecord {
    reachable: bool,
    /// When it became unreachable, in milliseconds since 1970.
    silent_since_ms: Option<u64>,
    asking: bool,
    asked: Option<Instant>,
    connections: Option<Vec<Connection>>,
    programs: Option<Vec<Program>>,
    status: Option<Value>,
    started_s: Option<u64>,
    /// Why it did not answer.
    failure: Option<String>,
}

/// An answer of a robot's router.
struct Answer {
    robot: Name,
    connections: Result<Vec<Connection>, rect::Error>,
    status: Option<Value>,
}

/// The answers of the routers about topics.
struct FoundTopics {
    /// The one robot whose router was asked.
    of: Option<Name>,
    topics: Result<Vec<(String, Topics)>, Failure>,
}

struct Observer {
    app: Arc<App>,
    robot: Robot,
    records: BTreeMap<Name, RobotRecord>,
    events: VecDeque<TimedEvent>,
    asking: JoinSet<Answer>,
    /// The topics of each robot, as its router has last counted them.
    topics: BTreeMap<String, Topics>,
    asking_topics: JoinSet<FoundTopics>,
    asking_programs: JoinSet<Vec<programs::Answer>>,
    ask_programs_at: Instant,
    ask_topics_at: Instant,
    ask_own_topics_at: Instant,
    connected: bool,
}

/// Observes the fleet until the session is closed.
///
/// # Errors
/// Fails if the session is closed already.
pub async fn observe(app: Arc<App>) -> Result<(), rect::Error> {
    let robot = app.robot.clone();
    let events = robot.events().await?;
    let mut observer = Observer {
        records: BTreeMap::from([(robot.name().clone(), RobotRecord::default())]),
        robot,
        app,
        events: VecDeque::new(),
        asking: JoinSet::new(),
        topics: BTreeMap::new(),
        asking_topics: JoinSet::new(),
        asking_programs: JoinSet::new(),
        ask_programs_at: Instant::now(),
        ask_topics_at: Instant::now(),
        ask_own_topics_at: Instant::now(),
        connected: true,
    };
    observer.run(events).await;
    Ok(())
}

impl Observer {
    async fn run(&mut self, events: Events) {
        let mut tick = interval(SHOWN_EVERY);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                event = events.next() => match event {
                    Some(event) => self.on_event(&event),
                    None => return,
                },
                Some(Ok(answer)) = self.asking.join_next() => self.on_answer(answer),
                Some(Ok(found)) = self.asking_topics.join_next() => self.on_topics(found),
                Some(Ok(found)) = self.asking_programs.join_next() => self.on_programs(found),
                _ = tick.tick() => {
                    if self.app.browsers.any() {
                        self.ask();
                        self.ask_for_topics();
                        self.ask_for_programs();
                        self.show();
                    }
                }
            }
        }
    }

    fn on_event(&mut self, event: &Event) {
        self.app.stop.on_event(event);
        match event {
            Event::PeerUp { robot } => {
                let record = self.records.entry(robot.clone()).or_default();
                // It is asked at once.
                (record.reachable, record.asked) = (true, None);
                record.silent_since_ms = None;
            }
            Event::PeerDown { robot } => {
                if let Some(record) = self.records.get_mut(robot) {
                    record.reachable = false;
                    record.silent_since_ms = Some(now_ms());
                }
            }
            Event::LinkUp(_)
            | Event::LinkDown(_)
            | Event::LinkSilent(_)
            | Event::LinkResumed(_)
            | Event::PathSwitched { .. } => {
                for record in self.records.values_mut() {
                    record.asked = None;
                }
            }
            Event::ProgramUp { .. } => self.ask_programs_at = Instant::now(),
            Event::ProgramDown { .. } => {
                self.ask_programs_at = Instant::now();
                self.app.alerts.on_program_end();
            }
            Event::RouterUp => self.connected = true,
            Event::RouterDown => self.connected = false,
        }
        let of = self.robot.name().to_string();
        let report = EventReport::from(event);
        self.add_event(TimedEvent::new(now_ms(), &of, &report));
    }

    fn add_event(&mut self, event: TimedEvent) {
        if self.events.len() >= MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }

    /// Asks the routers that were not asked for a while.
    fn ask(&mut self) {
        let own = self.robot.name().clone();
        for (name, record) in &mut self.records {
            let every = if *name == own {
                OWN_EVERY
            } else {
                OTHERS_EVERY
            };
            let is_due = record.asked.is_none_or(|asked| asked.elapsed() >= every);
            let is_reachable = record.reachable || *name == own;
            if record.asking || !is_due || !is_reachable || self.asking.len() >= MAX_ASKING {
                continue;
            }
            (record.asking, record.asked) = (true, Some(Instant::now()));
            let (robot, name) = (self.robot.clone(), name.clone());
            // The status of a router hardly changes.
            let asks_status = record.status.is_none() || name == own;
            self.asking.spawn(async move {
                let status = match asks_status {
                    true => robot.query_registry(name.clone(), "status", "").await.ok(),
                    false => None,
                };
                let connections = robot.connections_of(name.clone(), "").await;
                Answer {
                    robot: name,
                    connections,
                    status,
                }
            });
        }
    }

    fn on_answer(&mut self, answer: Answer) {
        let record = self.records.entry(answer.robot.clone()).or_default();
        record.asking = false;
        if let Some(status) = answer.status {
            let up_s = status["up_s"].as_f64().map(|up_s| up_s as u64);
            record.started_s = up_s.map(|up_s| (now_ms() / 1000).saturating_sub(up_s));
            record.status = Some(status);
        }
        match answer.connections {
            Ok(connections) => {
                let before = record.connections.replace(connections.clone());
                record.failure = None;
                let failures = new_failures(before.as_deref(), &connections);
                for (connection, what) in failures {
                    self.add_event(TimedEvent {
                        at_ms: now_ms(),
                        of: answer.robot.to_string(),
                        kind: "error".to_owned(),
                        robot: peer_of(connection),
                        method: Some(connection.method.clone()),
                        detail: Some(what),
                    });
                }
            }
            Err(error) => record.failure = Some(error.to_string()),
        }
    }

    fn ask_for_topics(&mut self) {
        if !self.app.browsers.show_topics() || !self.asking_topics.is_empty() {
            return;
        }
        let now = Instant::now();
        let of = match (now >= self.ask_topics_at, now >= self.ask_own_topics_at) {
            (true, _) => None,
            (false, true) => Some(self.robot.name().clone()),
            (false, false) => return,
        };
        let robot = self.robot.clone();
        self.asking_topics.spawn(async move {
            let topics = topics::query(&robot, of.as_ref(), None, KEEP).await;
            FoundTopics { of, topics }
        });
    }

    fn on_topics(&mut self, FoundTopics { of, topics }: FoundTopics) {
        let now = Instant::now();
        self.ask_own_topics_at = now + OWN_TOPICS_EVERY;
        if of.is_none() {
            self.ask_topics_at = now + TOPICS_EVERY;
        }
        let found = match topics {
            Ok(found) => found,
            // Without a registry at this robot's router, the others are asked nevertheless.
            Err(_) if of.is_some() => return,
            Err(error) => return self.show_topics(Some(&error.to_string())),
        };
        let before = match of {
            Some(_) => self.topics.clone(),
            None => std::mem::take(&mut self.topics),
        };
        for (robot, mut topics) in found {
            // The router begins to count with this question.
            if topics.window_s == 0.0 {
                self.ask_topics_at = now + COUNTED;
                topics = before.get(&robot).cloned().unwrap_or(topics);
            }
            self.topics.insert(robot, topics);
        }
        if self.topics.values().any(|topics| topics.window_s > 0.0) {
            self.show_topics(None);
        }
    }

    fn ask_for_programs(&mut self) {
        if !self.asking_programs.is_empty() || Instant::now() < self.ask_programs_at {
            return;
        }
        let own = self.robot.name();
        let reachable = |(name, record): &(&Name, &RobotRecord)| record.reachable || *name == own;
        let names: Vec<_> = (self.records.iter().filter(reachable))
            .map(|(name, _)| name.clone())
            .collect();
        let robot = self.robot.clone();
        (self.asking_programs).spawn(async move { programs::query(&robot, names).await });
    }

    fn on_programs(&mut self, found: Vec<programs::Answer>) {
        self.ask_programs_at = Instant::now() + PROGRAMS_EVERY;
        for (name, programs) in found {
            if let (Some(record), Ok(programs)) = (self.records.get_mut(&name), programs) {
                record.programs = Some(programs);
            }
        }
    }

    fn show_topics(&self, problem: Option<&str>) {
        let links = || self.topics.values().flat_map(|topics| &topics.links);
        let slow = self.topics.iter().flat_map(|(robot, topics)| {
            let slow = topics.links.iter().filter(|link| link.is_slow());
            slow.map(move |link| format!("{robot} sends over {}", link.in_words(robot)))
        });
        let rows = self.topics.iter().flat_map(|(robot, topics)| {
            topics.topics.iter().map(move |report| TopicRow {
                robot,
                topic: &report.topic,
                encoding: &report.encoding,
                hz: report.hz,
                bytes_per_s: report.bytes_per_s,
                on_air_per_s: on_air(links(), &format!("{robot}/{}", report.topic)),
                last_bytes: report.last_bytes,
                lost: report.lost,
                is_retained: report.is_retained,
            })
        });
        let state = State::Topics {
            topics: &rows.collect::<Vec<_>>(),
            more: self.topics.values().map(|topics| topics.more).sum(),
            links: &slow.collect::<Vec<_>>(),
            problem,
        };
        self.app.browsers.publish("topics", &state);
    }

    fn show(&mut self) {
        let own = self.robot.name();
        let robots = self.records.iter().map(|(name, record)| RobotState {
            name: name.to_string(),
            reachable: record.reachable || name == own,
            silent_since_ms: record.silent_since_ms,
            connections: shown(record.connections.as_deref()),
            programs: record.programs.as_deref(),
            version: text_of(record.status.as_ref(), "version"),
            started_s: record.started_s,
            problems: problems(record, self.connected || name != own),
        });
        let robots: Vec<_> = robots.collect();
        let connected = self.connected;
        self.app.browsers.publish(
            "fleet",
            &State::Fleet {
                robots: &robots,
                connected,
            },
        );
        // A page that receives nothing for long takes the connection for lost.
        let seconds = now_ms() / 1000;
        let at_s = seconds - seconds % 3;
        self.app.browsers.publish("time", &State::Time { at_s });
        let events = self.events.make_contiguous();
        self.app
            .browsers
            .publish("events", &State::Events { events });
    }
}

fn shown(connections: Option<&[Connection]>) -> Option<Vec<ShownConnection>> {
    let connections = connections?.iter().cloned();
    Some(connections.map(ShownConnection::from).collect())
}

/// Returns the errors that are new in a list of connections.
fn new_failures<'a>(
    before: Option<&[Connection]>,
    now: &'a [Connection],
) -> Vec<(&'a Connection, String)> {
    let Some(before) = before else {
        return Vec::new();
    };
    let what = |connection: &Connection| {
        let error = connection.last_error.as_ref();
        error.map(|error| error.what.clone())
    };
    let failed = now.iter().filter_map(|connection| {
        let error = what(connection)?;
        let same = |old: &&Connection| {
            (&old.name, &old.method, &old.address)
                == (&connection.name, &connection.method, &connection.address)
        };
        let known = before.iter().find(same).and_then(what);
        (known.as_ref() != Some(&error)).then_some((connection, error))
    });
    failed.collect()
}

fn peer_of(connection: &Connection) -> Option<String> {
    connection.peer.as_ref().and_then(|peer| peer.robot.clone())
}

fn text_of(status: Option<&Value>, field: &str) -> Option<String> {
    status?[field].as_str().map(str::to_owned)
}

/// Returns what is wrong with a robot, and what to do.
fn problems(record: &RobotRecord, connected: bool) -> Vec<String> {
    let mut problems = Vec::new();
    if !connected {
        problems.push("The router cannot be reached: is rect-router running?".to_owned());
    }
    if let Some(failure) = &record.failure {
        problems.push(failure.clone());
    }
    let same = record
        .status
        .as_ref()
        .and_then(|status| status["same_name"].as_array());
    if same.is_some_and(|others| !others.is_empty()) {
        problems.push("Another robot has the same name: give one of them another name".to_owned());
    }
    for connection in record.connections.iter().flatten() {
        let name = connection.name.as_deref().unwrap_or(&connection.address);
        if let (ConnectionState::Connecting, Some(error)) =
            (connection.state, &connection.last_error)
        {
            problems.push(format!("{name}: {}", error.what));
        }
    }
    let is_open = |connection: &&Connection| {
        connection.state == ConnectionState::Connected && connection.encrypted == Some(false)
    };
    let connections = record.connections.iter().flatten();
    let peers: BTreeSet<_> = connections
        .filter(is_open)
        .map(|connection| peer_of(connection).unwrap_or_else(|| connection.address.clone()))
        .collect();
    if !peers.is_empty() {
        let peers: Vec<_> = peers.into_iter().collect();
        problems.push(format!(
            "The links with {} are not encrypted: use a secret or TLS",
            peers.join(", ")
        ));
    }
    problems
}

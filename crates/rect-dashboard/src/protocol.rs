//! Defines the messages between the page and this program, on a WebSocket.
//!
//! The page sends [`Command`]s as JSON in text messages. It receives binary messages, whose first byte is their kind: [`STATE`]
//! is followed by a [`State`] in JSON, and [`DATA`] by the length of a [`DataHeader`] (32 bits, little endian), the header in
//! JSON, and the value: JSON, or the bytes of a picture or of a frame of a video.
use std::{collections::BTreeMap, time::SystemTime};

use axum::body::Bytes;
use rect::{Connection, Level, ParameterValue, Phase, Program};
use rect_core::clock::unix::ms_since_1970;
use rect_recording::report::EventReport;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The version of these messages. A page of another version reloads itself.
pub const VERSION: u32 = 8;
/// The kind of a message that contains a [`State`].
pub const STATE: u8 = 1;
/// The kind of a message that contains a value of a topic.
pub const DATA: u8 = 2;
/// The largest command, in bytes.
pub const MAX_COMMAND: usize = 128 * 1024;

/// A command of the page. Each one with an `id` is answered with [`State::Answer`].
#[derive(Debug, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum Command {
    /// Names the lists that the page shows.
    Show {
        /// Whether it shows the topics, which the routers count only while somebody asks for them.
        topics: bool,
        /// Whether it shows the goals of actions, which are received only while somebody shows them.
        #[serde(default)]
        actions: bool,
    },
    /// Receive a topic.
    Watch {
        /// The number of the values in their headers.
        id: u32,
        /// `<robot>/<topic>`.
        topic: String,
        /// Whether to receive frames of a stream.
        stream: bool,
        /// Whether the page decodes video; otherwise it gets pictures.
        #[serde(default)]
        video: bool,
    },
    /// Ask for a key frame of a stream.
    Key {
        /// The number of the `Watch`.
        id: u32,
    },
    /// Receive the lines that programs log, in place of a `Log` before.
    Log {
        /// The number of the lines in their headers.
        id: u32,
        /// The least important level.
        level: Level,
    },
    /// End a `Watch` or a `Log`.
    Unwatch {
        /// The number of the `Watch` or the `Log`.
        id: u32,
    },
    /// Publish a message, or send it to one robot.
    Publish {
        /// The number of the answer.
        id: u32,
        /// The one robot to send it to.
        to: Option<String>,
        /// The topic.
        topic: String,
        /// The value: JSON, or else a text.
        value: String,
        /// Whether the message is urgent.
        urgent: bool,
    },
    /// Send a request to a service.
    Request {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
        /// The service.
        topic: String,
        /// The value: JSON, or else a text.
        value: String,
    },
    /// Add a named connection to a robot's router, or replace it.
    Connect {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
        /// The connection.
        connection: ConnectionForm,
    },
    /// Remove a named connection.
    Disconnect {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
        /// The name of the connection.
        name: String,
    },
    /// Ask the router of a robot what is wrong with its computer and its links.
    Check {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
    },
    /// Set parameters of a program, or reset some, all or none. The answer has the values that are in force.
    SetParameters {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
        /// The group.
        group: String,
        /// The new values.
        set: BTreeMap<String, ParameterValue>,
        /// The parameters that get their defaults.
        reset: Vec<String>,
    },
    /// Start a goal of an action. The answer has its id.
    StartAction {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
        /// The action.
        action: String,
        /// The goal: JSON, or else a text.
        value: String,
    },
    /// Cancel a goal.
    CancelAction {
        /// The number of the answer.
        id: u32,
        /// The robot.
        robot: String,
        /// The action.
        action: String,
        /// The id of the goal.
        goal: String,
    },
    /// Stop the fleet. [`State::Stop`] says how far the robots have followed.
    Stop {
        /// The number of the answer.
        id: u32,
    },
    /// Release all stops of the fleet.
    ReleaseStop {
        /// The number of the answer.
        id: u32,
    },
    /// Start or finish a recording.
    Record {
        /// The number of the answer.
        id: u32,
        /// Whether to record.
        on: bool,
    },
}

/// A named connection, as the page's form has it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ConnectionForm {
    /// The name.
    pub name: String,
    /// The method, such as `ble`.
    pub method: String,
    /// The robot or the host.
    pub address: String,
    /// The port, for methods that have one.
    pub port: Option<u16>,
}

/// A state or an answer for the page.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum State<'a> {
    /// The first message.
    Hello {
        /// [`VERSION`].
        version: u32,
        /// The robot as which the page publishes.
        robot: &'a str,
        /// Its fleet.
        fleet: &'a str,
        /// Whether the page may only look.
        read_only: bool,
        /// Whether the browser has logged in; `None` if there are no logins.
        logged_in: Option<bool>,
        /// Whether recordings can be made.
        record: bool,
    },
    /// The robots of the fleet.
    Fleet {
        /// The robots, in alphabetical order.
        robots: &'a [RobotState<'a>],
        /// Whether this program is connected to its router.
        connected: bool,
    },
    /// The topics of the fleet.
    Topics {
        /// The topics.
        topics: &'a [TopicRow<'a>],
        /// The number of topics that are not listed.
        more: usize,
        /// A description of the use of each slow link.
        links: &'a [String],
        /// Why there are none.
        problem: Option<&'a str>,
    },
    /// Events, the oldest first.
    Events {
        /// The events.
        events: &'a [TimedEvent],
    },
    /// The alerts of all robots.
    Alerts {
        /// The alerts, by robot and name.
        alerts: &'a [&'a AlertState],
    },
    /// The goals of actions, while a page shows them.
    Actions {
        /// The goals, of which the one that has changed last is the first.
        goals: &'a [&'a GoalRow],
    },
    /// The newest feedback of the goals that have not ended, while a page shows them.
    Feedback {
        /// The goals of which there is any.
        goals: &'a [&'a FeedbackRow],
    },
    /// The time, every three seconds.
    Time {
        /// Seconds since 1970, by this computer's clock.
        at_s: u64,
    },
    /// The state of the recording.
    Recording {
        /// The file; `None` if nothing is recorded.
        file: Option<&'a str>,
        /// The messages in it.
        messages: u64,
        /// Their bytes.
        bytes: u64,
        /// The messages that were dropped.
        dropped: u64,
        /// Why the disk takes nothing at the moment.
        problem: Option<&'a str>,
    },
    /// The stop of the fleet, until it is released.
    Stop {
        /// `None` if the fleet is not stopped.
        stop: Option<StopState>,
    },
    /// The number of values that this page has not received because it was too slow.
    Dropped {
        /// The number since the page was opened.
        count: u64,
    },
    /// The answer to a command.
    Answer {
        /// The number of the command.
        id: u32,
        /// The result, if there was no error.
        value: Option<Value>,
        /// The error, with advice.
        error: Option<&'a str>,
    },
}

/// A stop of the fleet, and how far the robots have followed.
#[derive(Clone, Debug, Serialize)]
pub struct StopState {
    /// The stops that nobody has released, the latest first.
    pub pressed: Vec<PressedStop>,
    /// Whether the router of this computer has them.
    pub is_sent: bool,
    /// Why the router does not have the stop, or another problem.
    pub problem: Option<String>,
    /// The other robots, in alphabetical order.
    pub robots: Vec<StoppedRobot>,
}

/// A stop that nobody has released.
#[derive(Clone, Debug, Serialize)]
pub struct PressedStop {
    /// The program that pressed it: `<robot>/<program>`.
    pub by: String,
    /// Why, in that program's words.
    pub reason: String,
    /// When, in milliseconds since 1970 by the clock of that robot.
    pub at_ms: u64,
}

/// How far a robot has followed a stop.
#[derive(Clone, Debug, Serialize)]
pub struct StoppedRobot {
    /// The robot.
    pub robot: String,
    /// `confirmed`, `waiting`, `silent`, `ended`, `no_part`, or `unreachable`.
    pub outcome: &'static str,
    /// How long the confirmation took, in milliseconds, if the stop was pressed at this dashboard.
    pub ms: Option<f64>,
}

/// An alert of a robot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlertState {
    /// The robot.
    pub robot: String,
    /// The topic, which identifies it.
    pub name: String,
    /// The text for people.
    pub text: String,
    /// How important it is.
    pub level: Level,
    /// Since when, in milliseconds since 1970 by this computer's clock.
    pub since_ms: u64,
    /// The program that has raised it; empty if it has no name.
    pub program: String,
    /// Whether that program has ended.
    pub has_ended: bool,
}

/// A goal of an action.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GoalRow {
    /// The robot that carries it out.
    pub robot: String,
    /// The action.
    pub action: String,
    /// The id.
    pub id: String,
    /// How far it has come.
    pub phase: Phase,
    /// Why it has ended, or is asked to; empty if that is clear.
    pub reason: String,
    /// The goal as JSON; `None` if it is null or long.
    pub goal: Option<String>,
    /// The result as JSON.
    pub result: Option<String>,
    /// The client, which has started it: `<robot>/<program>`.
    pub by: String,
    /// The program that carries it out; empty if it has no name.
    pub program: String,
    /// Since when it is in this phase, in milliseconds since 1970 by this computer's clock.
    pub since_ms: u64,
}

/// The newest feedback of a goal.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FeedbackRow {
    /// The robot that carries it out.
    pub robot: String,
    /// The action.
    pub action: String,
    /// The id of the goal.
    pub id: String,
    /// How much is done, from 0 to 1.
    pub progress: Option<f64>,
    /// The value as JSON.
    pub value: Option<String>,
}

/// A topic, as the router of its robot has counted it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TopicRow<'a> {
    /// The robot.
    pub robot: &'a str,
    /// The topic.
    pub topic: &'a str,
    /// The encoding of the last message.
    pub encoding: &'a str,
    /// Messages per second.
    pub hz: f64,
    /// Payload bytes per second.
    pub bytes_per_s: u64,
    /// Bytes per second that the slow links of all robots have sent for the topic, with everything that is added.
    pub on_air_per_s: u64,
    /// The size of the last payload in bytes.
    pub last_bytes: u64,
    /// Messages that did not reach the robot's own router.
    pub lost: u64,
    /// Whether the robot's router keeps the last value.
    pub is_retained: bool,
}

/// A connection, and what the page shows of its lanes.
#[derive(Clone, Debug, Serialize)]
pub struct ShownConnection {
    /// The connection, as the registry reports it.
    #[serde(flatten)]
    pub connection: Connection,
    /// How long an urgent message takes until the peer has acknowledged it, in milliseconds, if it was measured.
    pub urgent_delay_ms: Option<f64>,
}

impl From<Connection> for ShownConnection {
    fn from(connection: Connection) -> Self {
        Self {
            urgent_delay_ms: connection.urgent_delay_ms(),
            connection,
        }
    }
}

/// A robot of the fleet, as the page shows it.
#[derive(Clone, Debug, Serialize)]
pub struct RobotState<'a> {
    /// Its name.
    pub name: String,
    /// Whether it can be reached.
    pub reachable: bool,
    /// Since when it is not, in milliseconds since 1970 by this computer's clock, if that was noticed.
    pub silent_since_ms: Option<u64>,
    /// The connections of its router; `None` until it has answered, and if it has no registry.
    pub connections: Option<Vec<ShownConnection>>,
    /// Its programs with their services; `None` until its router has told them, and if it keeps no catalogue.
    pub programs: Option<&'a [Program]>,
    /// The version of its router.
    pub version: Option<String>,
    /// When its router was started, in seconds since 1970 by this computer's clock.
    pub started_s: Option<u64>,
    /// The problems, with advice.
    pub problems: Vec<String>,
}

/// An event with its time.
#[derive(Clone, Debug, Serialize)]
pub struct TimedEvent {
    /// Milliseconds since 1970, by this computer's clock.
    pub at_ms: u64,
    /// The robot that reports it.
    pub of: String,
    /// A kind of [`EventReport`], or `error`.
    pub kind: String,
    /// The other robot.
    pub robot: Option<String>,
    /// The method of the link.
    pub method: Option<String>,
    /// The text of an error, or the path and the reason of a switch.
    pub detail: Option<String>,
}

impl TimedEvent {
    /// Returns an event that `of` has reported.
    pub fn new(at_ms: u64, of: &str, event: &EventReport<'_>) -> Self {
        let owned = |text: Option<&str>| text.map(str::to_owned);
        let switch = event.path.zip(event.reason);
        Self {
            at_ms,
            of: of.to_owned(),
            kind: event.kind.to_owned(),
            robot: owned(event.robot),
            method: owned(event.method),
            detail: switch.map(|(path, reason)| format!("{path} ({reason})")),
        }
    }
}

/// The description of a value.
#[derive(Clone, Debug, Default, Serialize)]
pub struct DataHeader<'a> {
    /// The number of the `Watch`.
    pub id: u32,
    /// `json`, `picture`, or `video`.
    pub form: &'a str,
    /// When it arrived, in milliseconds since 1970 by this computer's clock.
    pub at_ms: f64,
    /// When it was sent, by the sender's clock.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sent_ms: Option<u64>,
    /// The age of a stream's frame on arrival.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub age_ms: Option<u64>,
    /// The number of the frame of a video.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub number: Option<u32>,
    /// Whether it is a key frame of a video.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub key: bool,
    /// The size of the message in bytes.
    pub bytes: usize,
    /// The encoding of the message.
    pub encoding: &'a str,
    /// Messages that were lost before this one, or frames that were skipped.
    #[serde(skip_serializing_if = "is_zero")]
    pub missed: u32,
    /// Whether the message was sent as urgent.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub urgent: bool,
    /// Whether the message repeats one of a recording.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub replayed: bool,
    /// Whether it is retained, and the program that published it has ended.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub ended: bool,
    /// The method by which it arrived.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<&'a str>,
    /// Why the value is not shown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<&'a str>,
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(number: &u32) -> bool {
    *number == 0
}

/// Returns the message that contains a state.
pub fn state(state: &State<'_>) -> Bytes {
    let mut message = vec![STATE];
    // These types can be written.
    let written = serde_json::to_writer(&mut message, state);
    debug_assert!(written.is_ok());
    message.into()
}

/// Returns the message that contains a value.
pub fn data(header: &DataHeader<'_>, value: &[u8]) -> Bytes {
    let header = serde_json::to_vec(header).unwrap_or_default();
    let mut message = Vec::with_capacity(5 + header.len() + value.len());
    message.push(DATA);
    let length = u32::try_from(header.len()).unwrap_or_default();
    message.extend_from_slice(&length.to_le_bytes());
    message.extend_from_slice(&header);
    message.extend_from_slice(value);
    message.into()
}

/// Returns the time by this computer's clock, in milliseconds since 1970.
pub fn now_ms() -> u64 {
    ms_since_1970(SystemTime::now())
}

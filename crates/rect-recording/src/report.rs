//! Decides what a recording contains besides messages: events, the state of the links, and the requests to services.
use std::time::Duration;

use rect_core::{
    codec::Limits,
    message::payload::Payload,
    name::{key::KeySpace, Name},
    registry::connection::{Connection, ConnectionState, Event, Link},
    session::service::Requester,
};
use serde::Serialize;
use serde_json::Value;

use crate::recorder::Recorder;

/// The subject of events.
pub const EVENTS: &str = "events";
/// The first part of the subjects of links. The second one is the robot at the other end.
pub const LINK: &str = "link";
/// The subject of requests.
pub const REQUESTS: &str = "requests";
/// The size of the values that are part of the report of a request, at most.
const MAX_VALUE_BYTES: usize = 4096;
/// The interval at which the state of the links is recorded.
pub const LINKS_EVERY: Duration = Duration::from_secs(1);

/// The form of an event in a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct EventReport<'a> {
    /// `peer_up`, `peer_down`, `program_up`, `program_down`, `link_up`, `link_down`, `link_silent`, `link_resumed`, `path_switched`, `router_up` or `router_down`.
    pub kind: &'a str,
    /// The other robot.
    pub robot: Option<&'a str>,
    /// The method of the link.
    pub method: Option<&'a str>,
    /// The address of the peer of the link.
    pub address: Option<&'a str>,
    /// The method of the path that carries the bulk now.
    pub path: Option<&'a str>,
    /// Why that path has changed.
    pub reason: Option<&'a str>,
    /// The program.
    pub program: Option<&'a str>,
}

/// The form of a request in a recording.
#[derive(Debug, Serialize)]
struct RequestReport<'a> {
    /// The robot that asked; `None` if a stock Zenoh program did.
    sender: Option<&'a str>,
    /// The topic of the service.
    topic: &'a str,
    /// The value; `None` if it is larger than 4 kB, or bytes of unknown meaning.
    value: Option<Value>,
    encoding: &'a str,
    /// The size of the payload.
    bytes: usize,
}

impl<'a> EventReport<'a> {
    /// Returns the fields in their order, without the empty ones at the end.
    pub fn fields(&self) -> Vec<Option<&'a str>> {
        let mut fields = vec![
            Some(self.kind),
            self.robot,
            self.method,
            self.address,
            self.path,
            self.reason,
            self.program,
        ];
        while fields.last().is_some_and(Option::is_none) {
            fields.pop();
        }
        fields
    }

    fn of_link(kind: &'a str, link: &'a Link) -> Self {
        Self {
            kind,
            robot: link.robot.as_ref().map(Name::as_str),
            method: Some(&link.method),
            address: Some(&link.address),
            ..Self::default()
        }
    }

    fn of_peer(kind: &'a str, robot: &'a Name) -> Self {
        Self {
            kind,
            robot: Some(robot.as_str()),
            ..Self::default()
        }
    }
}

impl<'a> From<&'a Event> for EventReport<'a> {
    fn from(event: &'a Event) -> Self {
        let of_router = |kind| Self {
            kind,
            ..Self::default()
        };
        match event {
            Event::PeerUp { robot } => Self::of_peer("peer_up", robot),
            Event::PeerDown { robot } => Self::of_peer("peer_down", robot),
            Event::ProgramUp { robot, program } => Self {
                program: Some(program.as_str()),
                ..Self::of_peer("program_up", robot)
            },
            Event::ProgramDown { robot, program } => Self {
                program: Some(program.as_str()),
                ..Self::of_peer("program_down", robot)
            },
            Event::LinkUp(link) => Self::of_link("link_up", link),
            Event::LinkDown(link) => Self::of_link("link_down", link),
            Event::LinkSilent(link) => Self::of_link("link_silent", link),
            Event::LinkResumed(link) => Self::of_link("link_resumed", link),
            Event::PathSwitched { link, path, reason } => Self {
                path: Some(path),
                reason: Some(reason.as_str()),
                ..Self::of_link("path_switched", link)
            },
            Event::RouterUp => of_router("router_up"),
            Event::RouterDown => of_router("router_down"),
        }
    }
}

impl Recorder {
    /// Records an event that a program of `robot` has received.
    pub fn on_event(&self, robot: &Name, event: EventReport<'_>) {
        self.report(robot, EVENTS, &event);
    }

    /// Records the state of the links of `robot`, of which its router reports these connections.
    pub fn on_connections(&self, robot: &Name, connections: &[Connection]) {
        for connection in connections {
            let peer = connection
                .peer
                .as_ref()
                .and_then(|peer| peer.robot.as_ref());
            if let (ConnectionState::Connected, Some(peer)) = (connection.state, peer) {
                self.report(robot, &format!("{LINK}/{peer}"), connection);
            }
        }
    }

    /// Records a request to the service with this key, which is one of the robot of `place`. A query that is not a request is not
    /// recorded.
    pub fn on_request(
        &self,
        place: &KeySpace,
        key: &str,
        attachment: Option<&[u8]>,
        payload: &Payload,
    ) {
        let Some(requester) = Requester::of(key, attachment) else {
            return;
        };
        let is_short = payload.bytes.len() <= MAX_VALUE_BYTES;
        let limits = Limits {
            max_bytes: MAX_VALUE_BYTES,
            ..Limits::default()
        };
        let report = RequestReport {
            sender: requester.robot().map(Name::as_str),
            topic: key.splitn(3, '/').nth(2).unwrap_or(key),
            value: is_short.then(|| payload.to_json(&limits)).flatten(),
            encoding: payload.encoding.as_str(),
            bytes: payload.bytes.len(),
        };
        self.report(&place.robot, REQUESTS, &report);
    }

    fn report(&self, robot: &Name, subject: &str, value: &impl Serialize) {
        // These types can be written.
        if let Ok(json) = serde_json::to_vec(value) {
            self.on_report(robot, subject, json);
        }
    }
}

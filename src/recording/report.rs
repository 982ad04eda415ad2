//! Decides what a recording contains besides messages: events, and the state of the links.
use serde::Serialize;

use super::recorder::Recorder;
use crate::core::{
    connection::{Connection, ConnectionState, Event},
    name::Name,
};

/// The subject of events.
pub const EVENTS: &str = "events";
/// The first part of the subjects of links. The second one is the robot at the other end.
pub const LINK: &str = "link";

impl Recorder {
    /// Records an event that a program of `robot` has received.
    pub fn on_event(&self, robot: &Name, event: &Event) {
        self.report(robot, EVENTS, event);
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

    fn report(&self, robot: &Name, subject: &str, value: &impl Serialize) {
        // These types can be written.
        if let Ok(json) = serde_json::to_vec(value) {
            self.on_report(robot, subject, json);
        }
    }
}

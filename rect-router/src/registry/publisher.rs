//! Publishes all connections, under the key that answers for them, whenever a connection is added, removed or changes its
//! state or peer, falls silent, or receives again. Changes of signal strength and traffic are not published; queries return them.
use std::{
    collections::BTreeSet,
    sync::mpsc::{Receiver, RecvTimeoutError},
    time::{Duration, Instant},
};

use rect_core::registry::connection::{Connection, ConnectionState as State};
use zenoh::{bytes::Encoding, Wait};

use super::{presence::NameConflictEvent, sockets::Sockets, Sources};

/// Time within which several changes are published as one.
const COALESCE_WINDOW: Duration = Duration::from_millis(50);
/// Interval at which discovered robots and the names of peers are compared with the last publication, as nothing reports
/// their changes: a robot's advertisements are received ten times a second and simply stop when it leaves, and the name of a
/// peer becomes known a moment after its link. At most one publication per interval results from such changes.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// Maximum time for which the publication of a new link to a router is delayed until the name of its robot is known.
const NAME_TIMEOUT: Duration = Duration::from_secs(1);

/// A change that may have to be published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// A link was opened or closed, or the named connections changed.
    Links,
    /// A robot appeared or disappeared. It is published only if a link leads to that robot.
    Robots,
}

/// Publishes changes until all senders of `changes` are dropped.
pub fn publish(sources: &Sources, key: &str, changes: &Receiver<Change>) {
    let mut published = PublishedPeers::default();
    loop {
        let is_changed = match changes.recv_timeout(POLL_INTERVAL) {
            Ok(first) => gather(first, changes),
            Err(RecvTimeoutError::Timeout) => Ok(false),
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let Ok(is_changed) = is_changed else { return };
        report_name_conflicts(sources);
        if is_changed && wait_for_names(sources, changes).is_err() {
            return;
        }
        let peers_changed = published.update(&sources.connections(&Sockets::disabled()));
        if !is_changed && !peers_changed {
            continue;
        }
        let connections = sources.connections(&Sockets::open());
        let Ok(json) = serde_json::to_vec(&connections) else {
            continue;
        };
        let put = sources.session.put(key, json);
        if let Err(error) = put.encoding(Encoding::APPLICATION_JSON).wait() {
            tracing::debug!("cannot publish the connections: {error}");
        }
    }
}

/// Collects the changes that follow within [`COALESCE_WINDOW`], and returns whether any concerns links.
///
/// # Errors
/// Fails if all senders are dropped.
fn gather(first: Change, changes: &Receiver<Change>) -> Result<bool, RecvTimeoutError> {
    let mut is_of_links = first == Change::Links;
    loop {
        match changes.recv_timeout(COALESCE_WINDOW) {
            Ok(change) => is_of_links |= change == Change::Links,
            Err(RecvTimeoutError::Timeout) => return Ok(is_of_links),
            Err(ended) => return Err(ended),
        }
    }
}

/// Waits until the robot of each new link to a router is known, at most [`NAME_TIMEOUT`]: its token arrives over that link a
/// moment after it is opened.
///
/// # Errors
/// Fails if all senders are dropped.
fn wait_for_names(sources: &Sources, changes: &Receiver<Change>) -> Result<(), RecvTimeoutError> {
    let deadline = Instant::now() + NAME_TIMEOUT;
    while sources.awaits_names(NAME_TIMEOUT) {
        match changes.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(_) => {}
            Err(RecvTimeoutError::Timeout) => break,
            Err(ended) => return Err(ended),
        }
    }
    Ok(())
}

/// Logs that another robot has this robot's name. Neither is disconnected: it cannot be decided which of them should keep
/// the name, and over TCP a link has no name by which it could be rejected.
fn report_name_conflicts(sources: &Sources) {
    for event in sources.presence.name_conflict_events() {
        match event {
            NameConflictEvent::Found(id) => {
                let place = match sources.link_to(&id) {
                    Some(link) => format!("at {link}"),
                    None => "behind another robot".to_owned(),
                };
                tracing::error!(
                    "another router of this fleet has this robot's name: {id}, {place}. Other robots cannot distinguish the \
                     messages and replies of the two; give one of them another name (`robot` in plugins/rect, or \
                     rect-router init)"
                );
            }
            NameConflictEvent::Resolved(id) => {
                tracing::info!("the router {id} with this robot's name has disappeared");
            }
        }
    }
}

/// The peers of the last publication: discovered robots by address, and the robots of links by the router's identifier, with whether
/// the link is silent.
#[derive(Default)]
struct PublishedPeers(BTreeSet<(String, Option<String>, bool)>);

impl PublishedPeers {
    /// Replaces the peers by those of `connections`, and returns whether they differ.
    fn update(&mut self, connections: &[Connection]) -> bool {
        let peer = |connection: &Connection| match (connection.state, &connection.peer) {
            (State::Discovered, _) => Some((connection.address.clone(), None, false)),
            (_, Some(peer)) => {
                let is_silent = connection.silent_s.is_some();
                let is_known = peer.robot.is_some() || is_silent;
                is_known.then(|| (peer.id.clone(), peer.robot.clone(), is_silent))
            }
            (_, None) => None,
        };
        let now = connections.iter().filter_map(peer).collect();
        std::mem::replace(&mut self.0, now) != self.0
    }
}

#[cfg(test)]
mod tests {
    use rect_core::registry::connection::PeerId;
    use zenoh_link_ble::BLE_LOCATOR_PREFIX as BLE;

    use super::*;

    fn discovered(robot: &str, rssi_dbm: i16) -> Connection {
        Connection {
            rssi_dbm: Some(rssi_dbm),
            ..Connection::of(BLE, robot, State::Discovered)
        }
    }

    #[test]
    fn discovered_robots_are_a_change_and_their_signal_strength_is_not() {
        let mut published = PublishedPeers::default();
        let linked = Connection::of(BLE, "wombat-9", State::Connected);
        assert!(
            !published.update(std::slice::from_ref(&linked)),
            "no robot is discovered"
        );
        assert!(published.update(&[linked, discovered("wombat-2", -60)]));
        assert!(!published.update(&[discovered("wombat-2", -80)]));
        assert!(published.update(&[discovered("wombat-2", -80), discovered("wombat-3", -70)]));
        assert!(!published.update(&[discovered("wombat-3", -60), discovered("wombat-2", -60)]));
        assert!(published.update(&[discovered("wombat-3", -60)]));
        assert!(published.update(&[]), "the last robot has left");
        assert!(!published.update(&[]));
    }

    #[test]
    fn the_name_of_a_peer_is_a_change_once_it_is_known() {
        let to = |robot: Option<&str>| {
            let (id, robot) = ("a1".to_owned(), robot.map(str::to_owned));
            Connection {
                peer: Some(PeerId { id, robot }),
                ..Connection::of(BLE, "wombat-2", State::Connected)
            }
        };
        let mut published = PublishedPeers::default();
        assert!(
            !published.update(&[to(None)]),
            "the new link itself is reported elsewhere"
        );
        assert!(published.update(&[to(Some("wombat-2"))]));
        assert!(!published.update(&[to(Some("wombat-2"))]));
    }
}

//! Owns what is published, and when: all connections, under the key that answers for them, after each change of which there
//! are. How strong somebody's signal is, and how much was carried, is for whoever asks.
use std::{
    collections::BTreeSet,
    sync::mpsc::{Receiver, RecvTimeoutError},
    time::{Duration, Instant},
};

use rect::core::connection::{Connection, ConnectionState as State};
use zenoh::{bytes::Encoding, Wait};

use super::{presence::News, sockets::Sockets, Sources};

/// Several changes within so long are published as one.
const TOGETHER: Duration = Duration::from_millis(50);
/// How often to look who is heard, and whose the identifiers at the other ends are. Nobody tells: a robot in the air is heard
/// ten times a second, and one that has gone never again; and which robot a new link leads to is known a moment after the
/// link. So a hall where robots come and go costs one publication in so long.
const LOOK: Duration = Duration::from_secs(1);

/// How long a link to a router waits for the name of its robot before it is published without one.
const NAMING: Duration = Duration::from_secs(1);

/// A document that may have to be published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// A link, or a connection that is wanted, comes or goes.
    Links,
    /// Robots come or go. It matters only if a link leads to one.
    Robots,
}

/// Publishes until nobody can tell of a change any more.
pub fn publish(sources: &Sources, key: &str, changes: &Receiver<Change>) {
    let mut told = Others::default();
    loop {
        let is_changed = match changes.recv_timeout(LOOK) {
            Ok(first) => gather(first, changes),
            Err(RecvTimeoutError::Timeout) => Ok(false),
            Err(RecvTimeoutError::Disconnected) => return,
        };
        let Ok(is_changed) = is_changed else { return };
        report_namesakes(sources);
        if is_changed && wait_for_names(sources, changes).is_err() {
            return;
        }
        let are_others = told.are_now(&sources.connections(&Sockets::unasked()));
        if !is_changed && !are_others {
            continue;
        }
        let connections = sources.connections(&Sockets::open());
        let Ok(json) = serde_json::to_vec(&connections) else {
            continue;
        };
        let put = sources.session.put(key, json);
        if let Err(error) = put.encoding(Encoding::APPLICATION_JSON).wait() {
            tracing::debug!("the change of connections was not published: {error}");
        }
    }
}

/// Waits for what follows a change at once, and tells whether any of it concerns links; an error: nobody can tell of one any
/// more.
fn gather(first: Change, changes: &Receiver<Change>) -> Result<bool, RecvTimeoutError> {
    let mut is_of_links = first == Change::Links;
    loop {
        match changes.recv_timeout(TOGETHER) {
            Ok(change) => is_of_links |= change == Change::Links,
            Err(RecvTimeoutError::Timeout) => return Ok(is_of_links),
            Err(ended) => return Err(ended),
        }
    }
}

/// Waits while a new link to a router has no name yet: the robot says who it is over that link, a moment later.
fn wait_for_names(sources: &Sources, changes: &Receiver<Change>) -> Result<(), RecvTimeoutError> {
    let deadline = Instant::now() + NAMING;
    while sources.awaits_names(NAMING) {
        match changes.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(_) => {}
            Err(RecvTimeoutError::Timeout) => break,
            Err(ended) => return Err(ended),
        }
    }
    Ok(())
}

/// Logs that another robot has this one's name. Neither is cut off: nobody can tell which of them is in the right, and
/// over TCP a link has no name that could be refused.
fn report_namesakes(sources: &Sources) {
    for news in sources.presence.news_of_namesakes() {
        match news {
            News::Found(id) => {
                let way = match sources.way_to(&id) {
                    Some(link) => format!("at {link}"),
                    None => "behind another robot".to_owned(),
                };
                tracing::error!(
                    "another router of this fleet has this robot's name: {id}, {way}. Messages and answers of the two get \
                     mixed up; give one of them another name (`robot` in plugins/rect, or rect-router init)"
                );
            }
            News::Gone(id) => tracing::info!("the router {id} with this robot's name is gone"),
        }
    }
}

/// Whom the last publication told of: who is heard and not linked, by address, and the robots at the other ends, by id.
#[derive(Default)]
struct Others(BTreeSet<(String, Option<String>)>);

impl Others {
    /// Takes in who is there now; tells whether they are others.
    fn are_now(&mut self, connections: &[Connection]) -> bool {
        let who = |one: &Connection| match (one.state, &one.peer) {
            (State::Discovered, _) => Some((one.address.clone(), None)),
            (_, Some(peer)) => Some((peer.id.clone(), Some(peer.robot.clone()?))),
            (_, None) => None,
        };
        let now = connections.iter().filter_map(who).collect();
        std::mem::replace(&mut self.0, now) != self.0
    }
}

#[cfg(test)]
mod tests {
    use rect::core::connection::PeerId;
    use zenoh_link::ble::BLE_LOCATOR_PREFIX as BLE;

    use super::*;

    fn heard(robot: &str, rssi_dbm: i16) -> Connection {
        Connection {
            rssi_dbm: Some(rssi_dbm),
            ..Connection::of(BLE, robot, State::Discovered)
        }
    }

    #[test]
    fn who_comes_or_goes_is_a_change_and_a_stronger_signal_is_none() {
        let mut told = Others::default();
        let linked = Connection::of(BLE, "wombat-9", State::Connected);
        assert!(
            !told.are_now(std::slice::from_ref(&linked)),
            "nobody is discovered"
        );
        assert!(told.are_now(&[linked, heard("wombat-2", -60)]));
        assert!(!told.are_now(&[heard("wombat-2", -80)]));
        assert!(told.are_now(&[heard("wombat-2", -80), heard("wombat-3", -70)]));
        assert!(!told.are_now(&[heard("wombat-3", -60), heard("wombat-2", -60)]));
        assert!(told.are_now(&[heard("wombat-3", -60)]));
        assert!(told.are_now(&[]), "the last has gone");
        assert!(!told.are_now(&[]));
    }

    #[test]
    fn whom_a_link_leads_to_is_a_change_once_it_is_known() {
        let to = |robot: Option<&str>| {
            let (id, robot) = ("a1".to_owned(), robot.map(str::to_owned));
            Connection {
                peer: Some(PeerId { id, robot }),
                ..Connection::of(BLE, "wombat-2", State::Connected)
            }
        };
        let mut told = Others::default();
        assert!(
            !told.are_now(&[to(None)]),
            "the link itself is told by others"
        );
        assert!(told.are_now(&[to(Some("wombat-2"))]));
        assert!(!told.are_now(&[to(Some("wombat-2"))]));
    }
}

//! Limits the sessions of one login, by watching the sessions that Zenoh opens.

use std::{any::Any, collections::HashMap, sync::Arc, time::Duration, time::Instant};

use parking_lot::Mutex;
use zenoh::{internal::runtime::ZRuntime, Result as ZResult};
use zenoh_link::{ble::BLE_LOCATOR_PREFIX, Link};
use zenoh_protocol::network::NetworkMessageMut;
use zenoh_transport::{
    multicast::TransportMulticast, unicast::TransportUnicast, TransportEventHandler,
    TransportMulticastEventHandler, TransportPeer, TransportPeerEventHandler,
};

/// How often a refused session is logged at most: a program connects again at once.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// Closes sessions that are one too many of their user. Links over Bluetooth do not count: all robots of a fleet log in as
/// the same user, and the radio bounds their number.
pub struct LoginLimit {
    most: usize,
    sessions: Arc<Mutex<HashMap<String, usize>>>,
    logged: Mutex<Option<Instant>>,
}

impl LoginLimit {
    /// Allows `most` sessions for each user.
    pub(super) fn new(most: usize) -> Self {
        Self {
            most,
            sessions: Arc::default(),
            logged: Mutex::new(None),
        }
    }

    /// Counts one more session of that user, or returns `None` if there are as many as there may be.
    fn take(&self, user: &str) -> Option<Counted> {
        let mut sessions = self.sessions.lock();
        let count = sessions.entry(user.to_owned()).or_insert(0);
        if *count >= self.most {
            return None;
        }
        *count += 1;
        Some(Counted {
            user: user.to_owned(),
            sessions: Arc::clone(&self.sessions),
        })
    }

    fn log(&self, user: &str) {
        let mut logged = self.logged.lock();
        if logged.is_some_and(|last| last.elapsed() < LOG_PERIOD) {
            return;
        }
        *logged = Some(Instant::now());
        let most = self.most;
        tracing::warn!(
            "closed a session of user {user}, who has all {most} sessions that one login may have (config/README.md, \"How \
             many may connect\")"
        );
    }
}

impl TransportEventHandler for LoginLimit {
    fn new_unicast(
        &self,
        peer: TransportPeer,
        transport: TransportUnicast,
    ) -> ZResult<Arc<dyn TransportPeerEventHandler>> {
        let is_by_radio = |link: &Link| link.src.protocol().as_str() == BLE_LOCATOR_PREFIX;
        let identity = transport.get_auth_ids()?;
        let user = identity.username();
        let Some(user) = user.filter(|_| !peer.links.iter().any(is_by_radio)) else {
            return Ok(Arc::new(Watched { _counted: None }));
        };
        let counted = self.take(user);
        if counted.is_none() {
            self.log(user);
            // Zenoh holds the session until it is open, and does not ask this handler whether it may be.
            ZRuntime::Net.spawn(async move { transport.close().await });
        }
        Ok(Arc::new(Watched { _counted: counted }))
    }

    fn new_multicast(
        &self,
        _transport: TransportMulticast,
    ) -> ZResult<Arc<dyn TransportMulticastEventHandler>> {
        Err("groups have no logins".into())
    }
}

/// One session of a user; dropping it counts one less.
struct Counted {
    user: String,
    sessions: Arc<Mutex<HashMap<String, usize>>>,
}

impl Drop for Counted {
    fn drop(&mut self) {
        let mut sessions = self.sessions.lock();
        if let Some(count) = sessions.get_mut(&self.user) {
            *count -= 1;
            if *count == 0 {
                sessions.remove(&self.user);
            }
        }
    }
}

/// What Zenoh keeps as long as a session is open.
struct Watched {
    _counted: Option<Counted>,
}

impl TransportPeerEventHandler for Watched {
    fn handle_message(&self, _message: NetworkMessageMut) -> ZResult<()> {
        Ok(())
    }

    fn new_link(&self, _link: Link) {}

    fn del_link(&self, _link: Link) {}

    fn closed(&self) {}

    fn as_any(&self) -> &dyn Any {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_login_gives_its_sessions_back() {
        let limit = LoginLimit::new(2);
        let held = [limit.take("fleet"), limit.take("fleet")];
        assert!(held.iter().all(Option::is_some));
        assert!(limit.take("fleet").is_none());
        assert!(limit.take("config").is_some(), "another user");
        drop(held);
        assert!(limit.take("fleet").is_some());
    }
}

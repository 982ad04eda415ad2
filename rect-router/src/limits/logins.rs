//! Limits the sessions of one login by observing the sessions that Zenoh opens.

use std::{any::Any, collections::HashMap, sync::Arc, time::Duration, time::Instant};

use parking_lot::Mutex;
use zenoh::{internal::runtime::ZRuntime, Result as ZResult};
use zenoh_link_any::locator::has_radio;
use zenoh_link_table::Link;
use zenoh_protocol::network::NetworkMessageMut;
use zenoh_transport::{
    multicast::TransportMulticast, unicast::TransportUnicast, TransportEventHandler,
    TransportMulticastEventHandler, TransportPeer, TransportPeerEventHandler,
};

/// Minimum time between log lines about refused sessions: a refused program reconnects at once.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// Closes sessions above the limit of their user. Sessions over Bluetooth do not count: all robots of a fleet log in as the
/// same user, and the radio bounds their number.
pub struct LoginLimit {
    max_sessions: usize,
    sessions: Arc<Mutex<HashMap<String, usize>>>,
    logged: Mutex<Option<Instant>>,
}

impl LoginLimit {
    /// Allows `max_sessions` sessions for each user.
    pub(super) fn new(max_sessions: usize) -> Self {
        Self {
            max_sessions,
            sessions: Arc::default(),
            logged: Mutex::new(None),
        }
    }

    /// Counts one more session of `user`. Returns `None` if the user has reached the limit.
    fn take(&self, user: &str) -> Option<SessionPermit> {
        let mut sessions = self.sessions.lock();
        let count = sessions.entry(user.to_owned()).or_insert(0);
        if *count >= self.max_sessions {
            return None;
        }
        *count += 1;
        Some(SessionPermit {
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
        let max_sessions = self.max_sessions;
        tracing::warn!(
            "closed a session of user {user}, who already has all {max_sessions} sessions that one login may have; close another \
             program or raise plugins/rect/sessions/per_user (docs/reference/configuration.md, \"How many may connect\")"
        );
    }
}

impl TransportEventHandler for LoginLimit {
    fn new_unicast(
        &self,
        peer: TransportPeer,
        transport: TransportUnicast,
    ) -> ZResult<Arc<dyn TransportPeerEventHandler>> {
        let is_by_radio = |link: &Link| has_radio(link.src.protocol().as_str());
        let identity = transport.get_auth_ids()?;
        let user = identity.username();
        let Some(user) = user.filter(|_| !peer.links.iter().any(is_by_radio)) else {
            return Ok(Arc::new(SessionHandler { _permit: None }));
        };
        let permit = self.take(user);
        if permit.is_none() {
            self.log(user);
            // Zenoh opens the session in any case: this handler cannot reject it, only close it afterwards.
            ZRuntime::Net.spawn(async move { transport.close().await });
        }
        Ok(Arc::new(SessionHandler { _permit: permit }))
    }

    fn new_multicast(
        &self,
        _transport: TransportMulticast,
    ) -> ZResult<Arc<dyn TransportMulticastEventHandler>> {
        Err("multicast groups have no logins".into())
    }
}

/// One counted session of a user; dropping it decrements the count.
struct SessionPermit {
    user: String,
    sessions: Arc<Mutex<HashMap<String, usize>>>,
}

impl Drop for SessionPermit {
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

/// The handler that Zenoh keeps while a session is open, with the permit of the session.
struct SessionHandler {
    _permit: Option<SessionPermit>,
}

impl TransportPeerEventHandler for SessionHandler {
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
    fn closed_sessions_no_longer_count() {
        let limit = LoginLimit::new(2);
        let held = [limit.take("fleet"), limit.take("fleet")];
        assert!(held.iter().all(Option::is_some));
        assert!(limit.take("fleet").is_none());
        assert!(limit.take("config").is_some(), "another user");
        drop(held);
        assert!(limit.take("fleet").is_some());
    }
}

//! Reports the sessions that Zenoh opens, closes and releases to the rule by which links succeed each other.

use std::{any::Any, sync::Arc};

use zenoh::Result as ZResult;
use zenoh_link_table::{
    succession::{wait_for_writers, Session, ZenohNode, ZenohPair},
    Link,
};
use zenoh_protocol::network::NetworkMessageMut;
use zenoh_transport::{
    multicast::TransportMulticast, unicast::TransportUnicast, TransportEventHandler,
    TransportMulticastEventHandler, TransportPeer, TransportPeerEventHandler,
};

/// Reports the sessions of one Zenoh runtime.
pub struct SessionReports {
    own: ZenohNode,
}

impl SessionReports {
    /// Reports the sessions of that node.
    pub fn of(own: ZenohNode) -> Self {
        Self { own }
    }
}

impl TransportEventHandler for SessionReports {
    fn new_unicast(
        &self,
        peer: TransportPeer,
        _transport: TransportUnicast,
    ) -> ZResult<Arc<dyn TransportPeerEventHandler>> {
        let pair = ZenohPair {
            own: self.own,
            peer: ZenohNode {
                zid: peer.zid,
                whatami: peer.whatami,
            },
        };
        Ok(Arc::new(ReportedSession(Session::opened(pair))))
    }

    fn new_multicast(
        &self,
        _transport: TransportMulticast,
    ) -> ZResult<Arc<dyn TransportMulticastEventHandler>> {
        Err("multicast groups have no sessions".into())
    }
}

/// The handler that Zenoh keeps until the last of its tasks has released the session.
struct ReportedSession(Session);

impl TransportPeerEventHandler for ReportedSession {
    fn handle_message(&self, _message: NetworkMessageMut) -> ZResult<()> {
        Ok(())
    }

    fn new_link(&self, _link: Link) {}

    fn del_link(&self, link: Link) {
        wait_for_writers(&link.src, &link.dst);
    }

    fn closed(&self) {
        self.0.on_closed();
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

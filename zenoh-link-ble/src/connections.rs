//! Closes a BLE connection when no channel uses it any more. The system keeps it otherwise, and a peer that does not advertise
//! while it is connected, as many microcontrollers, could not be dialled again.
//!
//! Several channels may share one connection: those of two robots that dial each other at the same time, that of a link and of
//! the one that replaces it, or those of two Zenoh runtimes of this process. Each dial, handshake and link therefore holds a
//! [`ConnectionGuard`].
use std::{
    collections::HashMap,
    sync::{Arc, Weak},
    time::Duration,
};

use parking_lot::Mutex;
use tokio::{runtime::Handle, sync::Notify};
use zenoh_link_ble_radio::{address::DeviceAddress, Radio};

/// How long a connection without a channel stays open if the peer has ended the last link. The peer closes the connection
/// itself, or dials again: a router does so after a second at most, and the system may lose a channel that is requested while it
/// closes the connection.
const GRACE: Duration = Duration::from_secs(2);

/// The part of the connections of one adapter that all nodes of the process share.
#[derive(Default)]
struct SharedConnections {
    connections: Mutex<Connections>,
    /// Notified whenever a connection was closed.
    closed: Notify,
}

/// The connections by the id of the radio.
static SHARED: Mutex<Vec<(String, Weak<SharedConnections>)>> = Mutex::new(Vec::new());

impl SharedConnections {
    /// Returns the connections of the adapter with that id.
    fn of(radio_id: &str) -> Arc<Self> {
        let mut shared = SHARED.lock();
        shared.retain(|(_, connections)| connections.strong_count() > 0);
        let existing = shared.iter().find(|(id, _)| id == radio_id);
        if let Some(existing) = existing.and_then(|(_, connections)| connections.upgrade()) {
            return existing;
        }
        let connections = Arc::<Self>::default();
        shared.push((radio_id.to_owned(), Arc::downgrade(&connections)));
        connections
    }
}

#[derive(Default)]
struct Connections(HashMap<DeviceAddress, Connection>);

#[derive(Default)]
struct Connection {
    /// Number of guards.
    users: usize,
    /// Number of guards since this side has known the connection.
    uses: u64,
    is_closing: bool,
}

impl Connections {
    fn on_use(&mut self, device: DeviceAddress) {
        let connection = self.0.entry(device).or_default();
        connection.users += 1;
        connection.uses += 1;
    }

    /// Records that a guard was dropped. Returns the number of uses if it was the last one.
    fn on_released(&mut self, device: DeviceAddress) -> Option<u64> {
        let connection = self.0.get_mut(&device)?;
        connection.users -= 1;
        (connection.users == 0).then_some(connection.uses)
    }

    /// Begins to close a connection. Returns `false` if it was used since `uses` were counted, or is being closed already.
    fn begin_closing(&mut self, device: DeviceAddress, uses: u64) -> bool {
        let Some(connection) = self.0.get_mut(&device) else {
            return false;
        };
        let is_due = connection.uses == uses && connection.users == 0 && !connection.is_closing;
        connection.is_closing |= is_due;
        is_due
    }

    fn on_closed(&mut self, device: DeviceAddress) {
        if let Some(connection) = self.0.get_mut(&device) {
            connection.is_closing = false;
            if connection.users == 0 {
                self.0.remove(&device);
            }
        }
    }

    fn users(&self, device: DeviceAddress) -> usize {
        self.0.get(&device).map_or(0, |one| one.users)
    }

    fn is_closing(&self, device: DeviceAddress) -> bool {
        self.0.get(&device).is_some_and(|one| one.is_closing)
    }
}

/// The connections of one adapter, as a node sees them.
pub(crate) struct AdapterConnections {
    radio: Arc<dyn Radio>,
    shared: Arc<SharedConnections>,
}

impl AdapterConnections {
    pub(crate) fn new(radio: Arc<dyn Radio>) -> Arc<Self> {
        let shared = SharedConnections::of(&radio.id());
        Arc::new(Self { radio, shared })
    }

    /// Records that the caller uses the connection to a device, or is about to open it. After the last guard is dropped, the
    /// connection is closed.
    pub(crate) fn use_one(self: &Arc<Self>, device: DeviceAddress) -> ConnectionGuard {
        self.shared.connections.lock().on_use(device);
        ConnectionGuard {
            adapter: Arc::clone(self),
            device,
            runtime: Handle::current(),
            ends_here: false,
        }
    }

    /// Waits while the connection to a device is being closed. A channel that was opened meanwhile would end with it.
    pub(crate) async fn wait_until_closed(&self, device: DeviceAddress) {
        loop {
            let closed = self.shared.closed.notified();
            if !self.shared.connections.lock().is_closing(device) {
                return;
            }
            closed.await;
        }
    }

    /// Closes a connection that has remained from an earlier link. The caller has the only guard.
    pub(crate) async fn close_remaining(&self, device: DeviceAddress) {
        let is_alone = self.shared.connections.lock().users(device) == 1;
        if is_alone {
            self.radio.disconnect(device).await;
        }
    }

    /// Closes a connection, which [`Connections::begin_closing`] permits.
    async fn close_connection(&self, device: DeviceAddress) {
        self.radio.disconnect(device).await;
        self.shared.connections.lock().on_closed(device);
        self.shared.closed.notify_waiters();
    }
}

/// A user of the connection to a device. Dropping the last one closes the connection, in a task of its own.
pub(crate) struct ConnectionGuard {
    adapter: Arc<AdapterConnections>,
    device: DeviceAddress,
    /// A guard may be dropped by a thread that does not belong to a runtime.
    runtime: Handle,
    ends_here: bool,
}

impl ConnectionGuard {
    /// Records that this side ends the link, or refuses it: the connection is closed at once.
    pub(crate) fn end_here(&mut self) {
        self.ends_here = true;
    }
}

impl Drop for ConnectionGuard {
    fn drop(&mut self) {
        let (adapter, device) = (Arc::clone(&self.adapter), self.device);
        let mut connections = self.adapter.shared.connections.lock();
        let Some(uses) = connections.on_released(device) else {
            return;
        };
        // From now on, a dial waits until the connection is closed.
        let is_closing = self.ends_here && connections.begin_closing(device, uses);
        drop(connections);
        self.runtime.spawn(async move {
            if !is_closing {
                tokio::time::sleep(GRACE).await;
                let mut connections = adapter.shared.connections.lock();
                let is_due = connections.begin_closing(device, uses);
                drop(connections);
                if !is_due {
                    return;
                }
            }
            adapter.close_connection(device).await;
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::address::{Address, AddressType};

    const DEVICE: DeviceAddress = DeviceAddress {
        address: Address([0xc0, 0, 0, 0, 0, 1]),
        kind: AddressType::Random,
    };

    #[test]
    fn connection_is_closed_after_its_last_use() {
        let mut connections = Connections::default();
        connections.on_use(DEVICE);
        connections.on_use(DEVICE);
        assert_eq!(connections.on_released(DEVICE), None);
        let uses = connections.on_released(DEVICE).expect("the last one");
        assert!(connections.begin_closing(DEVICE, uses));
        assert!(!connections.begin_closing(DEVICE, uses), "once");
        assert!(connections.is_closing(DEVICE));
        connections.on_closed(DEVICE);
        assert!(connections.0.is_empty());
    }

    #[test]
    fn connection_that_was_used_meanwhile_stays_open() {
        let mut connections = Connections::default();
        connections.on_use(DEVICE);
        let uses = connections.on_released(DEVICE).expect("the last one");
        connections.on_use(DEVICE);
        assert!(!connections.begin_closing(DEVICE, uses), "in use");
        let later = connections.on_released(DEVICE).expect("the last one");
        assert!(
            !connections.begin_closing(DEVICE, uses),
            "the time since the first use does not count"
        );
        assert!(connections.begin_closing(DEVICE, later));
    }
}

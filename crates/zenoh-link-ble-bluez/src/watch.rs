//! Watches an adapter: its power, its presence, and restarts of bluetoothd.
use std::sync::Arc;

use bluer::{AdapterEvent, AdapterProperty, Session, SessionEvent};
use futures::StreamExt;
use tokio::{sync::watch, task::JoinHandle};
use zenoh_link_ble_radio::RadioError;

use super::{errors::dbus_error, identity::Identity};

pub(super) struct Watch {
    /// Number of times the adapter's D-Bus object appeared or disappeared.
    changes: watch::Receiver<u64>,
    task: JoinHandle<()>,
}

impl Watch {
    pub(super) async fn start(
        session: Session,
        identity: Arc<Identity>,
    ) -> Result<Self, RadioError> {
        let mut session_events = session
            .events()
            .await
            .map_err(dbus_error("watch the adapters"))?
            .boxed();
        let (sender, changes) = watch::channel(0);
        let task = tokio::spawn(async move {
            loop {
                let mut adapter_events = match session.adapter(&identity.name()) {
                    Ok(adapter) => match adapter.events().await {
                        Ok(events) => events.boxed(),
                        Err(_) => futures::stream::pending().boxed(),
                    },
                    Err(_) => futures::stream::pending().boxed(),
                };
                loop {
                    tokio::select! {
                        event = session_events.next() => match event {
                            Some(SessionEvent::AdapterAdded(name)) => {
                                let is_ours = name == identity.name();
                                sender.send_modify(|epoch| *epoch += u64::from(is_ours));
                                // A new object with this or another name: watch it instead of the old one.
                                break;
                            }
                            Some(SessionEvent::AdapterRemoved(name)) if name == identity.name() => {
                                sender.send_modify(|epoch| *epoch += 1);
                            }
                            Some(_) => {}
                            None => return,
                        },
                        event = adapter_events.next() => match event {
                            Some(AdapterEvent::PropertyChanged(AdapterProperty::Powered(_))) => {
                                sender.send_modify(|_| ());
                            }
                            Some(_) => {}
                            None => adapter_events = futures::stream::pending().boxed(),
                        },
                    }
                }
            }
        });
        Ok(Self { changes, task })
    }

    pub(super) fn epoch(&self) -> u64 {
        *self.changes.borrow()
    }

    pub(super) async fn changed(&self) {
        let mut changes = self.changes.clone();
        changes.mark_unchanged();
        if changes.changed().await.is_err() {
            // The watch ended with its session. The caller polls the state itself.
            std::future::pending::<()>().await;
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.task.abort();
    }
}

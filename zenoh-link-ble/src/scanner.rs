//! Owns finding peers: one scan per adapter, shared by everyone who looks for somebody, running only while somebody does.
use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use tokio::sync::broadcast;

use crate::radio::{Radio, RadioError, Sighting};

/// Sightings a slow seeker may lag behind before it misses some: seekers only want a fresh one.
const BACKLOG: usize = 64;
/// How long to wait before a scan that the system ended is started again.
const RESTART: Duration = Duration::from_millis(200);

/// The scanner of one adapter.
pub(crate) struct Scanner {
    radio: Arc<dyn Radio>,
    running: Mutex<Option<broadcast::Sender<Sighting>>>,
}

impl Scanner {
    pub(crate) fn new(radio: Arc<dyn Radio>) -> Arc<Self> {
        Arc::new(Self {
            radio,
            running: Mutex::new(None),
        })
    }

    /// The first advertisement heard from now on that `wanted` picks. Waits for ever: the caller bounds it.
    pub(crate) async fn find<T>(
        self: &Arc<Self>,
        wanted: impl Fn(&Sighting) -> Option<T>,
    ) -> Result<T, RadioError> {
        loop {
            let mut sightings = self.subscribe().await?;
            loop {
                match sightings.recv().await {
                    Ok(sighting) => {
                        if let Some(found) = wanted(&sighting) {
                            return Ok(found);
                        }
                    }
                    Err(broadcast::error::RecvError::Lagged(_)) => {}
                    // The scan ended: the system stopped it, or the adapter went away. Start another.
                    Err(broadcast::error::RecvError::Closed) => break,
                }
            }
            tokio::time::sleep(RESTART).await;
        }
    }

    async fn subscribe(self: &Arc<Self>) -> Result<broadcast::Receiver<Sighting>, RadioError> {
        if let Some(sender) = self.lock().as_ref() {
            return Ok(sender.subscribe());
        }
        let mut scan = self.radio.scan().await?;
        let mut running = self.lock();
        if let Some(sender) = running.as_ref() {
            return Ok(sender.subscribe());
        }
        let (sender, receiver) = broadcast::channel(BACKLOG);
        *running = Some(sender.clone());
        drop(running);
        let scanner = Arc::clone(self);
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    sighting = scan.next() => match sighting {
                        Ok(sighting) => {
                            if sender.send(sighting).is_err() && scanner.stop_if_idle(&sender) {
                                return;
                            }
                        }
                        Err(error) => {
                            tracing::debug!(adapter = scanner.radio.name(), %error, "the scan ended");
                            scanner.lock().take();
                            return;
                        }
                    },
                    () = sender.closed() => {
                        if scanner.stop_if_idle(&sender) {
                            return;
                        }
                    }
                }
            }
        });
        Ok(receiver)
    }

    /// Takes the scan off if nobody looks any more; under the lock, so that nobody joins a scan that ends.
    fn stop_if_idle(&self, sender: &broadcast::Sender<Sighting>) -> bool {
        let mut running = self.lock();
        if sender.receiver_count() > 0 {
            return false;
        }
        running.take();
        true
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Option<broadcast::Sender<Sighting>>> {
        self.running
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

//! Owns finding peers: one scan per adapter, shared by everyone who looks for somebody, running only while somebody does.
use std::{sync::Arc, time::Duration};

use parking_lot::Mutex;
use tokio::{sync::broadcast, time::Instant};

use crate::{
    error::in_words,
    heard::{Heard, HeardStatus},
    radio::{Radio, RadioError, Sighting},
};

/// Sightings a slow seeker may lag behind before it misses some: seekers only want a fresh one.
const BACKLOG: usize = 64;
/// How long to wait before a scan that the system ended is started again.
const RESTART: Duration = Duration::from_millis(200);

/// How long a sighting is as good as hearing the peer now. A controller reports an unchanged advertisement once per scan,
/// so who begins to look during another's scan would wait for the next one.
const FRESH: Duration = Duration::from_millis(600);
/// Sightings kept for that.
const KEPT: usize = 64;

/// The scanner of one adapter.
pub(crate) struct Scanner {
    radio: Arc<dyn Radio>,
    running: Mutex<Option<broadcast::Sender<Sighting>>>,
    recent: Mutex<Recent>,
    heard: Mutex<Heard>,
}

/// What was heard within [`FRESH`], in order, the last of each device.
#[derive(Default)]
struct Recent(Vec<(Instant, Sighting)>);

impl Recent {
    fn on_seen(&mut self, sighting: &Sighting, now: Instant) {
        self.0.retain(|(at, other)| {
            now.duration_since(*at) < FRESH && other.device != sighting.device
        });
        if self.0.len() >= KEPT {
            self.0.remove(0);
        }
        self.0.push((now, sighting.clone()));
    }

    /// Takes out what `wanted` picks: a peer that did not answer is dialled again only when it is heard again.
    fn take<T>(&mut self, wanted: impl Fn(&Sighting) -> Option<T>, now: Instant) -> Option<T> {
        let (index, found) = self.0.iter().enumerate().find_map(|(n, (at, sighting))| {
            let is_fresh = now.duration_since(*at) < FRESH;
            is_fresh
                .then(|| wanted(sighting))
                .flatten()
                .map(|found| (n, found))
        })?;
        self.0.remove(index);
        Some(found)
    }
}

impl Scanner {
    pub(crate) fn new(radio: Arc<dyn Radio>) -> Arc<Self> {
        Arc::new(Self {
            radio,
            running: Mutex::new(None),
            recent: Mutex::default(),
            heard: Mutex::default(),
        })
    }

    /// The first advertisement, just heard or heard from now on, that `wanted` picks. Waits for ever: the caller bounds it.
    pub(crate) async fn find<T>(
        self: &Arc<Self>,
        wanted: impl Fn(&Sighting) -> Option<T>,
    ) -> Result<T, RadioError> {
        if let Some(found) = self.recent.lock().take(&wanted, Instant::now()) {
            return Ok(found);
        }
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

    /// Who was heard lately.
    pub(crate) fn heard(&self) -> Vec<HeardStatus> {
        self.heard.lock().status(Instant::now().into_std())
    }

    fn on_seen(self: &Arc<Self>, sighting: &Sighting) {
        let now = Instant::now();
        self.recent.lock().on_seen(sighting, now);
        if !self.heard.lock().on_seen(sighting, now.into_std()) {
            return;
        }
        let (scanner, device) = (Arc::clone(self), sighting.device);
        tokio::spawn(async move {
            if let Some(name) = scanner.radio.name_of(device).await {
                scanner.heard.lock().on_name(device, name);
            }
        });
    }

    /// From now on only what is heard afterwards counts.
    pub(crate) fn forget(&self) {
        self.recent.lock().0.clear();
    }

    async fn subscribe(self: &Arc<Self>) -> Result<broadcast::Receiver<Sighting>, RadioError> {
        if let Some(sender) = self.running.lock().as_ref() {
            return Ok(sender.subscribe());
        }
        let mut scan = self.radio.scan().await?;
        let mut running = self.running.lock();
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
                            scanner.on_seen(&sighting);
                            if sender.send(sighting).is_err() && scanner.stop_if_idle(&sender) {
                                return;
                            }
                        }
                        Err(error) => {
                            let (adapter, error) = (scanner.radio.name(), in_words(&error));
                            tracing::debug!("ble: the scan of {adapter} ended: {error}");
                            scanner.running.lock().take();
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
        let mut running = self.running.lock();
        if sender.receiver_count() > 0 {
            return false;
        }
        running.take();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::address::{Address, AddressType, DeviceAddress};

    fn sighting(n: u8, rssi_dbm: i16) -> Sighting {
        let address = Address([0xc0, 0, 0, 0, 0, n]);
        let kind = AddressType::Random;
        Sighting {
            device: DeviceAddress { address, kind },
            advertisement: None,
            rssi_dbm: Some(rssi_dbm),
        }
    }

    #[test]
    fn a_fresh_sighting_serves_once_and_an_old_one_never() {
        let (mut recent, start) = (Recent::default(), Instant::now());
        let first = |s: &Sighting| (s.device == sighting(1, 0).device).then_some(s.rssi_dbm);
        recent.on_seen(&sighting(1, -60), start);
        recent.on_seen(&sighting(2, -70), start);
        recent.on_seen(&sighting(1, -50), start + FRESH / 2);
        assert_eq!(recent.take(first, start + FRESH), Some(Some(-50)));
        assert_eq!(recent.take(first, start + FRESH), None);
        recent.on_seen(&sighting(1, -40), start + FRESH);
        assert_eq!(recent.take(first, start + 2 * FRESH), None);
    }

    #[test]
    fn a_hall_full_of_devices_is_not_remembered_whole() {
        let (mut recent, now) = (Recent::default(), Instant::now());
        for n in 0..=u8::MAX {
            recent.on_seen(&sighting(n, 0), now);
        }
        assert_eq!(recent.0.len(), KEPT);
        let last = |s: &Sighting| (s.device == sighting(u8::MAX, 0).device).then_some(());
        assert_eq!(recent.take(last, now), Some(()));
    }
}

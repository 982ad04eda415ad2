//! Discovers peers. All searches on an adapter share one scan, which runs only while there are searches.
use std::{sync::Arc, time::Duration};

use parking_lot::Mutex;
use tokio::{sync::broadcast, time::Instant};
use zenoh_link_ble_radio::{AdvertisingReport, Radio, RadioError};

use crate::{
    discovered::{DiscoveredNodes, DiscoveredStatus},
    error::describe,
};

/// Number of advertising reports that a slow search may lag behind before it misses some. A search needs only a recent one.
const BACKLOG: usize = 64;
/// Time after which a scan that the system ended is started again.
const RESTART_DELAY: Duration = Duration::from_millis(200);

/// How long an advertising report can be used after it was received. A controller reports an unchanged advertisement once per
/// scan, so a search that begins during the scan of another one would otherwise wait for the next scan.
const FRESH: Duration = Duration::from_millis(600);
/// Largest number of reports that are kept for this purpose.
const MAX_RECENT: usize = 64;

/// The scanner of one adapter.
pub(crate) struct Scanner {
    radio: Arc<dyn Radio>,
    running: Mutex<Option<broadcast::Sender<AdvertisingReport>>>,
    recent: Mutex<Recent>,
    discovered: Mutex<DiscoveredNodes>,
}

/// The latest advertising report of each device within [`FRESH`], in the order of arrival.
#[derive(Default)]
struct Recent(Vec<(Instant, AdvertisingReport)>);

impl Recent {
    /// Stores a report in place of the last one of the same device.
    fn on_report(&mut self, report: &AdvertisingReport, now: Instant) {
        self.0
            .retain(|(at, other)| now.duration_since(*at) < FRESH && other.device != report.device);
        if self.0.len() >= MAX_RECENT {
            self.0.remove(0);
        }
        self.0.push((now, report.clone()));
    }

    /// Removes the first report for which `select` returns a value, and returns that value. A peer that did not answer is
    /// therefore dialled again only after another report.
    fn take<T>(
        &mut self,
        select: impl Fn(&AdvertisingReport) -> Option<T>,
        now: Instant,
    ) -> Option<T> {
        let (index, found) = self.0.iter().enumerate().find_map(|(n, (at, report))| {
            let is_fresh = now.duration_since(*at) < FRESH;
            is_fresh
                .then(|| select(report))
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
            discovered: Mutex::default(),
        })
    }

    /// Waits for a recent or future report for which `select` returns a value, and returns that value. There is no timeout:
    /// the caller limits the time.
    ///
    /// # Errors
    /// Fails if the radio cannot scan.
    pub(crate) async fn find<T>(
        self: &Arc<Self>,
        select: impl Fn(&AdvertisingReport) -> Option<T>,
    ) -> Result<T, RadioError> {
        if let Some(found) = self.recent.lock().take(&select, Instant::now()) {
            return Ok(found);
        }
        loop {
            let mut reports = self.subscribe().await?;
            loop {
                match reports.recv().await {
                    Ok(report) => {
                        if let Some(found) = select(&report) {
                            return Ok(found);
                        }
                    }
                    Err(broadcast::error::RecvError::Lagged(_)) => {}
                    // The system has stopped the scan, or the adapter was removed. Start another scan.
                    Err(broadcast::error::RecvError::Closed) => break,
                }
            }
            tokio::time::sleep(RESTART_DELAY).await;
        }
    }

    /// Returns the nodes that were discovered within the last minute.
    pub(crate) fn discovered(&self) -> Vec<DiscoveredStatus> {
        self.discovered.lock().status(Instant::now().into_std())
    }

    /// Stores a report, and requests the name of a new node from the radio.
    fn on_report(self: &Arc<Self>, report: &AdvertisingReport) {
        let now = Instant::now();
        self.recent.lock().on_report(report, now);
        if !self.discovered.lock().on_report(report, now.into_std()) {
            return;
        }
        let (scanner, device) = (Arc::clone(self), report.device);
        tokio::spawn(async move {
            if let Some(name) = scanner.radio.device_name(device).await {
                scanner.discovered.lock().on_name(device, name);
            }
        });
    }

    /// Discards the recent reports, so that only later ones are used.
    pub(crate) fn clear_recent(&self) {
        self.recent.lock().0.clear();
    }

    /// Joins the running scan, or starts one.
    async fn subscribe(
        self: &Arc<Self>,
    ) -> Result<broadcast::Receiver<AdvertisingReport>, RadioError> {
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
                    report = scan.next() => match report {
                        Ok(report) => {
                            scanner.on_report(&report);
                            if sender.send(report).is_err() && scanner.stop_if_idle(&sender) {
                                return;
                            }
                        }
                        Err(error) => {
                            let (adapter, error) = (scanner.radio.name(), describe(&error));
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

    /// Stops the scan if there are no searches any more, and returns whether it was stopped. This happens under the lock, so
    /// that no search joins a scan that is being stopped.
    fn stop_if_idle(&self, sender: &broadcast::Sender<AdvertisingReport>) -> bool {
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
    use zenoh_link_ble_radio::address::{Address, AddressType, DeviceAddress};

    fn report(n: u8, rssi_dbm: i16) -> AdvertisingReport {
        let address = Address([0xc0, 0, 0, 0, 0, n]);
        let kind = AddressType::Random;
        AdvertisingReport {
            device: DeviceAddress { address, kind },
            advertisement: None,
            rssi_dbm: Some(rssi_dbm),
        }
    }

    #[test]
    fn fresh_report_is_used_once_and_an_old_one_never() {
        let (mut recent, start) = (Recent::default(), Instant::now());
        let first = |s: &AdvertisingReport| (s.device == report(1, 0).device).then_some(s.rssi_dbm);
        recent.on_report(&report(1, -60), start);
        recent.on_report(&report(2, -70), start);
        recent.on_report(&report(1, -50), start + FRESH / 2);
        assert_eq!(recent.take(first, start + FRESH), Some(Some(-50)));
        assert_eq!(recent.take(first, start + FRESH), None);
        recent.on_report(&report(1, -40), start + FRESH);
        assert_eq!(recent.take(first, start + 2 * FRESH), None);
    }

    #[test]
    fn number_of_recent_reports_is_bounded() {
        let (mut recent, now) = (Recent::default(), Instant::now());
        for n in 0..=u8::MAX {
            recent.on_report(&report(n, 0), now);
        }
        assert_eq!(recent.0.len(), MAX_RECENT);
        let last = |s: &AdvertisingReport| (s.device == report(u8::MAX, 0).device).then_some(());
        assert_eq!(recent.take(last, now), Some(()));
    }
}

//! Remembers which peers have asked for a link and got none, for example because they did not prove the secret. The registry shows
//! them, because their owner looks for the reason on this side, too. The log names each of them once a minute, since a peer that is
//! refused dials again and again.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use serde::Serialize;
use zenoh_link_ble_radio::address::DeviceAddress;

/// How long a refusal is shown, and the interval at which the log names a peer that is refused for the same reason.
const PERIOD: Duration = Duration::from_secs(60);
/// Largest number of remembered peers; those whose last refusal was longest ago are forgotten.
const MAX_PEERS: usize = 64;

/// A peer that was refused a link within the last minute.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefusedStatus {
    /// Bluetooth address of the peer.
    pub address: String,
    /// Why it was refused the last time, as text for people.
    pub reason: String,
    /// How often it was refused since its last link.
    pub count: u64,
    /// Time since the last refusal, in seconds.
    pub ago_s: f64,
}

#[derive(Debug)]
struct RefusedPeer {
    device: DeviceAddress,
    reason: String,
    count: u64,
    at: Instant,
    logged_at: Instant,
    /// Number of refusals that the log does not name yet.
    unlogged: u64,
}

/// The refused peers, the latest at the end.
#[derive(Debug, Default)]
pub(crate) struct Refusals(VecDeque<RefusedPeer>);

impl Refusals {
    /// Records that a peer got no link. Returns what to log, if anything.
    pub(crate) fn on_refused(
        &mut self,
        device: DeviceAddress,
        reason: &str,
        now: Instant,
    ) -> Option<String> {
        let known = self.take(device);
        if self.0.len() == MAX_PEERS {
            self.0.pop_front();
        }
        let is_repeated = known.as_ref().is_some_and(|known| {
            known.reason == reason && now.saturating_duration_since(known.logged_at) < PERIOD
        });
        let (count, before, logged_at) = known.map_or((0, 0, now), |known| {
            (known.count, known.unlogged, known.logged_at)
        });
        self.0.push_back(RefusedPeer {
            device,
            reason: reason.to_owned(),
            count: count + 1,
            at: now,
            logged_at: if is_repeated { logged_at } else { now },
            unlogged: if is_repeated { before + 1 } else { 0 },
        });
        if is_repeated {
            return None;
        }
        // Most reasons name the peer.
        let device = device.to_string();
        let peer = if reason.contains(&device) {
            String::new()
        } else {
            format!(" with {device}")
        };
        let more = match before {
            0 => String::new(),
            before => format!(" (and {before} more times since the last line about it)"),
        };
        Some(format!("no link{peer}: {reason}{more}"))
    }

    /// Forgets a peer that has a link now.
    pub(crate) fn on_linked(&mut self, device: DeviceAddress) {
        self.take(device);
    }

    /// Returns the peers that were refused within the last minute.
    pub(crate) fn status(&self, now: Instant) -> Vec<RefusedStatus> {
        let age = |peer: &RefusedPeer| now.saturating_duration_since(peer.at);
        let recent = self.0.iter().filter(|peer| age(peer) < PERIOD);
        let status = |peer: &RefusedPeer| RefusedStatus {
            address: peer.device.to_string(),
            reason: peer.reason.clone(),
            count: peer.count,
            ago_s: age(peer).as_secs_f64(),
        };
        recent.map(status).collect()
    }

    fn take(&mut self, device: DeviceAddress) -> Option<RefusedPeer> {
        let at = self.0.iter().position(|peer| peer.device == device)?;
        self.0.remove(at)
    }
}

#[cfg(test)]
mod tests {
    use zenoh_link_ble_radio::address::{Address, AddressType};

    use super::*;

    const S: Duration = Duration::from_secs(1);

    fn device(number: u8) -> DeviceAddress {
        DeviceAddress {
            address: Address([0, 0, 0, 0, 0, number]),
            kind: AddressType::Public,
        }
    }

    #[test]
    fn a_peer_that_is_refused_again_and_again_is_logged_once_a_minute_and_counted() {
        let (mut refusals, start) = (Refusals::default(), Instant::now());
        let logged: Vec<_> = (0..100)
            .filter_map(|s| refusals.on_refused(device(1), "it has another secret", start + s * S))
            .collect();
        assert_eq!(logged.len(), 2, "{logged:?}");
        assert_eq!(
            logged[0],
            "no link with 00:00:00:00:00:01: it has another secret"
        );
        assert!(logged[1].ends_with("(and 59 more times since the last line about it)"));
        let status = refusals.status(start + 102 * S);
        assert_eq!((status[0].count, status[0].ago_s), (100, 3.0));
        // Another reason, and another peer, are news.
        for (number, reason) in [
            (1, "00:00:00:00:00:01 is silent"),
            (2, "it has another secret"),
        ] {
            let logged = refusals.on_refused(device(number), reason, start + 103 * S);
            assert_eq!(
                logged.is_some_and(|line| line.contains(" with ")),
                number == 2
            );
        }
        refusals.on_linked(device(1));
        assert_eq!(refusals.status(start + 104 * S).len(), 1);
        assert!(refusals.status(start + 170 * S).is_empty());
    }

    #[test]
    fn peers_are_bounded() {
        let (mut refusals, now) = (Refusals::default(), Instant::now());
        (0..=255).for_each(|number| drop(refusals.on_refused(device(number), "no", now)));
        assert_eq!(refusals.status(now).len(), MAX_PEERS);
    }
}

//! Describes one adapter of the simulated air: its name, its address, and its activities apart from connections.
use std::{
    collections::{BTreeMap, HashMap},
    time::Duration,
};

use serde::{Deserialize, Serialize};
use zenoh_link_ble_radio::{
    address::{Address, AddressType, DeviceAddress, Psm},
    advertisement::Advertisement,
    AdapterState,
};

use super::{clock::Clock, id::AdapterId, message::RequestId};

/// Prefix of the name of every simulated adapter.
pub const NAME_PREFIX: &str = "sim";

/// Maximum length of an adapter's name, in bytes.
pub const MAX_ADAPTER_NAME_BYTES: usize = 32;

/// Maximum number of pending requests of each kind per adapter: far more than one robot needs.
pub(super) const MAX_REQUESTS: usize = 128;

/// The text is not a valid name of a simulated adapter.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "{0:?} is not a valid name of a simulated adapter: use `sim` followed by letters, digits, - or _, at most 32 bytes in total"
)]
pub struct AdapterNameError(pub String);

/// Checks that the text is a valid name of a simulated adapter.
///
/// # Errors
/// Returns [`AdapterNameError`] if it is not.
pub fn check_name(name: &str) -> Result<(), AdapterNameError> {
    let is_good = name.len() <= MAX_ADAPTER_NAME_BYTES
        && name.strip_prefix(NAME_PREFIX).is_some_and(|rest| {
            rest.bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_')
        });
    if is_good {
        Ok(())
    } else {
        Err(AdapterNameError(name.chars().take(64).collect()))
    }
}

/// Returns the address of the adapter with this name: a static random address, so its two top bits are set (Vol 6, Part
/// B, 1.3.2.1).
pub fn address_of(name: &str) -> DeviceAddress {
    let [a, b, c, d] = crc32fast::hash(name.as_bytes()).to_be_bytes();
    let mut salted = crc32fast::Hasher::new();
    salted.update(b"rect-air/");
    salted.update(name.as_bytes());
    let [e, f, ..] = salted.finalize().to_be_bytes();
    DeviceAddress {
        address: Address([e | 0b1100_0000, f, a, b, c, d]),
        kind: AddressType::Random,
    }
}

#[derive(Debug)]
pub(super) struct Adapter {
    pub(super) name: String,
    pub(super) address: DeviceAddress,
    pub(super) state: AdapterState,
    pub(super) advertisements: BTreeMap<RequestId, Advertising>,
    /// Time at which each advertisement was last reported; `None` if the adapter does not scan.
    pub(super) scan: Option<BTreeMap<(AdapterId, RequestId), Duration>>,
    /// Time at which the adapter began to receive advertisements.
    pub(super) receiving_since: Duration,
    /// Receive MTU of each listener, by PSM.
    pub(super) listeners: BTreeMap<u16, u16>,
    pub(super) dials: BTreeMap<RequestId, Dial>,
    /// Connection intervals that were set for peers.
    pub(super) intervals: HashMap<DeviceAddress, Duration>,
    pub(super) clock: Clock,
    pub(super) stats: AdapterStats,
}

#[derive(Debug)]
pub(super) struct Advertising {
    pub(super) advertisement: Advertisement,
    pub(super) name: String,
    pub(super) next: Duration,
    /// Start of the event in progress, if an adapter may receive it.
    pub(super) event: Option<Duration>,
}

/// A connect that is waiting for the peer's advertisement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dial {
    pub(super) peer: DeviceAddress,
    pub(super) psm: Psm,
    pub(super) recv_mtu: u16,
}

/// Traffic that an adapter has sent since it was attached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterStats {
    /// Number of SDUs that its channels accepted for sending.
    pub sdus: u64,
    /// Size of these SDUs in bytes, without the headers of L2CAP and the link layer.
    pub sdu_bytes: u64,
    /// Size of its link-layer packets in bytes, headers included.
    pub bytes_on_air: u64,
    /// Number of link-layer packets, retransmissions included.
    pub pdus: u64,
    /// Number of retransmitted packets.
    pub repeats: u64,
    /// Time for which its radio was busy with connection events. Serialized in seconds.
    #[serde(rename = "busy_s", with = "seconds")]
    pub busy: Duration,
    /// Airtime of its advertisements. Serialized in seconds.
    #[serde(rename = "advertising_s", with = "seconds")]
    pub advertising: Duration,
}

mod seconds {
    use std::time::Duration;

    use serde::{de::Error, Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(span: &Duration, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_f64(span.as_secs_f64())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Duration, D::Error> {
        Duration::try_from_secs_f64(f64::deserialize(d)?).map_err(D::Error::custom)
    }
}

impl Adapter {
    /// Returns whether the adapter receives advertisements: it scans or waits to connect.
    pub(super) fn receives_advertisements(&self) -> bool {
        self.scan.is_some() || !self.dials.is_empty()
    }

    /// Returns whether the adapter waits for an advertisement of that device in order to connect.
    pub(super) fn dials_to(&self, device: DeviceAddress) -> bool {
        self.dials.values().any(|dial| dial.peer == device)
    }

    pub(super) fn new(name: &str, clock: Clock) -> Self {
        Self {
            name: name.to_owned(),
            address: address_of(name),
            state: AdapterState::On,
            advertisements: BTreeMap::new(),
            scan: None,
            receiving_since: Duration::ZERO,
            listeners: BTreeMap::new(),
            dials: BTreeMap::new(),
            intervals: HashMap::new(),
            clock,
            stats: AdapterStats::default(),
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.state == AdapterState::On
    }

    /// Ends all activities, as an adapter does when it loses power.
    pub(super) fn stop(&mut self) {
        self.advertisements.clear();
        self.scan = None;
        self.listeners.clear();
        self.dials.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accepts_only_short_names_with_the_prefix_sim() {
        for good in ["sim", "sim0", "sim-wombat-1", "sim_A"] {
            assert_eq!(check_name(good), Ok(()), "{good}");
        }
        for bad in [
            "",
            "hci0",
            "sim/1",
            "sim é",
            &format!("sim{}", "x".repeat(30)),
        ] {
            assert!(check_name(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn derives_a_static_random_address_from_the_name() {
        let a = address_of("sim-a");
        assert_eq!(a, address_of("sim-a"));
        assert_ne!(a, address_of("sim-b"));
        assert_eq!(a.kind, AddressType::Random);
        assert_eq!(a.address.0[0] >> 6, 0b11);
    }
}

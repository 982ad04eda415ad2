//! Owns one adapter of the simulated air: its name and address, and what it is doing besides its connections.
use std::{collections::BTreeMap, time::Duration};

use serde::{Deserialize, Serialize};

use super::{air::AdapterId, message::RequestId};
use crate::{
    address::{Address, AddressType, DeviceAddress, Psm},
    advertisement::Advertisement,
    radio::AdapterState,
};

/// How the name of every simulated adapter begins.
pub const NAME_PREFIX: &str = "sim";

/// The longest name of an adapter, in bytes.
pub const MAX_ADAPTER_NAME_BYTES: usize = 32;

/// The most of each kind of request that one adapter may have pending: far above what one robot needs.
pub(super) const MAX_REQUESTS: usize = 128;

/// The text cannot be a simulated adapter's name.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error(
    "{0:?} cannot be a simulated adapter: its name is `sim` and then letters, digits, - or _, at most 32 bytes in all"
)]
pub struct AdapterNameError(pub String);

/// Whether the text can be a simulated adapter's name.
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

/// The address of the adapter of that name: static random, so its two top bits are set (Vol 6, Part B, 1.3.2.1).
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
    /// While it scans: when each advertisement was last reported.
    pub(super) scan: Option<BTreeMap<(AdapterId, RequestId), Duration>>,
    /// The receive MTU of each listener.
    pub(super) listeners: BTreeMap<u16, u16>,
    pub(super) dials: BTreeMap<RequestId, Dial>,
    pub(super) stats: AdapterStats,
}

#[derive(Debug)]
pub(super) struct Advertising {
    pub(super) advertisement: Advertisement,
    pub(super) name: String,
    pub(super) next: Duration,
}

/// A connect that waits for its peer's advertisement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dial {
    pub(super) peer: DeviceAddress,
    pub(super) psm: Psm,
    pub(super) recv_mtu: u16,
}

/// What an adapter has sent so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AdapterStats {
    /// SDUs that its channels took.
    pub sdus: u64,
    /// Their bytes, without what L2CAP and the link layer add.
    pub sdu_bytes: u64,
    /// Bytes of its packets, headers included.
    pub bytes_on_air: u64,
    /// Packets, repeats included.
    pub pdus: u64,
    /// Packets that had to be sent again.
    pub repeats: u64,
    /// Time its radio was taken by connection events; in seconds where it is written.
    #[serde(rename = "busy_s", with = "seconds")]
    pub busy: Duration,
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
    /// Whether it has an ear for advertisements.
    pub(super) fn listens(&self) -> bool {
        self.scan.is_some() || !self.dials.is_empty()
    }

    pub(super) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            address: address_of(name),
            state: AdapterState::On,
            advertisements: BTreeMap::new(),
            scan: None,
            listeners: BTreeMap::new(),
            dials: BTreeMap::new(),
            stats: AdapterStats::default(),
        }
    }

    pub(super) fn is_on(&self) -> bool {
        self.state == AdapterState::On
    }

    /// Forgets all it was doing, as an adapter does that loses its power.
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
    fn names_begin_with_sim_and_are_short_and_plain() {
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
    fn an_address_is_static_random_and_belongs_to_the_name() {
        let a = address_of("sim-a");
        assert_eq!(a, address_of("sim-a"));
        assert_ne!(a, address_of("sim-b"));
        assert_eq!(a.kind, AddressType::Random);
        assert_eq!(a.address.0[0] >> 6, 0b11);
    }
}

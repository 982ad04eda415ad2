//! Represents one emulated controller: its links, the queued packets, and the packet in transmission.

use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::Id;
use crate::hci::{self, Address, Handle};

/// Default of a controller (Core Specification, Vol 4, Part E, 7.8.5).
pub(super) const DEFAULT_ADVERTISING_INTERVAL: Duration = Duration::from_millis(1280);

#[derive(Debug)]
pub(super) struct Link {
    pub(super) peer: Address,
    /// Set when both ends have reported the connection.
    pub(super) other_end: Option<(Id, Handle)>,
    /// Connection interval in units of 1.25 ms.
    pub(super) interval: u16,
}

#[derive(Debug)]
pub(super) struct Transmission {
    pub(super) packet: Vec<u8>,
    pub(super) ends: Instant,
}

#[derive(Debug)]
pub(super) struct Controller {
    pub(super) public_address: Option<Address>,
    pub(super) random_address: Option<Address>,
    /// Maximum time between two advertising events.
    pub(super) advertising_interval: Duration,
    pub(super) links: BTreeMap<Handle, Link>,
    /// ACL packets of the kernel that wait for their transmission.
    pub(super) waiting: VecDeque<Vec<u8>>,
    /// Rate limit in bytes of ACL data per second; 0: no limit.
    pub(super) bytes_per_s: u32,
    /// Packet in transmission.
    pub(super) on_air: Option<Transmission>,
    pub(super) frozen: bool,
    /// One entry per pending Disconnect command: `true` if the relay sent it, `false` if the kernel did.
    pub(super) disconnects: VecDeque<bool>,
    /// Handle and new interval of each accepted LE Connection Update.
    pub(super) updates: VecDeque<(Handle, u16)>,
    /// Number of bytes of ACL data that arrived at a peer, without headers.
    pub(super) sent_bytes: u64,
}

impl Controller {
    pub(super) fn new(bytes_per_s: u32) -> Self {
        Self {
            public_address: None,
            random_address: None,
            advertising_interval: DEFAULT_ADVERTISING_INTERVAL,
            links: BTreeMap::new(),
            waiting: VecDeque::new(),
            bytes_per_s,
            on_air: None,
            frozen: false,
            disconnects: VecDeque::new(),
            updates: VecDeque::new(),
            sent_bytes: 0,
        }
    }

    pub(super) fn is_at(&self, address: &Address) -> bool {
        self.public_address.as_ref() == Some(address)
            || self.random_address.as_ref() == Some(address)
    }

    pub(super) fn airtime(&self, packet: &[u8]) -> Duration {
        match self.bytes_per_s {
            0 => Duration::ZERO,
            rate => Duration::from_secs_f64(
                (packet.len() - hci::ACL_HEADER_BYTES) as f64 / f64::from(rate),
            ),
        }
    }
}

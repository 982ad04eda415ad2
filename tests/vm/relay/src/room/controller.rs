//! One emulated controller as the relay knows it: its links, what waits to be sent, what is on the air.

use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::Id;
use crate::hci::{self, Address, Handle};

#[derive(Debug)]
pub(super) struct Link {
    pub(super) peer: Address,
    /// Known when both ends have reported the connection.
    pub(super) other_end: Option<(Id, Handle)>,
}

#[derive(Debug)]
pub(super) struct Transmission {
    pub(super) packet: Vec<u8>,
    pub(super) ends: Instant,
}

#[derive(Debug, Default)]
pub(super) struct Controller {
    pub(super) public_address: Option<Address>,
    pub(super) random_address: Option<Address>,
    pub(super) links: BTreeMap<Handle, Link>,
    pub(super) waiting: VecDeque<Vec<u8>>,
    pub(super) bytes_per_s: u32,
    pub(super) on_air: Option<Transmission>,
    pub(super) frozen: bool,
    /// One entry per Disconnect command under way: whether the relay sent it, and not the kernel.
    pub(super) disconnects: VecDeque<bool>,
    pub(super) sent_bytes: u64,
}

impl Controller {
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

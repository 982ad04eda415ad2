//! Handles batches between Zenoh and the channel. In each direction, a link has one lane for each of Zenoh's priorities,
//! and the lanes have strict precedence. This module bounds what the lanes hold, applies the receiver's credits, and
//! protects each SDU against loss and damage, and with a
//! secret against everybody.
//!
//! The module is plain logic without I/O and is given the time; `link::traffic` of `zenoh-link-ble` moves the SDUs.
//!
//! ```text
//! write_all(priority) -> Lanes::push -> Scheduler: lanes by priority -> Lanes::send -> SDU -> channel
//! read(priority)      <- Lanes::take <- Receiver: lanes by priority  <- Lanes::on_sdu <- SDU <- channel
//!                                       Receiver's signals -> Scheduler (acknowledgements, full lanes)
//! ```
pub mod ack_timer;
pub mod backlog;
pub mod batch_kind;
pub mod check;
pub mod credits;
pub mod flight;
pub mod path;
pub mod receiver;
pub mod report;
pub mod scheduler;
pub mod sdu;
#[cfg(test)]
mod tests;
pub mod usage;

use std::time::Instant;

use zenoh_protocol::core::Priority;

use self::{
    path::Path,
    receiver::{Received, Receiver, Violation},
    report::{InLaneReport, OutLaneReport},
    scheduler::{Bounds, Scheduler, Sent},
    sdu::{Content, Protection},
};
use usage::{keys::KeyTable, Usage};

/// Number of lanes of a link in each direction: one for each of Zenoh's priorities.
pub const LANES: usize = Priority::NUM;

/// One of the [`LANES`] lanes. Its number is the value of Zenoh's priority; 0 (`Control`) is the most urgent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lane(u8);

impl Lane {
    /// Returns the lane with that number, or `None` if `number` is not below [`LANES`].
    pub fn new(number: u8) -> Option<Self> {
        (usize::from(number) < LANES).then_some(Self(number))
    }

    /// Returns the lane of a priority.
    pub fn of(priority: Priority) -> Self {
        Self(priority as u8)
    }

    /// Returns the most urgent lane.
    pub fn first() -> Self {
        Self(0)
    }

    /// Returns the least urgent lane.
    pub fn last() -> Self {
        Self(LANES as u8 - 1)
    }

    /// Returns all lanes, the most urgent first.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..LANES as u8).map(Self)
    }

    /// Returns the number of the lane, as it is sent over the air.
    pub fn number(self) -> u8 {
        self.0
    }

    /// Returns the name of Zenoh's priority, such as `Data`.
    pub fn priority(self) -> String {
        let priority = Priority::try_from(self.0);
        priority.map_or_else(|_| self.0.to_string(), |priority| format!("{priority:?}"))
    }

    /// Returns the number of the lane as an index into an array of [`LANES`] elements.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// The lanes of a link, in both directions.
pub struct Lanes {
    out: Scheduler,
    into: Receiver,
}

/// The effect of a received SDU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// A batch can be taken from that lane.
    Batch(Lane),
    /// The peer acknowledged batches, or stopped or restarted a lane: more or less may be sent than before.
    Credits,
    /// The peer ends the link, with the code of its reason. Batches that arrived before can still be taken.
    Goodbye(u8),
    /// The peer has set or requests a connection interval, in units of 1.25 ms.
    Interval(u16),
}

impl Lanes {
    /// Creates the lanes of a new link. `mtu` is the largest batch, in bytes. `own_window` and `peer_window` are the numbers
    /// of bytes that this side and the peer accept unacknowledged.
    pub fn new(
        bounds: Bounds,
        mtu: usize,
        own_window: u16,
        peer_window: u16,
        protection: Protection,
    ) -> Self {
        Self {
            out: Scheduler::new(bounds, mtu, peer_window, protection.out),
            into: Receiver::new(mtu, own_window, protection.into),
        }
    }

    /// Queues a batch on its lane. Returns `false` if there is no room: see [`Scheduler::push`].
    pub fn push(&mut self, lane: Lane, batch: &[u8], now: Instant) -> bool {
        self.out.push(lane, batch, now)
    }

    /// Returns when to offer a batch again that [`Lanes::push`] did not accept, even if nothing is sent until then: see
    /// [`Scheduler::retry_at`].
    pub fn retry_at(&self, lane: Lane, batch: &[u8], now: Instant) -> Option<Instant> {
        self.out.retry_at(lane, batch, now)
    }

    /// Gives the next SDU to `send`, if there is one: see [`Scheduler::send`].
    ///
    /// # Errors
    /// Those of `send`.
    pub fn send<E>(
        &mut self,
        now: Instant,
        send: impl FnOnce(&[u8]) -> Result<bool, E>,
    ) -> Result<Sent, E> {
        while let Some(signal) = self.into.signal() {
            self.out.signal(signal);
        }
        self.out.send(now, send)
    }

    /// Queues a connection interval for the peer, in units of 1.25 ms.
    pub fn send_interval(&mut self, units: u16) {
        self.out.signal(Content::Interval(units));
    }

    /// Returns when the link ends unless the peer acknowledges something, or `None` if no acknowledgement is due.
    pub fn ack_deadline(&self) -> Option<Instant> {
        self.out.ack_deadline()
    }

    /// Handles a received SDU, and decrypts it in place.
    ///
    /// # Errors
    /// Fails if an earlier SDU was lost, or if this one is damaged, repeated or breaks the protocol. The link has to
    /// end then.
    pub fn on_sdu(&mut self, sdu: &mut [u8], now: Instant) -> Result<Change, Violation> {
        match self.into.on_sdu(sdu)? {
            Received::Batch(lane) => Ok(Change::Batch(lane)),
            Received::Ack(total) => {
                self.out.on_ack(total, now)?;
                Ok(Change::Credits)
            }
            Received::Stopped(lane, is_stopped) => {
                self.out.on_stopped(lane, is_stopped);
                Ok(Change::Credits)
            }
            Received::Goodbye(reason) => Ok(Change::Goodbye(reason)),
            Received::Interval(units) => Ok(Change::Interval(units)),
        }
    }

    /// Takes the next received batch of a lane, if there is one.
    pub fn take(&mut self, lane: Lane) -> Option<Vec<u8>> {
        self.into.take(lane)
    }

    /// Takes the next batch of Zenoh's own handshake: see [`Receiver::take_handshake_batch`].
    ///
    /// # Errors
    /// Fails if the peer sent it on another lane than the first.
    pub fn take_handshake_batch(&mut self) -> Result<Option<Vec<u8>>, Violation> {
        self.into.take_handshake_batch()
    }

    /// Returns whether a signal for the peer is waiting: an acknowledgement, or a lane to stop or restart.
    pub fn has_signal(&self) -> bool {
        self.into.has_signal()
    }

    /// Begins to close the link: sends what is queued, then a goodbye with the code `reason`. Nothing more is accepted.
    pub fn close(&mut self, reason: u8) {
        self.out.close(reason);
    }

    /// Ends the link at once: discards what is queued, and sends a goodbye with the code `reason` next.
    pub fn abort(&mut self, reason: u8) {
        self.out.abort(reason);
    }

    /// Returns the measured properties of the path to the peer.
    pub fn path(&self) -> &Path {
        self.out.path()
    }

    /// Returns the number of bytes in flight to the peer, and the current limit for it.
    pub fn in_flight(&self) -> (u16, u16) {
        self.out.in_flight()
    }

    /// Returns the number of bytes that may wait on a lane before the lane accepts another message that must arrive.
    pub fn backlog_limit_bytes(&self) -> usize {
        self.out.backlog_limit_bytes()
    }

    /// Returns the keys that Zenoh has declared on the link.
    pub fn keys(&mut self) -> &mut KeyTable {
        self.out.keys()
    }

    /// Returns what was sent for each key.
    pub fn usage(&mut self) -> &mut Usage {
        self.out.usage()
    }

    /// Returns the state and the counts of a lane, for sending and for receiving.
    pub fn lane_report(&self, lane: Lane, now: Instant) -> (OutLaneReport, InLaneReport) {
        (self.out.lane_report(lane, now), self.into.lane_report(lane))
    }
}

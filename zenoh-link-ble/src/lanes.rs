//! Owns what happens to batches between Zenoh and the channel: one lane per priority in each direction, strict order
//! among them, bounds, credits from the receiver, and a check that tells when an SDU was lost or damaged. Plain logic
//! without I/O, given the time; `traffic.rs` moves the SDUs.
//!
//! ```text
//! write_all(priority) -> Lanes::push -> Scheduler: lanes by priority -> Lanes::peek -> SDU -> channel
//! read(priority)      <- Lanes::take <- Receiver: lanes by priority  <- Lanes::on_sdu <- SDU <- channel
//!                                       Receiver's signals -> Scheduler (what was taken, which lane is full)
//! ```
pub mod ack_timer;
pub mod backlog;
pub mod check;
pub mod credits;
pub mod flight;
pub mod path;
pub mod piece;
pub mod receiver;
pub mod report;
pub mod scheduler;
pub mod sdu;
#[cfg(test)]
mod tests;

use std::time::Instant;

use zenoh_protocol::core::Priority;

use self::{
    path::Path,
    receiver::{Received, Receiver, Violation},
    report::{InLaneReport, OutLaneReport},
    scheduler::{Bounds, Next, Scheduler},
};

/// How many lanes a link has in each direction: one for each of Zenoh's priorities.
pub const LANES: usize = Priority::NUM;
/// Bytes in front of a batch: the kind with the lane, and the check.
pub const HEADER: usize = 3;

/// One of the lanes: Zenoh's priority, `Priority::NUM` of them, as a number, 0 (`Control`) the most urgent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Lane(u8);

impl Lane {
    /// The lane of that number, if there is one.
    pub fn new(number: u8) -> Option<Self> {
        (usize::from(number) < LANES).then_some(Self(number))
    }

    /// The lane of a priority.
    pub fn of(priority: Priority) -> Self {
        Self(priority as u8)
    }

    /// The most urgent one.
    pub fn first() -> Self {
        Self(0)
    }

    /// The least urgent one.
    pub fn last() -> Self {
        Self(LANES as u8 - 1)
    }

    /// All of them, the most urgent first.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..LANES as u8).map(Self)
    }

    /// Its number.
    pub fn number(self) -> u8 {
        self.0
    }

    /// The same, as a place in a list of all.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Both directions of a link.
pub struct Lanes {
    out: Scheduler,
    into: Receiver,
}

/// What a received SDU changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// There is a batch to take from that lane.
    Batch(Lane),
    /// More may be sent than before.
    Credits,
    /// The peer ends the link; what came before may still be taken.
    Bye(u8),
}

impl Lanes {
    /// `mtu`: the largest batch, in bytes. `own_window` and `peer_window`: what each side takes unacknowledged, in bytes.
    pub fn new(bounds: Bounds, mtu: usize, own_window: u16, peer_window: u16) -> Self {
        Self {
            out: Scheduler::new(bounds, mtu, peer_window),
            into: Receiver::new(mtu, own_window),
        }
    }

    /// Puts a batch on its lane to be sent. `false`: there is no room, see [`Scheduler::push`].
    pub fn push(&mut self, lane: Lane, batch: &[u8], now: Instant) -> bool {
        self.out.push(lane, batch, now)
    }

    /// Returns when to offer a batch again that [`Lanes::push`] did not take, even if nothing went out until then.
    pub fn ask_again_at(&self, lane: Lane, batch: &[u8], now: Instant) -> Option<Instant> {
        self.out.ask_again_at(lane, batch, now)
    }

    /// What to send now, until [`Lanes::on_sent`] says that it went.
    pub fn peek(&mut self) -> Option<(Next, &[u8])> {
        while let Some(signal) = self.into.signal() {
            self.out.signal(signal);
        }
        self.out.peek()
    }

    /// What [`Lanes::peek`] gave out last, and nothing was put in since, went out.
    pub fn on_sent(&mut self, sent: Next, now: Instant) {
        self.out.on_sent(sent, now);
    }

    /// Returns when the link ends unless the peer acknowledges something; `None` if no acknowledgement is due.
    pub fn ack_deadline(&self) -> Option<Instant> {
        self.out.ack_deadline()
    }

    /// An SDU arrived.
    pub fn on_sdu(&mut self, sdu: &[u8], now: Instant) -> Result<Change, Violation> {
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
            Received::Bye(reason) => Ok(Change::Bye(reason)),
        }
    }

    /// The next batch of a lane.
    pub fn take(&mut self, lane: Lane) -> Option<Vec<u8>> {
        self.into.take(lane)
    }

    /// Returns the next batch of Zenoh's own handshake: see [`Receiver::take_of_handshake`].
    pub fn take_of_handshake(&mut self) -> Result<Option<Vec<u8>>, Violation> {
        self.into.take_of_handshake()
    }

    /// Whether the peer is to be told something.
    pub fn has_signal(&self) -> bool {
        self.into.has_signal()
    }

    /// The link ends: what waits goes out, then the goodbye.
    pub fn close(&mut self, reason: u8) {
        self.out.close(reason);
    }

    /// The link ends at once: what waits is thrown away, and the goodbye is next.
    pub fn abort(&mut self, reason: u8) {
        self.out.abort(reason);
    }

    /// What was measured of the way to the peer.
    pub fn path(&self) -> &Path {
        self.out.path()
    }

    /// What is on its way to the peer, and how much of it may be, in bytes.
    pub fn on_its_way(&self) -> (u16, u16) {
        self.out.on_its_way()
    }

    /// Bytes that may wait on a lane before it takes another message that must arrive.
    pub fn backlog_limit_bytes(&self) -> usize {
        self.out.backlog_limit_bytes()
    }

    /// Both sides of a lane.
    pub fn lane_report(&self, lane: Lane, now: Instant) -> (OutLaneReport, InLaneReport) {
        (self.out.lane_report(lane, now), self.into.lane_report(lane))
    }
}

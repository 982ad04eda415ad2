//! Handles the receiving side of a link: verifies each SDU, queues its batch on its lane, acknowledges it, and stops and
//! restarts lanes, which bounds the memory that unread batches occupy.
use std::collections::VecDeque;

use crate::{compression::NotCompressed, goodbye::Goodbye};

use super::{
    credits::{cost, Acks, CreditError},
    report::{Count, InLaneReport},
    sdu::{Content, Opener, SduError},
    Lane, LANES,
};

/// Number of unread bytes above which a lane is stopped. Up to it, a fast radio can continue for a short time while
/// Zenoh is busy. Each batch counts with its cost in credits, so that small batches do not occupy more memory than
/// large ones.
pub const HIGH_WATERMARK: usize = 16_384;
/// Number of unread bytes at which a stopped lane is restarted.
const LOW_WATERMARK: usize = HIGH_WATERMARK / 2;

/// A violation of the protocol by the peer, or a fault of the path to it. It ends the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// The SDU is damaged or malformed.
    #[error(transparent)]
    Sdu(#[from] SduError),
    /// The batch is larger than the link's MTU.
    #[error("a batch of {size} bytes is over the mtu of {mtu}")]
    TooLarge {
        /// The size of the batch, in bytes.
        size: usize,
        /// The link's MTU, in bytes.
        mtu: usize,
    },
    /// The peer violated the credits.
    #[error(transparent)]
    Credits(#[from] CreditError),
    /// More arrived on a stopped lane than could have been in flight.
    #[error("it keeps sending on lane {} that was stopped", .0.number())]
    Stopped(Lane),
    /// A batch arrived on another lane than the first before Zenoh's handshake was complete.
    #[error("a batch arrived on lane {} during Zenoh's handshake, which takes place on lane 0", .0.number())]
    Handshake(Lane),
    /// A compressed batch cannot be restored.
    #[error(transparent)]
    Compression(#[from] NotCompressed),
    /// An SDU arrived after the goodbye.
    #[error("it sent an sdu after the goodbye")]
    AfterGoodbye,
}

impl Violation {
    /// Returns the reason with which this side ends the link.
    pub fn goodbye(&self) -> Goodbye {
        match self {
            Self::Sdu(error) if error.is_of_path() => Goodbye::LostOrDamaged,
            _ => Goodbye::ProtocolError,
        }
    }
}

/// The content of a received SDU, after its batch was queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A batch that can be taken from that lane.
    Batch(Lane),
    /// The peer has acknowledged that total, in bytes.
    Ack(u16),
    /// The peer has stopped that lane (`true`) or restarted it (`false`).
    Stopped(Lane, bool),
    /// The peer ends the link, with the code of its reason. Batches that arrived before can still be taken.
    Goodbye(u8),
    /// The peer has set or requests a connection interval, in units of 1.25 ms.
    Interval(u16),
}

/// The receiving side of a lane.
#[derive(Default)]
struct InLane {
    queue: VecDeque<Vec<u8>>,
    /// The cost of the queued batches in credits.
    bytes: usize,
    received: Count,
    is_stopped: bool,
}

/// The receiving side of a link.
pub struct Receiver {
    lanes: [InLane; LANES],
    acks: Acks,
    /// Signals for the peer. The signal that stops a lane precedes the acknowledgement of the batch that filled it, so that
    /// the peer sends at most one more window on that lane.
    signals: VecDeque<Content<'static>>,
    mtu: usize,
    window: usize,
    opener: Opener,
    is_finished: bool,
}

impl Receiver {
    /// Creates the receiving side of a new link. `mtu` is the largest batch, and `window` what this side accepts
    /// unacknowledged, both in bytes. `opener` verifies the SDUs of the peer.
    pub fn new(mtu: usize, window: u16, opener: Opener) -> Self {
        Self {
            lanes: Default::default(),
            acks: Acks::new(window),
            signals: VecDeque::new(),
            mtu,
            window: usize::from(window),
            opener,
            is_finished: false,
        }
    }

    /// Handles a received SDU, and decrypts it in place.
    ///
    /// # Errors
    /// Fails if an earlier SDU was lost, or if this one is damaged, repeated or breaks the protocol. The link has to
    /// end then.
    pub fn on_sdu(&mut self, sdu: &mut [u8]) -> Result<Received, Violation> {
        if self.is_finished {
            return Err(Violation::AfterGoodbye);
        }
        let size = sdu.len().saturating_sub(self.opener.overhead());
        if size > self.mtu {
            let mtu = self.mtu;
            return Err(Violation::TooLarge { size, mtu });
        }
        match self.opener.open(sdu)? {
            Content::Batch(lane, batch) => {
                self.on_batch(lane, batch)?;
                Ok(Received::Batch(lane))
            }
            Content::Ack(total) => Ok(Received::Ack(total)),
            Content::Stop(lane) => Ok(Received::Stopped(lane, true)),
            Content::Go(lane) => Ok(Received::Stopped(lane, false)),
            Content::Interval(units) => Ok(Received::Interval(units)),
            Content::Goodbye(reason) => {
                self.is_finished = true;
                Ok(Received::Goodbye(reason))
            }
        }
    }

    /// Takes the next batch of a lane, if there is one.
    pub fn take(&mut self, lane: Lane) -> Option<Vec<u8>> {
        let in_lane = self.lane(lane);
        let batch = in_lane.queue.pop_front()?;
        in_lane.bytes -= usize::from(cost(batch.len()));
        if in_lane.is_stopped && in_lane.bytes <= LOW_WATERMARK {
            in_lane.is_stopped = false;
            self.signals.push_back(Content::Go(lane));
        }
        Some(batch)
    }

    /// Takes the next batch of Zenoh's own handshake, which takes place on the first lane.
    ///
    /// # Errors
    /// Fails if a batch has arrived on another lane and none on the first. Zenoh reads no other lane until its handshake is
    /// complete, so the link would be blocked.
    pub fn take_handshake_batch(&mut self) -> Result<Option<Vec<u8>>, Violation> {
        if let Some(batch) = self.take(Lane::first()) {
            return Ok(Some(batch));
        }
        let elsewhere = Lane::all().find(|lane| !self.lane(*lane).queue.is_empty());
        elsewhere.map_or(Ok(None), |lane| Err(Violation::Handshake(lane)))
    }

    /// Returns whether a signal for the peer is waiting.
    pub fn has_signal(&self) -> bool {
        !self.signals.is_empty() || self.acks.is_due()
    }

    /// Takes the next signal for the peer.
    pub fn signal(&mut self) -> Option<Content<'static>> {
        let first = self.signals.pop_front();
        first.or_else(|| self.acks.due().map(Content::Ack))
    }

    /// Returns the counts of a lane.
    pub fn lane_report(&self, lane: Lane) -> InLaneReport {
        // A `Lane` is always less than LANES.
        let in_lane = &self.lanes[lane.index()];
        InLaneReport {
            received: in_lane.received,
            unread_bytes: in_lane.bytes,
        }
    }

    /// Queues a batch, and stops its lane if that is full.
    fn on_batch(&mut self, lane: Lane, batch: &[u8]) -> Result<(), Violation> {
        let cost = cost(batch.len());
        self.acks.on_received(cost)?;
        let max_bytes = HIGH_WATERMARK + self.mtu + self.window;
        let in_lane = self.lane(lane);
        if in_lane.bytes + usize::from(cost) > max_bytes {
            return Err(Violation::Stopped(lane));
        }
        in_lane.bytes += usize::from(cost);
        in_lane.received.count(batch.len());
        in_lane.queue.push_back(batch.to_vec());
        if in_lane.bytes > HIGH_WATERMARK && !in_lane.is_stopped {
            in_lane.is_stopped = true;
            self.signals.push_back(Content::Stop(lane));
        }
        Ok(())
    }

    fn lane(&mut self, lane: Lane) -> &mut InLane {
        // A `Lane` is always less than LANES.
        &mut self.lanes[lane.index()]
    }
}

//! Owns the receiving side: checks each SDU, sorts it by lane, and tells the sender what it has taken and when it holds
//! enough of a lane. What it holds is bounded by that.
use std::collections::VecDeque;

use super::{
    credits::{cost, Acks, CreditError},
    report::{Count, InLaneReport},
    sdu::{self, Content, SduError},
    Lane, HEADER, LANES,
};

/// Bytes of a lane that are held before its sender is stopped: a moment of a fast radio, while Zenoh is busy. Each batch counts
/// as its credits do, with what a queue needs for it, so that small ones take no more than large ones.
pub const HIGH_MARK: usize = 16_384;
/// Bytes of a lane at which its sender goes on.
const LOW_MARK: usize = HIGH_MARK / 2;

/// How the peer, or the way to it, broke the protocol. The link ends with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// The SDU itself.
    #[error(transparent)]
    Sdu(#[from] SduError),
    /// A batch over the link's MTU, in bytes.
    #[error("a batch of {size} bytes is over the mtu of {mtu}")]
    TooLarge {
        /// Its size.
        size: usize,
        /// The limit.
        mtu: usize,
    },
    /// The credits.
    #[error(transparent)]
    Credits(#[from] CreditError),
    /// A lane was stopped, and more came than could have been on its way.
    #[error("it goes on sending on lane {} that was stopped", .0.number())]
    Stopped(Lane),
    /// A batch on another lane than the first, before Zenoh's handshake was over.
    #[error("a batch came on lane {} during Zenoh's handshake, which takes place on lane 0", .0.number())]
    Handshake(Lane),
    /// Something after the goodbye.
    #[error("an sdu after the goodbye")]
    AfterBye,
}

/// What an SDU brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A batch, to be taken from that lane.
    Batch(Lane),
    /// The peer has taken that total.
    Ack(u16),
    /// The peer takes nothing more of that lane (`true`), or takes it again.
    Stopped(Lane, bool),
    /// The peer ends the link; what came before it may still be taken.
    Bye(u8),
}

#[derive(Default)]
struct InLane {
    queue: VecDeque<Vec<u8>>,
    /// What is in it, at its cost in credits.
    bytes: usize,
    received: Count,
    is_stopped: bool,
}

/// The receiving side of a link.
pub struct Receiver {
    lanes: [InLane; LANES],
    acks: Acks,
    /// Signals for the sender, a lane's before the acknowledgement of what filled it: what the peer sends of a stopped
    /// lane is then within one window.
    signals: VecDeque<Content<'static>>,
    mtu: usize,
    window: usize,
    number: u32,
    is_over: bool,
}

impl Receiver {
    /// `mtu`: of a batch, in bytes. `window`: the bytes this side takes unacknowledged.
    pub fn new(mtu: usize, window: u16) -> Self {
        Self {
            lanes: Default::default(),
            acks: Acks::new(window),
            signals: VecDeque::new(),
            mtu,
            window: usize::from(window),
            number: 0,
            is_over: false,
        }
    }

    /// An SDU arrived.
    pub fn on_sdu(&mut self, sdu: &[u8]) -> Result<Received, Violation> {
        if self.is_over {
            return Err(Violation::AfterBye);
        }
        let size = sdu.len().saturating_sub(HEADER);
        if size > self.mtu {
            let mtu = self.mtu;
            return Err(Violation::TooLarge { size, mtu });
        }
        let content = sdu::open(self.number, sdu)?;
        self.number = self.number.wrapping_add(1);
        match content {
            Content::Batch(lane, batch) => {
                self.on_batch(lane, batch)?;
                Ok(Received::Batch(lane))
            }
            Content::Ack(total) => Ok(Received::Ack(total)),
            Content::Stop(lane) => Ok(Received::Stopped(lane, true)),
            Content::Go(lane) => Ok(Received::Stopped(lane, false)),
            Content::Bye(reason) => {
                self.is_over = true;
                Ok(Received::Bye(reason))
            }
        }
    }

    /// The next batch of a lane.
    pub fn take(&mut self, lane: Lane) -> Option<Vec<u8>> {
        let inside = self.lane(lane);
        let batch = inside.queue.pop_front()?;
        inside.bytes -= usize::from(cost(batch.len()));
        if inside.is_stopped && inside.bytes <= LOW_MARK {
            inside.is_stopped = false;
            self.signals.push_back(Content::Go(lane));
        }
        Some(batch)
    }

    /// Returns the next batch of Zenoh's own handshake, which takes place on the first lane.
    ///
    /// # Errors
    /// Fails if nothing has come on that lane, but something on another: Zenoh reads no other lane until its handshake is
    /// over, so the link would stand still.
    pub fn take_of_handshake(&mut self) -> Result<Option<Vec<u8>>, Violation> {
        if let Some(batch) = self.take(Lane::first()) {
            return Ok(Some(batch));
        }
        let elsewhere = Lane::all().find(|lane| !self.lane(*lane).queue.is_empty());
        elsewhere.map_or(Ok(None), |lane| Err(Violation::Handshake(lane)))
    }

    /// Whether there is a signal for the peer.
    pub fn has_signal(&self) -> bool {
        !self.signals.is_empty() || self.acks.is_due()
    }

    /// The next signal for the peer.
    pub fn signal(&mut self) -> Option<Content<'static>> {
        let first = self.signals.pop_front();
        first.or_else(|| self.acks.due().map(Content::Ack))
    }

    /// What came on a lane, and what is held.
    pub fn lane_report(&self, lane: Lane) -> InLaneReport {
        // A `Lane` is always less than LANES.
        let inside = &self.lanes[lane.index()];
        InLaneReport {
            received: inside.received,
            held_bytes: inside.bytes,
        }
    }

    fn on_batch(&mut self, lane: Lane, batch: &[u8]) -> Result<(), Violation> {
        let cost = cost(batch.len());
        self.acks.on_received(cost)?;
        let most = HIGH_MARK + self.mtu + self.window;
        let inside = self.lane(lane);
        if inside.bytes + usize::from(cost) > most {
            return Err(Violation::Stopped(lane));
        }
        inside.bytes += usize::from(cost);
        inside.received.count(batch.len());
        inside.queue.push_back(batch.to_vec());
        if inside.bytes > HIGH_MARK && !inside.is_stopped {
            inside.is_stopped = true;
            self.signals.push_back(Content::Stop(lane));
        }
        Ok(())
    }

    fn lane(&mut self, lane: Lane) -> &mut InLane {
        // A `Lane` is always less than LANES.
        &mut self.lanes[lane.index()]
    }
}

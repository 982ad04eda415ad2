//! Handles the sending side of a link: queues batches on their lanes and decides which SDU is sent next. The most urgent
//! lane that has a batch and may send goes first. There is no protection against starvation, as in Zenoh itself.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::usage::{keys::KeyTable, Size, Usage};
use super::{
    ack_timer::AckTimer,
    backlog::{self, Backlog, Limits, Queued},
    batch_kind::BatchKind,
    credits::{cost, Allowance, CreditError},
    flight::Flight,
    path::Path,
    report::{Count, MeanTime, OutLaneReport},
    sdu::{Content, Sealer, HEAD_BYTES},
    Lane, LANES,
};

/// The limits of what may wait on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// Number of bytes on all lanes together. It must suffice for the large messages that programs send at once: a message
    /// that does not fit blocks the session between the program and its router, including urgent messages. The limit
    /// does not apply to a lane with less than [`RESERVED_BYTES_PER_LANE`].
    pub bytes: usize,
    /// Time within which the messages that wait on a lane have to be sent for the lane to accept another one. Large messages
    /// do not count (`backlog`). Lane 0 is exempt, because Zenoh sends its declarations there with its routing tables locked.
    pub backlog: Duration,
    /// Time within which the batches that wait on a lane have to be sent for the lane to accept a message that may be
    /// dropped. (A lane without progress accepts one after a timeout: see `backlog`.) This time adds to the age of a stream's
    /// frames. If it is too short, the radio is idle until the next frame.
    pub droppable: Duration,
}

/// Number of bytes that each lane may hold regardless of the others, so that bulk does not occupy the room of urgent
/// messages.
pub const RESERVED_BYTES_PER_LANE: usize = 65_536;
/// Number of bytes that may wait before a droppable message while the rate of the link is not known.
const INITIAL_DROPPABLE_BYTES: f64 = 4000.0;

/// A batch that waits to be sent, encoded as an SDU without its trailer.
struct Waiting {
    sdu: Vec<u8>,
    kind: BatchKind,
    since: Instant,
    /// Whether the batch counts towards the lane's backlog.
    counts: bool,
}

/// The sending side of a lane.
struct OutLane {
    queue: VecDeque<Waiting>,
    bytes: usize,
    backlog: Backlog,
    /// Whether the peer has stopped the lane.
    is_stopped: bool,
    /// The part of the window that the lane leaves to more urgent ones, in bytes.
    reserve: u16,
    sent: Count,
    /// How long the batches have waited to be sent.
    wait: MeanTime,
    abandoned: u64,
}

impl OutLane {
    fn push(&mut self, waiting: Waiting, now: Instant) {
        self.bytes += waiting.bytes();
        self.backlog.queue(&mut self.queue, waiting, now);
    }

    /// Withdraws the waiting fragments of the message whose fragments were queued last.
    fn abandon_message(&mut self) {
        let (bytes, abandoned) = (&mut self.bytes, &mut self.abandoned);
        self.backlog.abandon(
            &mut self.queue,
            |_| true,
            |waiting| {
                *bytes -= waiting.bytes();
                *abandoned += 1;
            },
        );
    }

    /// Returns the cost of the next SDU; `None` if there is none or the peer has stopped the lane.
    fn next_cost(&self) -> Option<u16> {
        let next = self.queue.front().filter(|_| !self.is_stopped);
        next.map(Waiting::cost)
    }
}

impl Queued for Waiting {
    fn kind(&self) -> BatchKind {
        self.kind
    }

    fn cost(&self) -> usize {
        usize::from(Waiting::cost(self))
    }

    fn counts(&mut self) -> &mut bool {
        &mut self.counts
    }
}

impl Waiting {
    /// Returns the approximate memory that the SDU occupies.
    fn bytes(&self) -> usize {
        Self::bytes_of(self.sdu.len())
    }

    fn bytes_of(sdu_bytes: usize) -> usize {
        sdu_bytes + size_of::<Self>()
    }

    fn cost(&self) -> u16 {
        cost(self.sdu.len() - HEAD_BYTES)
    }
}

/// The kind of the SDU that is sent next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// An acknowledgement, or a signal that stops or restarts a lane.
    Signal,
    /// A batch of that lane, which has more room once the batch is sent.
    Batch(Lane),
    /// The goodbye, after which nothing is sent.
    Goodbye,
}

/// The result of an attempt to send an SDU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// The SDU was sent.
    Sdu(Next),
    /// There is nothing to send, or nothing may be sent now.
    Nothing,
    /// The channel has no room for the SDU.
    NoRoom,
}

/// How far the closing of a link has progressed.
enum End {
    NotYet,
    /// Nothing more is accepted. Contains the goodbye, which is sent last.
    Closing(Vec<u8>),
    /// The goodbye was sent.
    Finished,
}

impl End {
    fn closing(reason: u8) -> Self {
        Self::Closing(Content::Goodbye(reason).encode())
    }
}

/// The sending side of a link.
pub struct Scheduler {
    lanes: [OutLane; LANES],
    signals: VecDeque<Vec<u8>>,
    end: End,
    bounds: Bounds,
    allowance: Allowance,
    flight: Flight,
    ack_timer: AckTimer,
    path: Path,
    sealer: Sealer,
    /// The SDU that is being sealed, kept for its memory.
    sealed: Vec<u8>,
    /// The keys that Zenoh has declared on the link, and what was sent for each.
    keys: KeyTable,
    usage: Usage,
}

impl Scheduler {
    /// Creates the sending side of a new link. `mtu` is the largest batch, and `window` what the peer accepts
    /// unacknowledged, both in bytes. `sealer` seals the SDUs.
    pub fn new(bounds: Bounds, mtu: usize, window: u16, sealer: Sealer) -> Self {
        let allowance = Allowance::new(window);
        // Each lane leaves a part of the window to the more urgent ones. Otherwise they would wait until bulk is
        // acknowledged.
        let step = allowance.window() / 4 / LANES as u16;
        Self {
            lanes: std::array::from_fn(|number| OutLane {
                queue: VecDeque::new(),
                bytes: 0,
                backlog: Backlog::default(),
                is_stopped: false,
                reserve: step * number as u16,
                sent: Count::default(),
                wait: MeanTime::default(),
                abandoned: 0,
            }),
            signals: VecDeque::new(),
            end: End::NotYet,
            bounds,
            flight: Flight::new(cost(mtu), allowance.window()),
            ack_timer: AckTimer::new(allowance.window()),
            allowance,
            path: Path::default(),
            sealer,
            sealed: Vec::new(),
            keys: KeyTable::default(),
            usage: Usage::default(),
        }
    }

    /// Queues a batch on its lane. Returns `false` if there is no room or the link is closing; offer the batch again when
    /// something was sent, or at [`Scheduler::retry_at`].
    ///
    /// An empty batch is not sent. Zenoh writes one when it abandons a message half-way; the waiting fragments of that
    /// message are then withdrawn.
    pub fn push(&mut self, lane: Lane, batch: &[u8], now: Instant) -> bool {
        if batch.is_empty() {
            self.lane(lane).abandon_message();
            return true;
        }
        let kind = BatchKind::of(batch);
        let limits = self.limits(lane);
        let total: usize = self.lanes.iter().map(|out| out.bytes).sum();
        let max_bytes = self.bounds.bytes;
        let is_closing = !matches!(self.end, End::NotYet);
        let (out, size) = (self.lane(lane), Waiting::bytes_of(HEAD_BYTES + batch.len()));
        let fits = out.bytes + size <= RESERVED_BYTES_PER_LANE || total + size <= max_bytes;
        let is_accepted = !is_closing && fits && out.backlog.accepts(kind, out.bytes, limits, now);
        if is_accepted {
            let waiting = Waiting {
                sdu: Content::Batch(lane, batch).encode(),
                kind,
                since: now,
                counts: false,
            };
            out.push(waiting, now);
        }
        is_accepted
    }

    /// Returns when to offer a batch again that [`Scheduler::push`] did not accept, even if nothing is sent until then.
    /// Returns `None` if the batch is accepted only after something was sent.
    pub fn retry_at(&self, lane: Lane, batch: &[u8], now: Instant) -> Option<Instant> {
        // A `Lane` is always less than LANES.
        let backlog = &self.lanes[lane.index()].backlog;
        backlog
            .overdue_at(BatchKind::of(batch))
            .filter(|at| *at > now)
    }

    /// Queues a signal to the peer, which is sent before all batches.
    pub fn signal(&mut self, signal: Content<'static>) {
        self.signals.push_back(signal.encode());
    }

    /// Handles an acknowledgement of `total` bytes since the link began.
    ///
    /// # Errors
    /// Fails if the peer cannot have received that total.
    pub fn on_ack(&mut self, total: u16, now: Instant) -> Result<(), CreditError> {
        let new = self.allowance.on_ack(total)?;
        let unacknowledged = self.allowance.unacknowledged();
        self.ack_timer.on_ack(new, unacknowledged, now);
        let round_trip = self.flight.on_ack(total, now);
        self.path.on_ack(u32::from(new), round_trip, now);
        Ok(())
    }

    /// Records that the peer has stopped or restarted a lane.
    pub fn on_stopped(&mut self, lane: Lane, is_stopped: bool) {
        self.lane(lane).is_stopped = is_stopped;
    }

    /// Begins to close the link: sends what is queued, then a goodbye with the code `reason`. Nothing more is accepted.
    pub fn close(&mut self, reason: u8) {
        if matches!(self.end, End::NotYet) {
            self.end = End::closing(reason);
        }
    }

    /// Gives the next SDU to `send`, if there is one. `send` returns whether it was sent. If not, the SDU stays queued, and
    /// something more urgent may be sent before it.
    ///
    /// # Errors
    /// Those of `send`.
    pub fn send<E>(
        &mut self,
        now: Instant,
        send: impl FnOnce(&[u8]) -> Result<bool, E>,
    ) -> Result<Sent, E> {
        let Some(next) = self.choose() else {
            return Ok(Sent::Nothing);
        };
        let mut sealed = std::mem::take(&mut self.sealed);
        sealed.clear();
        sealed.extend_from_slice(self.sdu_of(next));
        let sent = self.sealer.seal(&mut sealed, send);
        self.sealed = sealed;
        if !sent? {
            return Ok(Sent::NoRoom);
        }
        self.on_sent(next, now);
        Ok(Sent::Sdu(next))
    }

    /// Returns when the link ends unless the peer acknowledges something, or `None` if no acknowledgement is due.
    pub fn ack_deadline(&self) -> Option<Instant> {
        self.ack_timer.deadline()
    }

    fn on_sent(&mut self, sent: Next, now: Instant) {
        match sent {
            Next::Signal => {
                if let Some(signal) = self.signals.pop_front() {
                    // The peer's credits do not limit signals.
                    let bytes = signal.len() - HEAD_BYTES + self.sealer.overhead();
                    self.usage.on_own(
                        Size {
                            bytes: bytes as u64,
                            cost: 0,
                        },
                        now,
                    );
                }
            }
            Next::Goodbye => self.end = End::Finished,
            Next::Batch(lane) => {
                // A `Lane` is always less than LANES.
                let out = &mut self.lanes[lane.index()];
                if let Some(batch) = out.queue.pop_front() {
                    out.sent.count(batch.sdu.len() - HEAD_BYTES);
                    out.wait.add(now.saturating_duration_since(batch.since));
                    out.bytes -= batch.bytes();
                    if batch.counts {
                        out.backlog.on_sent(usize::from(batch.cost()), now);
                    }
                    let (cost, allowance) = (batch.cost(), &mut self.allowance);
                    allowance.spend(cost);
                    self.flight.on_sent(lane, cost, allowance.sent(), now);
                    self.ack_timer.on_sent(allowance.unacknowledged(), now);
                    self.path.on_sent(now);
                    let zenoh = &batch.sdu[HEAD_BYTES..];
                    let size = Size {
                        bytes: (zenoh.len() + self.sealer.overhead()) as u64,
                        cost: cost.into(),
                    };
                    self.usage.on_batch(&self.keys, lane, zenoh, size, now);
                }
                if self.is_empty() {
                    self.path.on_idle();
                }
            }
        }
    }

    /// Ends the link at once: discards what is queued, and sends a goodbye with the code `reason` next, unless one was sent
    /// already.
    pub fn abort(&mut self, reason: u8) {
        if matches!(self.end, End::Finished) {
            return;
        }
        self.signals.clear();
        for out in &mut self.lanes {
            out.queue.clear();
            out.bytes = 0;
            out.backlog = Backlog::default();
        }
        self.ack_timer.stop();
        self.end = End::closing(reason);
    }

    /// Returns what was sent on a lane, and what waits.
    pub fn lane_report(&self, lane: Lane, now: Instant) -> OutLaneReport {
        // A `Lane` is always less than LANES.
        let out = &self.lanes[lane.index()];
        let oldest = out.queue.front().map(|waiting| waiting.since);
        let unsent_bytes = out.bytes - out.queue.len() * Waiting::bytes_of(HEAD_BYTES);
        OutLaneReport {
            sent: out.sent,
            waiting: Count {
                sdus: out.queue.len() as u64,
                bytes: out.bytes as u64,
            },
            unsent_bytes: unsent_bytes as u64,
            oldest: oldest.map(|since| now.saturating_duration_since(since)),
            delay: (out.wait.get().zip(self.path.round_trip())).map(|(wait, trip)| wait + trip),
            backlog_bytes: out.backlog.bytes() as u64,
            abandoned_sdus: out.abandoned,
            is_stopped: out.is_stopped,
        }
    }

    /// Returns the number of bytes in flight, and the current limit for it.
    pub fn in_flight(&self) -> (u16, u16) {
        (self.allowance.unacknowledged(), self.flight.limit())
    }

    /// Returns the number of bytes that may wait on a lane before the lane accepts another message that must arrive. Large
    /// messages do not count.
    pub fn backlog_limit_bytes(&self) -> usize {
        backlog::limit_bytes(self.path.rate_bytes_per_s(), self.bounds.backlog)
    }

    /// Returns the measured properties of the path to the peer.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the keys that Zenoh has declared on the link.
    pub fn keys(&mut self) -> &mut KeyTable {
        &mut self.keys
    }

    /// Returns what was sent for each key.
    pub fn usage(&mut self) -> &mut Usage {
        &mut self.usage
    }

    /// Decides which SDU is sent next: signals first, then the most urgent batch that may be sent, then the goodbye.
    fn choose(&self) -> Option<Next> {
        if matches!(self.end, End::Finished) {
            return None;
        }
        if !self.signals.is_empty() {
            return Some(Next::Signal);
        }
        let may_send = |lane: &Lane| {
            let out = &self.lanes[lane.index()];
            let has_room = |cost| {
                self.allowance.can_spend(cost, out.reserve) && self.flight.has_room(*lane, cost)
            };
            out.next_cost().is_some_and(has_room)
        };
        let batch = Lane::all().find(may_send).map(Next::Batch);
        let may_end = || matches!(self.end, End::Closing(_)) && self.is_empty();
        batch.or_else(|| may_end().then_some(Next::Goodbye))
    }

    /// Returns the SDU that [`Scheduler::choose`] has chosen.
    fn sdu_of(&self, next: Next) -> &[u8] {
        let sdu = match next {
            Next::Signal => self.signals.front(),
            Next::Goodbye => match &self.end {
                End::Closing(goodbye) => Some(goodbye),
                End::NotYet | End::Finished => None,
            },
            // A `Lane` is always less than LANES.
            Next::Batch(lane) => {
                (self.lanes[lane.index()].queue.front()).map(|waiting| &waiting.sdu)
            }
        };
        sdu.map_or(&[], Vec::as_slice)
    }

    fn is_empty(&self) -> bool {
        self.lanes.iter().all(|out| out.queue.is_empty())
    }

    /// Returns how many bytes may wait before a droppable message, at the measured rate.
    fn droppable_bytes(&self) -> usize {
        let within_limit = |rate| rate * self.bounds.droppable.as_secs_f64();
        let rate = self.path.rate_bytes_per_s();
        rate.map_or(INITIAL_DROPPABLE_BYTES, within_limit) as usize
    }

    fn limits(&self, lane: Lane) -> Limits {
        Limits {
            droppable_bytes: self.droppable_bytes(),
            backlog_bytes: match lane.number() {
                0 => usize::MAX,
                _ => self.backlog_limit_bytes(),
            },
        }
    }

    fn lane(&mut self, lane: Lane) -> &mut OutLane {
        // A `Lane` is always less than LANES.
        &mut self.lanes[lane.index()]
    }
}

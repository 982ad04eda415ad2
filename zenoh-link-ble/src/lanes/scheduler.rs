//! Owns the sending side: what waits on which lane, and which SDU goes next. The most urgent lane that has something and
//! may send goes first; nothing else counts. Zenoh has no rule against starvation, and neither has this.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{
    ack_timer::AckTimer,
    backlog::{self, Backlog, Counting},
    credits::{cost, Allowance, CreditError},
    flight::Flight,
    path::Path,
    piece::Piece,
    report::{Count, OutLaneReport},
    sdu::{self, Content},
    Lane, HEADER, LANES,
};

/// How much may wait on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// On all lanes together, in bytes. It must hold the large messages that programs send at once: what does not fit holds
    /// up the program's connection to its router, and its urgent messages with it. A lane with less than [`OWN_BYTES`] does
    /// not count it.
    pub bytes: usize,
    /// The time that the messages on a lane may take to be sent before the lane takes another one. Large messages do not
    /// count (`backlog`), and neither does lane 0: Zenoh sends its declarations there, with its routing tables locked.
    pub backlog: Duration,
    /// A message that may be dropped is taken while what waits before it is sent within this time, or when nothing has
    /// moved on its lane for a while (`backlog`). It adds to the age of a stream's frames; too little, and the radio waits
    /// for the next frame.
    pub droppable: Duration,
}

/// Bytes that each lane may hold whatever the others hold, so that no bulk takes the room of what is urgent.
pub const OWN_BYTES: usize = 65_536;
/// Bytes of droppable traffic that may wait while the rate of the link is not known.
const DROPPABLE_AT_FIRST: f64 = 4000.0;

struct Waiting {
    sdu: Vec<u8>,
    piece: Piece,
    since: Instant,
    /// It counts towards the lane's backlog.
    counts: bool,
}

/// How much may wait on a lane before another message, in bytes.
#[derive(Clone, Copy)]
struct Limits {
    droppable_bytes: usize,
    backlog_bytes: usize,
}

struct OutLane {
    queue: VecDeque<Waiting>,
    bytes: usize,
    backlog: Backlog,
    /// The peer holds enough of it.
    is_stopped: bool,
    allowed_rest: u16,
    sent: Count,
    given_up: u64,
}

impl OutLane {
    /// Returns whether the lane takes that piece, as far as what waits before it is concerned.
    fn may_begin(&self, piece: Piece, limits: Limits, now: Instant) -> bool {
        let has_room = match piece {
            Piece::Next => true,
            Piece::Whole { is_droppable } | Piece::First { is_droppable } => match is_droppable {
                true => self.bytes <= limits.droppable_bytes,
                false => self.backlog.has_room(limits.backlog_bytes),
            },
        };
        let is_overdue = || self.backlog.overdue_at(piece).is_some_and(|at| at <= now);
        has_room || is_overdue()
    }

    fn push(&mut self, mut waiting: Waiting, now: Instant) {
        let cost = usize::from(waiting.cost());
        let counting = self.backlog.on_taken(waiting.piece, cost, now);
        waiting.counts = counting == Counting::Counts;
        if counting == Counting::ExemptsMessage {
            self.exempt_last_message();
        }
        self.bytes += waiting.bytes();
        self.queue.push_back(waiting);
    }

    /// Stops counting the pieces that wait of the message whose pieces came last.
    fn exempt_last_message(&mut self) {
        for waiting in self.queue.iter_mut().rev() {
            if matches!(waiting.piece, Piece::Whole { .. }) {
                break;
            }
            if waiting.counts {
                waiting.counts = false;
                self.backlog.on_discounted(usize::from(waiting.cost()));
            }
            if matches!(waiting.piece, Piece::First { .. }) {
                break;
            }
        }
    }

    /// Takes back what still waits of the message whose fragments came last.
    fn give_up_message(&mut self) {
        while let Some(last) = self.queue.back() {
            if matches!(last.piece, Piece::Whole { .. }) {
                break;
            }
            self.bytes -= last.bytes();
            if last.counts {
                self.backlog.on_discounted(usize::from(last.cost()));
            }
            self.given_up += 1;
            let is_first = matches!(last.piece, Piece::First { .. });
            self.queue.pop_back();
            if is_first {
                break;
            }
        }
    }

    /// What the next SDU costs, unless the peer takes nothing of this lane.
    fn next_cost(&self) -> Option<u16> {
        let next = self.queue.front().filter(|_| !self.is_stopped);
        next.map(Waiting::cost)
    }
}

impl Waiting {
    /// What it takes of the memory, nearly.
    fn bytes(&self) -> usize {
        Self::bytes_of(self.sdu.len())
    }

    fn bytes_of(sdu_bytes: usize) -> usize {
        sdu_bytes + size_of::<Self>()
    }

    fn cost(&self) -> u16 {
        cost(self.sdu.len() - HEADER)
    }
}

/// What kind of SDU is sent next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// It says what this side has taken, or takes.
    Signal,
    /// A batch: once it is sent its lane has more room.
    Batch(Lane),
    /// The goodbye; nothing follows.
    Bye,
}

/// How far a link's end has come.
enum End {
    NotYet,
    /// Nothing more is taken; this is the goodbye.
    Closing(Vec<u8>),
    /// The goodbye is sent.
    Over,
}

impl End {
    fn closing(reason: u8) -> Self {
        Self::Closing(Content::Bye(reason).encode())
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
    number: u32,
}

impl Scheduler {
    /// `mtu`: the largest batch, in bytes. `window`: the bytes that the peer takes unacknowledged.
    pub fn new(bounds: Bounds, mtu: usize, window: u16) -> Self {
        let allowance = Allowance::new(window);
        // Each lane leaves something to the more urgent ones, which else would wait for an acknowledgement of bulk.
        let step = allowance.window() / 4 / LANES as u16;
        Self {
            lanes: std::array::from_fn(|number| OutLane {
                queue: VecDeque::new(),
                bytes: 0,
                backlog: Backlog::default(),
                is_stopped: false,
                allowed_rest: step * number as u16,
                sent: Count::default(),
                given_up: 0,
            }),
            signals: VecDeque::new(),
            end: End::NotYet,
            bounds,
            flight: Flight::new(cost(mtu), allowance.window()),
            ack_timer: AckTimer::new(allowance.window()),
            allowance,
            path: Path::default(),
            number: 0,
        }
    }

    /// Puts a batch on its lane. `false`: there is no room, ask again when something went out; or the link is closing.
    /// An empty batch goes nowhere: Zenoh writes one when it gives up a message half-way, and what waits of that message
    /// is of no use any more.
    pub fn push(&mut self, lane: Lane, batch: &[u8], now: Instant) -> bool {
        if batch.is_empty() {
            self.lane(lane).give_up_message();
            return true;
        }
        let piece = Piece::of(batch);
        let limits = self.limits(lane);
        let all: usize = self.lanes.iter().map(|out| out.bytes).sum();
        let most = self.bounds.bytes;
        let is_closing = !matches!(self.end, End::NotYet);
        let (out, size) = (self.lane(lane), Waiting::bytes_of(HEADER + batch.len()));
        let fits = out.bytes + size <= OWN_BYTES || all + size <= most;
        let is_taken = !is_closing && fits && out.may_begin(piece, limits, now);
        if is_taken {
            let waiting = Waiting {
                sdu: Content::Batch(lane, batch).encode(),
                piece,
                since: now,
                counts: false,
            };
            out.push(waiting, now);
        }
        is_taken
    }

    /// Returns when to offer a batch again that [`Scheduler::push`] did not take, even if nothing went out until then.
    pub fn ask_again_at(&self, lane: Lane, batch: &[u8], now: Instant) -> Option<Instant> {
        // A `Lane` is always less than LANES.
        let backlog = &self.lanes[lane.index()].backlog;
        backlog.overdue_at(Piece::of(batch)).filter(|at| *at > now)
    }

    /// Sends a signal to the peer, before all batches.
    pub fn signal(&mut self, signal: Content<'static>) {
        self.signals.push_back(signal.encode());
    }

    /// The peer has taken that total.
    pub fn on_ack(&mut self, total: u16, now: Instant) -> Result<(), CreditError> {
        let new = self.allowance.on_ack(total)?;
        let unacknowledged = self.allowance.unacknowledged();
        self.ack_timer.on_ack(new, unacknowledged, now);
        let took = self.flight.on_ack(total, now);
        self.path.on_ack(new, took, now);
        Ok(())
    }

    /// The peer takes nothing more of that lane, or takes it again.
    pub fn on_stopped(&mut self, lane: Lane, is_stopped: bool) {
        self.lane(lane).is_stopped = is_stopped;
    }

    /// The link ends: what waits goes out, then the goodbye.
    pub fn close(&mut self, reason: u8) {
        if matches!(self.end, End::NotYet) {
            self.end = End::closing(reason);
        }
    }

    /// What to send now. It is the next as long as [`Scheduler::on_sent`] does not say that it went; something more urgent
    /// that comes before takes its place.
    pub fn peek(&mut self) -> Option<(Next, &[u8])> {
        let next = self.choose()?;
        let number = self.number;
        let sdu = self.sdu_of(next)?;
        sdu::seal(number, sdu);
        Some((next, sdu))
    }

    /// Returns when the link ends unless the peer acknowledges something; `None` if no acknowledgement is due.
    pub fn ack_deadline(&self) -> Option<Instant> {
        self.ack_timer.deadline()
    }

    /// What [`Scheduler::peek`] gave out last, and nothing was put in since, went out.
    pub fn on_sent(&mut self, sent: Next, now: Instant) {
        self.number = self.number.wrapping_add(1);
        match sent {
            Next::Signal => drop(self.signals.pop_front()),
            Next::Bye => self.end = End::Over,
            Next::Batch(lane) => {
                let out = self.lane(lane);
                if let Some(batch) = out.queue.pop_front() {
                    out.sent.count(batch.sdu.len() - HEADER);
                    out.bytes -= batch.bytes();
                    if batch.counts {
                        out.backlog.on_sent(usize::from(batch.cost()), now);
                    }
                    let (cost, allowance) = (batch.cost(), &mut self.allowance);
                    allowance.spend(cost);
                    self.flight.on_sent(lane, cost, allowance.sent(), now);
                    self.ack_timer.on_sent(allowance.unacknowledged(), now);
                    self.path.on_sent(now);
                }
                if self.is_empty() {
                    self.path.on_idle();
                }
            }
        }
    }

    /// The link ends at once: what waits is thrown away, and the goodbye is next, unless one was sent.
    pub fn abort(&mut self, reason: u8) {
        if matches!(self.end, End::Over) {
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

    /// What went out on a lane, and what waits.
    pub fn lane_report(&self, lane: Lane, now: Instant) -> OutLaneReport {
        // A `Lane` is always less than LANES.
        let out = &self.lanes[lane.index()];
        let oldest = out.queue.front().map(|waiting| waiting.since);
        OutLaneReport {
            sent: out.sent,
            waiting: Count {
                sdus: out.queue.len() as u64,
                bytes: out.bytes as u64,
            },
            oldest: oldest.map(|since| now.saturating_duration_since(since)),
            backlog_bytes: out.backlog.bytes() as u64,
            given_up_sdus: out.given_up,
            is_stopped: out.is_stopped,
        }
    }

    /// What is on its way, and how much of it may be, in bytes.
    pub fn on_its_way(&self) -> (u16, u16) {
        (self.allowance.unacknowledged(), self.flight.limit())
    }

    /// Bytes that may wait on a lane before it takes another message that must arrive; large messages do not count.
    pub fn backlog_limit_bytes(&self) -> usize {
        backlog::limit_bytes(self.path.rate_bytes_per_s(), self.bounds.backlog)
    }

    /// What was measured of the way to the peer.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn choose(&self) -> Option<Next> {
        if matches!(self.end, End::Over) {
            return None;
        }
        if !self.signals.is_empty() {
            return Some(Next::Signal);
        }
        let may_send = |lane: &Lane| {
            let out = &self.lanes[lane.index()];
            let has_room = |cost| {
                self.allowance.has(cost, out.allowed_rest) && self.flight.has_room(*lane, cost)
            };
            out.next_cost().is_some_and(has_room)
        };
        let batch = Lane::all().find(may_send).map(Next::Batch);
        let may_end = || matches!(self.end, End::Closing(_)) && self.is_empty();
        batch.or_else(|| may_end().then_some(Next::Bye))
    }

    fn sdu_of(&mut self, next: Next) -> Option<&mut [u8]> {
        match next {
            Next::Signal => self.signals.front_mut().map(Vec::as_mut_slice),
            Next::Bye => match &mut self.end {
                End::Closing(bye) => Some(bye),
                End::NotYet | End::Over => None,
            },
            Next::Batch(lane) => {
                let waiting = self.lane(lane).queue.front_mut()?;
                Some(&mut waiting.sdu)
            }
        }
    }

    fn is_empty(&self) -> bool {
        self.lanes.iter().all(|out| out.queue.is_empty())
    }

    fn droppable_bytes(&self) -> usize {
        let in_time = |rate| rate * self.bounds.droppable.as_secs_f64();
        let rate = self.path.rate_bytes_per_s();
        rate.map_or(DROPPABLE_AT_FIRST, in_time) as usize
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

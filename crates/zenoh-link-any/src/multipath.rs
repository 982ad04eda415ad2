//! A link over several paths, without I/O: decides which path carries which bytes, and when.
//!
//! Each lane is a stream of bytes with positions, so that any path can carry any part of it, and any part twice.
//!
//! ```text
//! push(lane, batch) -> OutLane -> next_frame(path) -> path -> on_frame(path) -> InLane -> take(lane)
//! ```
mod options;
mod outcome;

use std::{
    collections::BTreeMap,
    ops::Range,
    time::{Duration, Instant},
};

use link_lanes::{
    lanes::{
        backlog::{self, Limits},
        batch_kind::BatchKind,
        report::Count,
        scheduler::RESERVED_BYTES_PER_LANE,
        sdu, Lane, LANES,
    },
    usage::{keys::KeyTable, Size, Usage, UsageReport},
};

use crate::{
    frame::{self, Frame, DATA_HEAD_BYTES},
    in_lane::InLane,
    out_lane::OutLane,
    path::{Medium, Path, PathState},
    proof::SEAL_BYTES,
};

pub use crate::out_lane::LaneReport;

pub use self::{
    options::{Bounds, Options},
    outcome::{Change, End, PathReport, Switch, SwitchReason, Violation},
};

/// The least urgent lane whose small batches every live path carries: Zenoh's `InteractiveHigh`. Declarations travel as
/// `Control`, and therefore on every path as well: they are few, and everything else waits for them.
pub const LAST_COPIED_LANE: u8 = 2;
/// The largest batch that every path carries, in bytes.
const MAX_COPIED_BYTES: usize = 512;
/// A batch of Zenoh that only shows that the session is alive has this size, on lane 0.
const KEEP_ALIVE_BYTES: usize = 1;
/// The number of bytes by which paths are compared: a path is better if it carries them sooner.
const COMPARED_BYTES: usize = 16_384;
/// A path replaces the primary one only if it needs less than this share of its time.
const BETTER: f64 = 0.7;
/// How long it has to be better.
const BETTER_FOR: Duration = Duration::from_millis(300);
/// How long nothing may arrive from a peer that has the link: longer than the time between two of Zenoh's keep-alives, 2.5 s.
const SILENCE: Duration = Duration::from_secs(3);
/// Number of bytes before a frame on a network, which contain its length.
const FRAME_LENGTH_BYTES: usize = 2;
/// The largest backlog of a lane, in bytes. More would occupy memory without making a fast network faster.
const MAX_BACKLOG_BYTES: usize = 2_500_000;

/// A path of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PathId(pub u32);

/// A primary path that works no more.
#[derive(Clone, Copy, Debug)]
struct LostPath {
    medium: Medium,
    reason: SwitchReason,
    /// Since when frames wait for their acknowledgement.
    since: Instant,
}

impl LostPath {
    fn of(path: &Path, reason: SwitchReason, now: Instant) -> Self {
        Self {
            medium: path.medium,
            reason,
            since: path.waiting_since().unwrap_or(now),
        }
    }
}

/// A link over several paths.
#[derive(Debug)]
pub struct Multipath {
    options: Options,
    out: [OutLane; LANES],
    into: [InLane; LANES],
    paths: BTreeMap<PathId, Path>,
    next_path: u32,
    primary: Option<PathId>,
    /// The primary path that works no more, until another one replaces it.
    lost: Option<LostPath>,
    /// The last rate of each medium that the link has used, in bytes per second.
    rates: BTreeMap<Medium, f64>,
    /// The path that is better than the primary one, and since when.
    better: Option<(PathId, Instant)>,
    /// The number of the last change of the stopped lanes, of this side and of the peer.
    change: u8,
    peer_change: u8,
    /// Since when no path works.
    silent_since: Option<Instant>,
    /// When a frame arrived for the last time.
    received_at: Instant,
    /// The code of the reason with which this side ends the link.
    closing: Option<u8>,
    end: Option<End>,
    switches: u64,
    last_switch: Option<Switch>,
    wakeups: u64,
    /// Number of batches and bytes that were accepted, and taken.
    sent: Count,
    received: Count,
    /// The keys that Zenoh has declared on the link, and what was sent for each, over each medium.
    keys: KeyTable,
    usage: BTreeMap<Medium, Usage>,
}

impl Multipath {
    /// Creates a link without paths.
    pub fn new(options: Options, now: Instant) -> Self {
        Self {
            options,
            out: Default::default(),
            into: Default::default(),
            paths: BTreeMap::new(),
            next_path: 0,
            primary: None,
            lost: None,
            rates: BTreeMap::new(),
            better: None,
            change: 0,
            peer_change: 0,
            silent_since: Some(now),
            received_at: now,
            closing: None,
            end: None,
            switches: 0,
            last_switch: None,
            wakeups: 0,
            sent: Count::default(),
            received: Count::default(),
            keys: KeyTable::default(),
            usage: BTreeMap::new(),
        }
    }

    /// Adds a path. The first one of a link `is_proven`, because the link was opened on it; another one is used after it has
    /// answered. `max_frame` is the size of the largest frame, in bytes.
    pub fn add_path(
        &mut self,
        medium: Medium,
        max_frame: usize,
        is_proven: bool,
        now: Instant,
    ) -> PathId {
        let id = PathId(self.next_path);
        self.next_path += 1;
        let mut path = Path::new(medium, max_frame, is_proven, now);
        // The peer may have missed which lanes are stopped.
        path.ack_by(now);
        self.paths.insert(id, path);
        self.on_paths_changed(now);
        id
    }

    /// Removes a path. Others carry what it has not delivered.
    pub fn remove_path(&mut self, id: PathId, now: Instant) {
        if let Some(mut path) = self.paths.remove(&id) {
            if self.primary == Some(id) {
                self.lost = Some(LostPath::of(&path, SwitchReason::Ended, now));
            }
            self.resend(path.give_up());
            self.on_paths_changed(now);
        }
    }

    /// Offers a batch to its lane. Returns `false` if there is no room. An empty batch withdraws what was not sent yet of the
    /// message whose fragments came last.
    pub fn push(&mut self, lane: Lane, batch: &[u8], now: Instant) -> bool {
        if self.closing.is_some() || self.end.is_some() {
            return false;
        }
        if batch.is_empty() {
            self.out[lane.index()].abandon_message();
            return true;
        }
        let kind = BatchKind::of(batch);
        let memory: usize = self.out.iter().map(OutLane::memory).sum();
        let limits = self.limits(lane);
        let max_bytes = self.options.bounds.bytes;
        let out = &mut self.out[lane.index()];
        let has_memory = memory + batch.len() <= max_bytes
            || out.memory() + batch.len() <= RESERVED_BYTES_PER_LANE;
        if !has_memory || !out.accepts(kind, limits, now) {
            return false;
        }
        out.push(batch, kind, is_copied(lane, batch), now);
        self.sent.count(batch.len());
        true
    }

    /// Returns when to offer a batch again that was refused, if nothing else happens before.
    pub fn retry_at(&self, lane: Lane, batch: &[u8], now: Instant) -> Option<Instant> {
        let at = self.out[lane.index()].overdue_at(BatchKind::of(batch));
        at.filter(|at| *at > now)
    }

    /// Takes the next batch of a lane.
    pub fn take(&mut self, lane: Lane, now: Instant) -> Option<Vec<u8>> {
        let batch = self.into[lane.index()].take()?;
        self.received.count(batch.len());
        self.update_stopped(lane, now);
        Some(batch)
    }

    /// Handles a frame that has arrived on a path.
    ///
    /// # Errors
    /// Fails if the peer violates the protocol: see [`Violation`] for what has to end.
    pub fn on_frame(
        &mut self,
        id: PathId,
        bytes: &[u8],
        now: Instant,
    ) -> Result<Change, Violation> {
        let Some(path) = self.paths.get_mut(&id) else {
            return Ok(Change::Nothing);
        };
        self.received_at = now;
        match frame::decode(bytes)? {
            Frame::Data {
                lane,
                offset,
                is_lazy,
                bytes: data,
            } => {
                path.on_received(bytes.len(), is_lazy, now);
                let has_batch = self.into[lane.index()]
                    .on_bytes(offset, data, self.options.max_batch)
                    .map_err(|error| Violation::Lane { lane, error })?;
                self.update_stopped(lane, now);
                Ok(match has_batch {
                    true => Change::Batch(lane),
                    false => Change::Nothing,
                })
            }
            Frame::Ack {
                frames,
                stopped,
                change,
            } => {
                let arrived = path.on_ack(frames, now)?;
                for (lane, range) in arrived.into_iter().filter_map(|sent| sent.data) {
                    self.out[lane.index()].on_acked(&range, now);
                }
                // Acknowledgements overtake each other on different paths.
                if change.wrapping_sub(self.peer_change) as i8 >= 0 {
                    self.peer_change = change;
                    for lane in Lane::all() {
                        self.out[lane.index()].is_stopped = stopped >> lane.number() & 1 == 1;
                    }
                }
                self.on_paths_changed(now);
                Ok(Change::Credits)
            }
            Frame::Ping => {
                path.on_received(bytes.len(), false, now);
                path.ack_by(now);
                Ok(Change::Nothing)
            }
            Frame::Offer(_) => Ok(Change::Nothing),
            Frame::Close(reason) => {
                self.end.get_or_insert(End::ClosedByPeer(reason));
                Ok(Change::Credits)
            }
        }
    }

    /// Writes the next frame for a path into `frame`, which it clears. Returns its lane, or `None` if there is no frame now. It
    /// contains no data of lanes that are less urgent than `least_urgent`.
    pub fn next_frame(
        &mut self,
        id: PathId,
        least_urgent: Lane,
        frame: &mut Vec<u8>,
        now: Instant,
    ) -> Option<Lane> {
        frame.clear();
        self.on_time(now);
        let is_primary = self.primary == Some(id);
        let is_finished = self.is_finished();
        let path = self.paths.get_mut(&id)?;
        if path.ack_at().is_some_and(|at| at <= now) {
            let frames = path.on_ack_sent();
            let stopped = stopped_mask(&self.into);
            let change = self.change;
            Frame::Ack {
                frames,
                stopped,
                change,
            }
            .encode(frame);
            path.sent_bytes += frame.len() as u64;
            let medium = path.medium;
            self.count_own(medium, frame.len(), now);
            return Some(Lane::first());
        }
        if let (Some(reason), true) = (self.closing, is_finished) {
            if path.start_close() {
                Frame::Close(reason).encode(frame);
                self.on_close_sent();
                return Some(Lane::first());
            }
            return None;
        }
        if path.ping_at().is_some_and(|at| at <= now) {
            Frame::Ping.encode(frame);
            path.on_ping_sent(frame.len(), now);
            let medium = path.medium;
            self.count_own(medium, frame.len(), now);
            return Some(Lane::first());
        }
        if path.is_live() {
            for lane in Lane::all().take_while(|lane| *lane <= least_urgent) {
                if self.data_frame(id, lane, is_primary, frame, now) {
                    return Some(lane);
                }
            }
        }
        let path = self.paths.get_mut(&id)?;
        // A path without room is not idle: it waits for acknowledgements, which show its rate.
        if least_urgent == Lane::last() && path.has_room(false) {
            path.on_idle();
        }
        None
    }

    /// Writes the next data frame of a lane for a live path.
    fn data_frame(
        &mut self,
        id: PathId,
        lane: Lane,
        is_primary: bool,
        frame: &mut Vec<u8>,
        now: Instant,
    ) -> bool {
        let out = &mut self.out[lane.index()];
        let Some(path) = self.paths.get_mut(&id) else {
            return false;
        };
        let is_urgent = lane.number() <= LAST_COPIED_LANE;
        if !path.has_room(is_urgent) {
            return false;
        }
        let max = path.max_frame - DATA_HEAD_BYTES;
        let lost = out.next_lost(max).filter(|_| is_primary || is_urgent);
        let (range, is_new) = match lost {
            Some(range) => {
                path.resent_bytes += range.end - range.start;
                (range, false)
            }
            None => match path.next_copy(lane, |range| out.is_acked(range)) {
                Some(copy) if path.may_copy((copy.end - copy.start) as usize, now) => {
                    path.on_copy_sent(lane, &copy);
                    path.resent_bytes += copy.end - copy.start;
                    (copy, false)
                }
                _ => match out.next_new(max, !is_primary) {
                    Some(range) => (range, true),
                    None => return false,
                },
            },
        };
        let is_keep_alive = lane == Lane::first() && range.end - range.start <= 2;
        frame::data_head(lane, frame::truncated(range.start), is_keep_alive, frame);
        out.append_to(&range, frame);
        out.on_sent(&range);
        path.on_sent(Some((lane, range.clone())), frame.len(), is_keep_alive, now);
        let overhead = overhead(path.medium, self.options.is_encrypted);
        if let Some(usage) = self.usage.get_mut(&path.medium) {
            let begun: u64 = out.starting_in(&range).map(|(_, bytes)| bytes).sum();
            // The frame begins with the rest of the batch before, if there is one. Bytes that are added to the frame count with that.
            let rest = range.end - range.start - begun;
            let mut size = Size {
                bytes: rest + (DATA_HEAD_BYTES + overhead) as u64,
                cost: rest + DATA_HEAD_BYTES as u64,
            };
            if rest > 0 {
                usage.on_more(lane, std::mem::take(&mut size), now);
            }
            for (batch, bytes) in out.starting_in(&range) {
                size.bytes += bytes;
                size.cost += bytes;
                usage.on_batch(&self.keys, lane, batch, std::mem::take(&mut size), now);
            }
        }
        if is_new {
            let copied = out.copied_in(&range);
            let others = self.paths.iter_mut().filter(|(other, _)| **other != id);
            for (_, other) in others.filter(|(_, other)| other.is_live()) {
                for range in &copied {
                    other.add_copy(lane, range.clone());
                    self.wakeups += 1;
                }
            }
        }
        true
    }

    /// Handles the time: paths whose acknowledgements are missing, and the end of the lease.
    pub fn on_time(&mut self, now: Instant) {
        for path in self.paths.values_mut() {
            if path.suspect_at().is_some_and(|at| at <= now) {
                path.suspect(now);
            }
        }
        let primary = self.primary;
        let others = self
            .paths
            .iter_mut()
            .filter(|(id, _)| primary != Some(**id));
        for (_, path) in others {
            path.expire_rate(now);
        }
        self.on_paths_changed(now);
        if let Some(since) = self.silent_since {
            if now >= since + self.options.lease {
                self.end.get_or_insert(End::NoPath(self.options.lease));
            }
        }
    }

    /// Returns when [`Self::next_frame`] has something to do for a path, if nothing else happens before.
    pub fn next_time(&self, id: PathId) -> Option<Instant> {
        let path = self.paths.get(&id);
        let own = path
            .into_iter()
            .flat_map(|path| [path.ack_at(), path.ping_at()]);
        let suspect = self.paths.values().filter_map(Path::suspect_at);
        let lease = self.silent_since.map(|since| since + self.options.lease);
        let better = self.better.map(|(_, since)| since + BETTER_FOR);
        own.flatten()
            .chain(suspect)
            .chain(lease)
            .chain(better)
            .min()
    }

    /// Returns when a path has to send an acknowledgement.
    pub fn ack_at(&self, id: PathId) -> Option<Instant> {
        self.paths.get(&id)?.ack_at()
    }

    /// Returns a number that changes whenever other paths than the one of a call may have something to send.
    pub fn wakeups(&self) -> u64 {
        self.wakeups
    }

    /// Ends the link after everything has arrived. `reason` is the code for the peer.
    pub fn close(&mut self, reason: u8) {
        self.closing.get_or_insert(reason);
    }

    /// Returns why the link has ended.
    pub fn end(&self) -> Option<End> {
        self.end
    }

    /// Returns whether the peer evidently has the link, too: a path works, and something has arrived recently.
    pub fn is_shared(&self, now: Instant) -> bool {
        self.paths.values().any(Path::is_live) && now < self.received_at + SILENCE
    }

    /// Returns the paths.
    pub fn paths(&self) -> impl Iterator<Item = (PathId, PathReport)> + '_ {
        self.paths.iter().map(|(id, path)| {
            let report = PathReport {
                medium: path.medium,
                state: path.state(),
                is_primary: self.primary == Some(*id),
                rate_bytes_per_s: path.rate_bytes_per_s(),
                is_measured: path.is_measured(),
                round_trip: path.round_trip(),
                sent_bytes: path.sent_bytes,
                resent_bytes: path.resent_bytes,
            };
            (*id, report)
        })
    }

    /// Returns the path that carries the bulk.
    pub fn primary(&self) -> Option<PathId> {
        self.primary
    }

    /// Returns how often the path that carries the bulk was replaced: by another one, or by itself after it had been silent.
    pub fn switches(&self) -> u64 {
        self.switches
    }

    /// Returns the last of these changes.
    pub fn last_switch(&self) -> Option<Switch> {
        self.last_switch
    }

    /// Returns the batches sent and received.
    pub fn traffic(&self) -> (Count, Count) {
        (self.sent, self.received)
    }

    /// Returns the lanes that were used, the most urgent first.
    pub fn lanes(&self) -> Vec<(Lane, LaneReport)> {
        let lanes = Lane::all().map(|lane| (lane, self.out[lane.index()].report()));
        lanes
            .filter_map(|(lane, report)| Some((lane, report?)))
            .collect()
    }

    /// Returns the number of bytes that arrived a second time.
    pub fn repeated_bytes(&self) -> u64 {
        self.into.iter().map(InLane::repeated_bytes).sum()
    }

    /// Returns the keys that Zenoh has declared on the link.
    pub fn keys(&mut self) -> &mut KeyTable {
        &mut self.keys
    }

    /// Returns what was sent over each medium for each key, which is counted from the first question on until `keep` after the last
    /// one.
    pub fn usage(&mut self, now: Instant, keep: Duration) -> BTreeMap<Medium, UsageReport> {
        let media = self.paths.values().map(|path| path.medium);
        for medium in media {
            self.usage.entry(medium).or_default();
        }
        let usage = self.usage.iter_mut();
        usage
            .map(|(medium, usage)| (*medium, usage.ask(now, keep)))
            .collect()
    }

    /// Counts a frame of the link itself.
    fn count_own(&mut self, medium: Medium, frame_bytes: usize, now: Instant) {
        let bytes = frame_bytes + overhead(medium, self.options.is_encrypted);
        if let Some(usage) = self.usage.get_mut(&medium) {
            let size = Size {
                bytes: bytes as u64,
                cost: frame_bytes as u64,
            };
            usage.on_own(size, now);
        }
    }

    fn on_close_sent(&mut self) {
        let mut live = self.paths.values().filter(|path| path.is_live());
        if live.all(Path::is_close_sent) {
            self.end.get_or_insert(End::Closed);
        }
    }

    /// Returns whether everything has arrived.
    fn is_finished(&self) -> bool {
        self.out.iter().all(OutLane::is_empty)
    }

    fn resend(&mut self, lost: Vec<(Lane, Range<u64>)>) {
        self.wakeups += u64::from(!lost.is_empty());
        for (lane, range) in lost {
            self.out[lane.index()].on_lost(range);
        }
    }

    /// Notifies the peer on every path which lanes are stopped, if that has changed.
    fn update_stopped(&mut self, lane: Lane, now: Instant) {
        if self.into[lane.index()].update_stopped() {
            self.change = self.change.wrapping_add(1);
            self.wakeups += 1;
            for path in self.paths.values_mut() {
                path.ack_by(now);
            }
        }
    }

    /// Chooses the path that carries the bulk.
    fn on_paths_changed(&mut self, now: Instant) {
        if !self.paths.values().any(Path::is_live) {
            // Without another path, one that answers at all is used at once.
            for path in self.paths.values_mut().filter(|path| path.has_answered()) {
                path.recover();
            }
        }
        if self.paths.values().any(Path::is_live) {
            // Without another path, nothing is sent again: a path delivers what it carries while it exists.
            let suspected = self
                .paths
                .values_mut()
                .filter(|path| path.state() == PathState::Suspected);
            let late = suspected.flat_map(Path::give_up).collect();
            self.resend(late);
        }
        let live = self.paths.iter().filter(|(_, path)| path.is_live());
        for (_, path) in live.clone() {
            self.rates.insert(path.medium, path.rate_bytes_per_s());
        }
        let best = live.min_by_key(|(_, path)| path.time_for(COMPARED_BYTES));
        let best = best.map(|(id, path)| (*id, path.time_for(COMPARED_BYTES)));
        let primary = self.primary.and_then(|id| self.paths.get(&id));
        if let Some(silent) = primary.filter(|path| !path.is_live()) {
            let lost = LostPath::of(silent, SwitchReason::Silent, now);
            self.lost.get_or_insert(lost);
        }
        let Some((best, best_time)) = best else {
            self.silent_since.get_or_insert(now);
            self.set_primary(None, now);
            return;
        };
        self.silent_since = None;
        let current = self.primary.and_then(|id| self.paths.get(&id));
        let Some(current) = current.filter(|path| path.is_live()) else {
            self.set_primary(Some(best), now);
            return;
        };
        let limit = current.time_for(COMPARED_BYTES).mul_f64(BETTER);
        if self.primary == Some(best) || best_time >= limit {
            self.better = None;
            return;
        }
        let since = match self.better {
            Some((id, since)) if id == best => since,
            _ => now,
        };
        self.better = Some((best, since));
        if now >= since + BETTER_FOR {
            self.lost = Some(LostPath {
                medium: current.medium,
                reason: SwitchReason::Faster,
                since: now,
            });
            self.set_primary(Some(best), now);
        }
    }

    fn set_primary(&mut self, to: Option<PathId>, now: Instant) {
        self.better = None;
        if self.primary == to {
            return;
        }
        self.primary = to;
        self.wakeups += 1;
        let path = to.and_then(|id| self.paths.get(&id));
        let Some(path) = path else { return };
        // The first path of a link replaces none.
        if let Some(lost) = self.lost.take() {
            self.switches += 1;
            self.last_switch = Some(Switch {
                previous: lost.medium,
                current: path.medium,
                reason: lost.reason,
                gap: now.saturating_duration_since(lost.since),
                at: now,
            });
        }
    }

    /// Returns how much may wait on a lane: what the slowest medium of the link carries in the time of the bounds, even if it has
    /// no path now.
    fn limits(&self, lane: Lane) -> Limits {
        let slowest = self.rates.values().copied().reduce(f64::min);
        let primary = self.primary.and_then(|id| self.paths.get(&id));
        let droppable_rate = primary.map_or(0.0, Path::rate_bytes_per_s);
        let bounds = &self.options.bounds;
        Limits {
            droppable_bytes: (droppable_rate * bounds.droppable.as_secs_f64()) as usize,
            backlog_bytes: match lane.number() {
                0 => usize::MAX,
                _ => backlog::limit_bytes(slowest, bounds.backlog).min(MAX_BACKLOG_BYTES),
            },
        }
    }
}

/// Returns the number of bytes that a medium adds to a frame.
fn overhead(medium: Medium, is_encrypted: bool) -> usize {
    match medium {
        Medium::Bluetooth => sdu::overhead(is_encrypted),
        Medium::Network => FRAME_LENGTH_BYTES + SEAL_BYTES,
    }
}

/// Returns whether every live path carries a batch.
fn is_copied(lane: Lane, batch: &[u8]) -> bool {
    let is_keep_alive = lane == Lane::first() && batch.len() <= KEEP_ALIVE_BYTES;
    lane.number() <= LAST_COPIED_LANE && batch.len() <= MAX_COPIED_BYTES && !is_keep_alive
}

/// Returns which lanes are stopped, as bits.
fn stopped_mask(lanes: &[InLane; LANES]) -> u8 {
    Lane::all().fold(0, |mask, lane| {
        mask | u8::from(lanes[lane.index()].is_stopped()) << lane.number()
    })
}

#[cfg(test)]
mod simulation;
#[cfg(test)]
mod tests;

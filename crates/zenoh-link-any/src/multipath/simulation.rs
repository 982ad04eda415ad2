//! Two ends of a link and the paths between them, in virtual time.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use link_lanes::lanes::Lane;

use super::{Medium, Multipath, Options, PathId};
use crate::frame::{decode, Frame};

/// The properties of a path.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quality {
    pub(super) medium: Medium,
    pub(super) bytes_per_s: f64,
    pub(super) latency: Duration,
    /// A radio that was idle sends its next frame at a multiple of this time.
    pub(super) interval: Duration,
    pub(super) max_frame: usize,
    /// How much the sending side accepts before it has left.
    pub(super) buffer: Duration,
}

pub(super) const BLUETOOTH: Quality = Quality {
    medium: Medium::Bluetooth,
    bytes_per_s: 34_000.0,
    latency: Duration::from_millis(2),
    interval: Duration::from_millis(30),
    max_frame: 736,
    buffer: Duration::from_millis(2),
};

pub(super) const NETWORK: Quality = Quality {
    medium: Medium::Network,
    bytes_per_s: 3_000_000.0,
    latency: Duration::from_millis(2),
    interval: Duration::ZERO,
    max_frame: 8_196,
    buffer: Duration::from_millis(3),
};

/// One direction of a path.
#[derive(Default)]
struct Wire {
    frames: VecDeque<(Instant, Vec<u8>)>,
    busy_until: Option<Instant>,
}

/// A path. It exists at each end until that end has noticed its loss.
struct SimPath {
    quality: Quality,
    ids: [Option<PathId>; 2],
    /// From each end to the other.
    wires: [Wire; 2],
    /// While set, nothing arrives; afterwards everything does.
    jammed_until: Option<Instant>,
    /// Nothing arrives any more.
    is_cut: bool,
    /// When each end notices that.
    notices: [Option<Instant>; 2],
}

pub(super) struct World {
    pub(super) now: Instant,
    start: Instant,
    pub(super) ends: [Multipath; 2],
    paths: Vec<SimPath>,
    frame: Vec<u8>,
    /// Number of bytes that each medium has carried.
    pub(super) carried: [u64; 2],
    /// The data frames that have arrived at the second end.
    pub(super) arrivals: Vec<Arrival>,
}

/// A data frame that has arrived.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    pub(super) at: Duration,
    pub(super) medium: Medium,
    pub(super) lane: Lane,
    /// The position of its first byte.
    pub(super) position: u32,
}

impl World {
    pub(super) fn new() -> Self {
        let (options, now) = (Options::default(), Instant::now());
        Self {
            now,
            start: now,
            ends: [Multipath::new(options, now), Multipath::new(options, now)],
            paths: Vec::new(),
            frame: Vec::new(),
            carried: [0; 2],
            arrivals: Vec::new(),
        }
    }

    /// Connects the two ends by a path, and returns its index.
    pub(super) fn connect(&mut self, quality: Quality) -> usize {
        let is_proven = self.paths.iter().all(|path| path.ids == [None, None]);
        let now = self.now;
        let add =
            |end: &mut Multipath| end.add_path(quality.medium, quality.max_frame, is_proven, now);
        let [one, two] = &mut self.ends;
        self.paths.push(SimPath {
            quality,
            ids: [Some(add(one)), Some(add(two))],
            wires: Default::default(),
            jammed_until: None,
            is_cut: false,
            notices: [None; 2],
        });
        self.paths.len() - 1
    }

    /// Lets nothing arrive on a path for that time. Afterwards everything arrives.
    pub(super) fn jam(&mut self, path: usize, time: Duration) {
        self.paths[path].jammed_until = Some(self.now + time);
    }

    /// Lets nothing arrive on a path any more. Each end notices it after its time.
    pub(super) fn cut(&mut self, path: usize, noticed: [Duration; 2]) {
        let path = &mut self.paths[path];
        path.is_cut = true;
        path.notices = noticed.map(|after| Some(self.now + after));
        for wire in &mut path.wires {
            wire.frames.clear();
        }
    }

    /// Advances to the next event, at most to `limit`.
    pub(super) fn step(&mut self, limit: Instant) {
        self.pump();
        let mut next = limit;
        for path in &self.paths {
            for (end, id) in self.ends.iter().zip(path.ids) {
                let at = id.and_then(|id| end.next_time(id));
                next = at.map_or(next, |at| next.min(at));
            }
            let resumes = path.jammed_until.filter(|at| *at > self.now);
            for wire in &path.wires {
                let arrives = wire.frames.front().map(|(at, _)| *at);
                next = arrives.map_or(next, |at| next.min(resumes.map_or(at, |r| r.max(at))));
                // A wire that is busy has room again before it is idle.
                let room = wire
                    .busy_until
                    .and_then(|at| at.checked_sub(path.quality.buffer));
                let room = room.filter(|at| *at > self.now && resumes.is_none());
                next = room.map_or(next, |at| next.min(at));
            }
            next = path.notices.into_iter().flatten().fold(next, Instant::min);
            next = resumes.map_or(next, |at| next.min(at));
        }
        // Timers that are due are handled by `pump`; without progress, time must pass.
        self.now = next.max(self.now + Duration::from_micros(50)).min(limit);
        self.deliver();
    }

    /// Returns the time from the beginning of the simulation.
    pub(super) fn time_of(&self, at: Instant) -> Duration {
        at - self.start
    }

    /// Runs until `until`.
    pub(super) fn run(&mut self, time: Duration) {
        let until = self.now + time;
        while self.now < until {
            self.step(until);
        }
        self.pump();
    }

    fn deliver(&mut self) {
        let now = self.now;
        for path in &mut self.paths {
            for (end, notice) in path.notices.iter_mut().enumerate() {
                if notice.is_some_and(|at| at <= now) {
                    *notice = None;
                    if let Some(id) = path.ids[end].take() {
                        self.ends[end].remove_path(id, now);
                    }
                }
            }
            if path.jammed_until.is_some_and(|at| at > now) {
                continue;
            }
            path.jammed_until = None;
            for from in 0..2 {
                while path.wires[from]
                    .frames
                    .front()
                    .is_some_and(|(at, _)| *at <= now)
                {
                    let (_, frame) = path.wires[from].frames.pop_front().expect("checked");
                    if let (0, Ok(Frame::Data { lane, offset, .. })) = (from, decode(&frame)) {
                        self.arrivals.push(Arrival {
                            at: now - self.start,
                            medium: path.quality.medium,
                            lane,
                            position: offset,
                        });
                    }
                    if let Some(id) = path.ids[1 - from] {
                        let end = &mut self.ends[1 - from];
                        end.on_frame(id, &frame, now).expect("no violation");
                    }
                }
            }
        }
    }

    /// Lets each end send what the wires have room for.
    fn pump(&mut self) {
        let now = self.now;
        for end in 0..2 {
            self.ends[end].on_time(now);
            for path in &mut self.paths {
                let Some(id) = path.ids[end] else { continue };
                let quality = path.quality;
                let wire = &mut path.wires[end];
                loop {
                    let busy_until = wire.busy_until.map_or(now, |at| at.max(now));
                    if busy_until > now + quality.buffer {
                        break;
                    }
                    if path.jammed_until.is_some() && !wire.frames.is_empty() {
                        break;
                    }
                    let sender = &mut self.ends[end];
                    if sender
                        .next_frame(id, Lane::last(), &mut self.frame, now)
                        .is_none()
                    {
                        break;
                    }
                    let time = self.frame.len() as f64 / quality.bytes_per_s;
                    let mut starts = busy_until;
                    if busy_until == now && !quality.interval.is_zero() {
                        let nanos = (now - self.start).as_nanos();
                        let interval = quality.interval.as_nanos();
                        let at = nanos.div_ceil(interval) * interval;
                        starts = self.start + Duration::from_nanos(at as u64);
                    }
                    let left = starts + Duration::from_secs_f64(time);
                    wire.busy_until = Some(left);
                    self.carried[usize::from(quality.medium == Medium::Network)] +=
                        self.frame.len() as u64;
                    if path.is_cut {
                        continue;
                    }
                    let arrives = left + quality.latency;
                    wire.frames.push_back((arrives, self.frame.clone()));
                }
            }
        }
    }
}

/// Sends numbered messages on all lanes, and verifies that each arrives once and in order.
#[derive(Default)]
pub(super) struct Conversation {
    sent: [u64; 8],
    received: [u64; 8],
    /// The ages of small messages on arrival, by lane.
    pub(super) ages: [Vec<Duration>; 8],
}

const BULK_BYTES: usize = 1_400;

impl Conversation {
    /// Offers a small message to each lane.
    pub(super) fn send_small(&mut self, world: &mut World, from: usize) {
        for lane in Lane::all() {
            let size = 24 + usize::from(lane.number());
            self.offer(world, from, lane, size);
        }
    }

    /// Fills a lane with larger messages, as far as it accepts them.
    pub(super) fn fill(&mut self, world: &mut World, from: usize, lane: Lane) {
        while self.offer(world, from, lane, BULK_BYTES) {}
    }

    /// Offers a message to a lane, and returns whether it was accepted.
    pub(super) fn offer(
        &mut self,
        world: &mut World,
        from: usize,
        lane: Lane,
        size: usize,
    ) -> bool {
        let number = self.sent[lane.index()];
        let at = (world.now - world.start).as_nanos() as u64;
        let mut batch = vec![0xff; size];
        batch[1..9].copy_from_slice(&number.to_le_bytes());
        batch[9..17].copy_from_slice(&at.to_le_bytes());
        let is_accepted = world.ends[from].push(lane, &batch, world.now);
        self.sent[lane.index()] += u64::from(is_accepted);
        is_accepted
    }

    /// Takes what has arrived.
    pub(super) fn receive(&mut self, world: &mut World, at: usize) {
        for lane in Lane::all() {
            while let Some(batch) = world.ends[at].take(lane, world.now) {
                let number = |at: usize| {
                    let bytes = batch[at..at + 8].try_into().expect("8 bytes");
                    u64::from_le_bytes(bytes)
                };
                let index = lane.index();
                assert_eq!(number(1), self.received[index], "lane {index}");
                self.received[index] += 1;
                if batch.len() < BULK_BYTES {
                    let sent = world.start + Duration::from_nanos(number(9));
                    self.ages[index].push(world.now - sent);
                }
            }
        }
    }

    pub(super) fn is_complete(&self) -> bool {
        self.sent == self.received
    }

    pub(super) fn received(&self) -> u64 {
        self.received.iter().sum()
    }
}

//! Owns the sending end of a stream: which frames are wanted, at which step, and what goes with them.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::{
    feedback::Feedback,
    groups::Groups,
    ladder::{Ladder, Level},
    notice::{Notice, MAX_NAMES},
    offset::Millis,
    pacer::Pacer,
    picture::Photographs,
    rate::{Rate, RateLimits},
    status::{in_words, GroupStatus, ReceiverStatus, Status},
    Group,
};
use crate::core::{
    attachment::{Attachment, Sent},
    name::Name,
};

/// A receiver that says nothing for so long is gone; where it is asked to say something less often, three times as long.
const GONE_AFTER: Duration = Duration::from_secs(6);
/// Who listens where it should not any more is told again.
const REMIND: Duration = Duration::from_secs(1);
/// The most receivers of a stream that are listened to.
pub const MAX_RECEIVERS: usize = 256;
/// The most of them at one robot, so that no robot takes the places of the others.
pub const MAX_RECEIVERS_OF_ROBOT: usize = 16;
/// How long a receiver counts that has not reported a frame.
const NEWCOMER: Duration = Duration::from_secs(3);
/// How long a robot that is to listen elsewhere still counts where it was; where feedback comes less often, three times as
/// long as between two reports.
const LEAVES_WITHIN: Duration = Duration::from_secs(3);
/// The slowest robot of the slow group holds the others down to this share of what the next one gets through, and no
/// further.
const HELD_TO: f64 = 1.0 / 3.0;

/// How a stream is sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Whether quality, size and rate follow what gets through.
    pub mode: Mode,
    /// Frames per second that are wanted even of the smallest; default 5.
    pub least_frames_per_s: f64,
    /// Not more frames per second than that; default 15.
    pub most_frames_per_s: f64,
    /// Bytes per second.
    pub rates: RateLimits,
    /// How pictures with a quality are written.
    pub photographs: Photographs,
    /// The steps, best first; none: [`super::ladder::PICTURES`].
    pub steps: Vec<Level>,
    /// How often receivers are to say what comes; zero: never. Default half a second; 20 to 30 bytes each time.
    pub feedback: Duration,
}

/// Whether frames change with what gets through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Frames go as they are given.
    Fixed,
    /// Frames are as good as what gets through allows.
    #[default]
    Adaptive,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            mode: Mode::Adaptive,
            least_frames_per_s: 5.0,
            most_frames_per_s: 15.0,
            rates: RateLimits::default(),
            photographs: Photographs::default(),
            steps: Vec::new(),
            feedback: Duration::from_millis(500),
        }
    }
}

impl Options {
    /// For frames that go as they are, at most so often.
    pub fn fixed(most_frames_per_s: f64) -> Self {
        Self {
            mode: Mode::Fixed,
            most_frames_per_s,
            feedback: Duration::from_secs(2),
            ..Self::default()
        }
    }

    /// For a sensor's values: as they are, as often as they come, and nothing comes back.
    pub fn sensor() -> Self {
        Self {
            feedback: Duration::ZERO,
            ..Self::fixed(1e6)
        }
    }
}

/// A frame that is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Job {
    /// For whom.
    pub group: Group,
    /// How to write it; `None`: as it is.
    pub level: Option<Level>,
}

#[derive(Debug)]
struct Lane {
    source: u16,
    next: u32,
    pacer: Pacer,
    ladder: Ladder,
    level: Option<Level>,
    /// Zenoh says whether anyone subscribes.
    has_subscribers: Option<bool>,
    frames: u64,
    bytes: u64,
    changes: u64,
}

#[derive(Debug)]
struct Known {
    rate: Rate,
    since: Instant,
    heard: Instant,
    says: Feedback,
    is_measured: bool,
}

/// One stream's.
#[derive(Debug)]
pub struct Sender {
    options: Options,
    clock: Millis,
    lanes: [Lane; 2],
    receivers: BTreeMap<(Name, u16), Known>,
    groups: Groups,
    polled: Instant,
    notice_at: Option<Instant>,
}

impl Sender {
    /// A stream begins; `source` is drawn for it, `unix_ms` is the time since 1970.
    pub fn new(options: Options, source: u16, unix_ms: u64, now: Instant) -> Self {
        let lane = |source| Lane {
            source,
            next: 0,
            pacer: Pacer::default(),
            ladder: Ladder::new(
                &options.steps,
                options.least_frames_per_s,
                options.most_frames_per_s,
            ),
            level: None,
            has_subscribers: None,
            frames: 0,
            bytes: 0,
            changes: 0,
        };
        Self {
            lanes: [lane(source), lane(source ^ 0x8000)],
            options,
            clock: Millis::new(now, unix_ms),
            receivers: BTreeMap::new(),
            groups: Groups::default(),
            polled: now,
            notice_at: None,
        }
    }

    /// There is a frame of so many pixels (of something else: bytes). What is to be made of it: nothing, if nobody
    /// listens or the last one is too near; then nothing has to be encoded.
    pub fn offer(&mut self, pixels: usize, now: Instant) -> Vec<Job> {
        self.poll(now);
        Group::ALL
            .into_iter()
            .filter_map(|group| self.offer_to(group, pixels, now))
            .collect()
    }

    fn offer_to(&mut self, group: Group, pixels: usize, now: Instant) -> Option<Job> {
        let is_adaptive = self.options.mode == Mode::Adaptive;
        let rate = self.rate_of(group);
        let is_wanted = match group {
            Group::Slow if !is_adaptive => false,
            _ => self.lanes[group.index()]
                .has_subscribers
                .unwrap_or(rate.is_some()),
        };
        let frames_per_s = self.options.most_frames_per_s;
        let first = self.options.rates.first;
        let lane = &mut self.lanes[group.index()];
        if !is_wanted {
            lane.ladder.forget();
            lane.level = None;
            return None;
        }
        if is_adaptive {
            let level = lane.ladder.level(pixels, rate.unwrap_or(first), now);
            lane.changes += u64::from(lane.level.is_some_and(|before| before != level));
            lane.level = Some(level);
        }
        let level = lane.level;
        lane.pacer
            .is_due(frames_per_s, now)
            .then_some(Job { group, level })
    }

    /// The frame of a job has become so many bytes, and goes now, with this.
    pub fn on_encoded(&mut self, job: Job, bytes: usize, now: Instant) -> Attachment {
        let rate = match self.options.mode {
            Mode::Fixed => f64::INFINITY,
            Mode::Adaptive => self.rate_of(job.group).unwrap_or(self.options.rates.first),
        };
        let lane = &mut self.lanes[job.group.index()];
        if let Some(level) = job.level {
            lane.ladder.on_encoded(level, bytes, now);
        }
        lane.pacer
            .on_sent(bytes, rate, self.options.most_frames_per_s, now);
        lane.frames += 1;
        lane.bytes += bytes as u64;
        let sequence = lane.next;
        lane.next = sequence.wrapping_add(1);
        Attachment {
            source: lane.source,
            sequence,
            sent: Sent::Low(self.clock.low(now)),
        }
    }

    /// Zenoh says whether anyone subscribes to a group's key.
    pub fn on_subscribers(&mut self, group: Group, has_subscribers: bool) {
        self.lanes[group.index()].has_subscribers = Some(has_subscribers);
    }

    /// Handles the feedback of a receiver of `robot`. That the robot sent it is certain, by its key; what it reports may be
    /// wrong or made up, and holds down the other robots within limits only.
    pub fn on_feedback(&mut self, robot: &Name, feedback: &Feedback, now: Instant) {
        let key = (robot.clone(), feedback.receiver);
        let of_robot = self
            .receivers
            .range((robot.clone(), 0)..=(robot.clone(), u16::MAX));
        let is_full =
            of_robot.count() >= MAX_RECEIVERS_OF_ROBOT || self.receivers.len() >= MAX_RECEIVERS;
        let is_known = self.receivers.contains_key(&key);
        if (is_full && !is_known) || !self.is_of_this_stream(feedback) {
            return;
        }
        let limits = self.options.rates;
        let known = self.receivers.entry(key).or_insert_with(|| Known {
            rate: Rate::new(limits, now),
            since: now,
            heard: now,
            says: *feedback,
            is_measured: false,
        });
        known.heard = now;
        known.says = *feedback;
        known.is_measured |= feedback.frames > 0;
        known.rate.on_feedback(feedback, now);
        // A new robot is where newcomers are to listen, or where it holds down fewer.
        let group = match feedback.group {
            Group::Main => self.join(),
            Group::Slow => Group::Slow,
        };
        self.groups.on_robot(robot, group);
        if self.options.mode == Mode::Adaptive && self.groups.of(robot) != Some(feedback.group) {
            self.notice_at.get_or_insert(now + REMIND);
        }
        self.poll(now);
    }

    /// Whether it reports frames that this program has sent, or none yet. What a receiver heard of an earlier program of
    /// this name says nothing of this one.
    fn is_of_this_stream(&self, feedback: &Feedback) -> bool {
        let is_newcomer = feedback.source == 0 && feedback.frames == 0;
        let was_sent = |lane: &Lane| {
            let ago = lane.next.wrapping_sub(1).wrapping_sub(feedback.last);
            lane.source == feedback.source && lane.frames > 0 && ago < u32::MAX / 2
        };
        is_newcomer || self.lanes.iter().any(was_sent)
    }

    /// What to put for all to know, if anything.
    pub fn poll_notice(&mut self, now: Instant) -> Option<Notice> {
        self.notice_at.filter(|&at| now >= at)?;
        self.notice_at = None;
        Some(self.notice(now))
    }

    /// The answer to whoever asks.
    pub fn notice(&self, now: Instant) -> Notice {
        let names = |group| {
            let names = self.groups.members(group).take(MAX_NAMES);
            names.map(|name| name.as_str().to_owned()).collect()
        };
        let is_parted = self.groups.members(Group::Slow).next().is_some();
        let is_moving = self
            .receivers
            .iter()
            .any(|((robot, _), known)| self.groups.of(robot) != Some(known.says.group));
        let (main, slow) = if is_parted || is_moving {
            (names(Group::Main), names(Group::Slow))
        } else {
            Default::default()
        };
        Notice {
            time_ms: self.clock.at(now),
            join: self.join(),
            feedback_ms: u32::try_from(self.options.feedback.as_millis()).unwrap_or(u32::MAX),
            main,
            slow,
        }
    }

    /// What is known of it.
    pub fn status(&self) -> Status {
        let groups = Group::ALL
            .into_iter()
            .filter_map(|group| self.group_status(group));
        let receivers = self
            .receivers
            .iter()
            .map(|((robot, receiver), known)| ReceiverStatus {
                robot: robot.as_str().to_owned(),
                receiver: *receiver,
                group: known.says.group,
                last: known.says.last,
                age_ms: known.says.age_ms,
                frames_per_s: f64::from(known.says.frames) * 1000.0
                    / f64::from(known.says.span_ms.max(1)),
                lost_share: known.rate.lost_share(),
                bytes_per_s: known.rate.bytes_per_s(),
                pace_bytes_per_s: known.says.pace_bytes_per_s,
            });
        Status {
            groups: groups.collect(),
            receivers: receivers.collect(),
        }
    }

    fn group_status(&self, group: Group) -> Option<GroupStatus> {
        let lane = &self.lanes[group.index()];
        let rate = self.rate_of(group);
        lane.has_subscribers
            .unwrap_or(rate.is_some())
            .then(|| GroupStatus {
                group,
                bytes_per_s: rate.unwrap_or(self.options.rates.first),
                level: lane.level,
                frame_bytes: match (lane.level, lane.frames) {
                    (Some(_), _) => lane.ladder.frame_bytes(),
                    (None, frames) => lane.bytes as f64 / frames.max(1) as f64,
                },
                frames: lane.frames,
                bytes: lane.bytes,
                changes: lane.changes,
                last_change: lane.level.and(lane.ladder.last_change()).map(in_words),
            })
    }

    /// Forgets who is gone, and parts or joins the rest.
    fn poll(&mut self, now: Instant) {
        if now.saturating_duration_since(self.polled) < Duration::from_millis(50) {
            return;
        }
        self.polled = now;
        let gone_after = GONE_AFTER.max(self.options.feedback * 3);
        self.receivers
            .retain(|_, known| now.saturating_duration_since(known.heard) < gone_after);
        self.receivers
            .values_mut()
            .for_each(|known| known.rate.poll(now));
        if self.options.mode == Mode::Adaptive && self.groups.update(&self.potentials(), now) {
            self.notice_at = Some(now);
        }
    }

    /// What each robot could get; who has not had a frame yet may be as good as any.
    fn potentials(&self) -> BTreeMap<Name, f64> {
        let enough = self.lanes[0]
            .ladder
            .most_bytes_per_s()
            .min(self.options.rates.most);
        let mut potentials = BTreeMap::new();
        for ((robot, _), known) in &self.receivers {
            let potential = if known.is_measured {
                known.rate.potential().min(enough)
            } else {
                f64::INFINITY
            };
            let least = potentials.entry(robot.clone()).or_insert(f64::INFINITY);
            *least = potential.min(*least);
        }
        let finite = potentials
            .values()
            .copied()
            .filter(|potential| potential.is_finite());
        let best = finite.fold(0.0, f64::max);
        potentials
            .values_mut()
            .for_each(|potential| *potential = potential.min(best));
        potentials
    }

    /// The least rate among the receivers that listen to a group's key or are to listen there.
    fn rate_of(&self, group: Group) -> Option<f64> {
        let now = self.polled;
        let leaves_within = LEAVES_WITHIN.max(self.options.feedback * 3);
        let is_there = |((robot, _), known): &(&(Name, u16), &Known)| {
            let is_leaving = self.groups.is_leaving(robot, group, leaves_within, now);
            let is_new = now.saturating_duration_since(known.since) < NEWCOMER;
            (self.groups.of(robot) == Some(group) || (is_leaving && known.says.group == group))
                && (known.is_measured || is_new)
        };
        let mut robots = BTreeMap::new();
        for ((robot, _), known) in self.receivers.iter().filter(is_there) {
            let least = robots.entry(robot).or_insert(f64::INFINITY);
            *least = known.rate.bytes_per_s().min(*least);
        }
        let mut rates: Vec<f64> = robots.into_values().collect();
        rates.sort_by(f64::total_cmp);
        let least = rates.first().copied()?;
        Some(match (group, rates.get(1)) {
            (Group::Slow, Some(next)) => least.max((next * HELD_TO).min(self.options.rates.first)),
            _ => least,
        })
    }

    /// Where a newcomer listens at first: not to frames that would fill a slow link for seconds.
    fn join(&self) -> Group {
        let first = self.options.rates.first;
        let is_heavy = self
            .rate_of(Group::Main)
            .is_some_and(|rate| rate > first * 2.0);
        if self.options.mode == Mode::Adaptive && is_heavy {
            Group::Slow
        } else {
            Group::Main
        }
    }
}

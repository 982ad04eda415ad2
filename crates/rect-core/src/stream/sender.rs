//! Implements the sender of a stream: decides which frames to send, at which step, and with which attachment.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

pub use super::options::{Mode, Options};
use super::{
    feedback::{Feedback, RECORDER},
    groups::Groups,
    job::Job,
    ladder::{Ladder, Step},
    notice::{Notice, MAX_NAMES},
    pacer::Pacer,
    rate::Rate,
    status::{in_words, GroupStatus, ReceiverStatus, Status, VideoStatus},
    video::Video,
    Group,
};
use crate::{
    clock::MillisecondClock,
    message::{
        attachment::{Attachment, Sent},
        payload::Payload,
    },
    name::Name,
    video::{self, bitstream},
};

/// How long a receiver may be silent before it is removed, but at least three feedback intervals.
const REMOVED_AFTER: Duration = Duration::from_secs(6);
/// The pause before the notice is published again after a report from the wrong group.
const REPEAT_NOTICE: Duration = Duration::from_secs(1);
/// The maximum number of receivers of a stream that are tracked.
pub const MAX_RECEIVERS: usize = 256;
/// The maximum number of receivers of one robot, so that no robot displaces the others.
pub const MAX_RECEIVERS_OF_ROBOT: usize = 16;
/// How long a new receiver that has not reported a frame yet limits the rate.
const NEWCOMER: Duration = Duration::from_secs(3);
/// The rate at which frames are sent until the first one is reported, so that they do not fill a queue in front of a
/// slow link. It is low because a receiver reports its first frame at once.
const UNREPORTED_BYTES_PER_S: f64 = 5e3;
/// How long this rate applies while no receiver has sent feedback. Stock Zenoh programs never do.
const UNREPORTED: Duration = Duration::from_secs(1);
/// How long it applies while receivers have sent feedback, and none has reported a frame.
const REPORTED_WITHIN: Duration = Duration::from_secs(10);
/// How long a robot that was moved to the other group still counts in its previous group, but at least three feedback
/// intervals.
const LEAVES_WITHIN: Duration = Duration::from_secs(3);
/// The slowest robot of the slow group limits the rate to no less than this share of the second slowest one's rate.
const MIN_SHARE_OF_NEXT: f64 = 1.0 / 3.0;

#[derive(Debug)]
struct GroupOutput {
    source: u16,
    next: u32,
    pacer: Pacer,
    ladder: Ladder,
    step: Option<Step>,
    video: Video,
    /// Whether Zenoh reports subscribers; `None` before its first report.
    has_subscribers: Option<bool>,
    /// When the first frame was sent, as long as frames have had receivers since.
    first_sent: Option<Instant>,
    frames: u64,
    bytes: u64,
    changes: u64,
}

#[derive(Debug)]
struct ReceiverState {
    rate: Rate,
    since: Instant,
    last_report: Instant,
    feedback: Feedback,
    is_measured: bool,
}

/// The sender of one stream.
#[derive(Debug)]
pub struct Sender {
    options: Options,
    clock: MillisecondClock,
    outputs: [GroupOutput; 2],
    receivers: BTreeMap<(Name, u16), ReceiverState>,
    groups: Groups,
    polled: Instant,
    notice_at: Option<Instant>,
}

impl Sender {
    /// Creates the sender of a stream. `source` is a random number, and `unix_ms` the time in milliseconds since 1970.
    pub fn new(options: Options, source: u16, unix_ms: u64, now: Instant) -> Self {
        let output = |source| GroupOutput {
            source,
            next: 0,
            pacer: Pacer::default(),
            ladder: Ladder::new(
                &options.steps,
                options.min_frames_per_s,
                options.max_frames_per_s,
            ),
            step: None,
            video: Video::default(),
            has_subscribers: None,
            first_sent: None,
            frames: 0,
            bytes: 0,
            changes: 0,
        };
        Self {
            outputs: [output(source), output(source ^ 0x8000)],
            options,
            clock: MillisecondClock::new(now, unix_ms),
            receivers: BTreeMap::new(),
            groups: Groups::default(),
            polled: now,
            notice_at: None,
        }
    }

    /// Offers a frame of `pixels` pixels (or bytes, if it is not a picture). Returns for which groups it is to be
    /// encoded: none if there are no receivers, or if the previous frame was sent too recently.
    pub fn offer(&mut self, pixels: usize, now: Instant) -> Vec<Job> {
        self.offer_frame(pixels, false, now)
    }

    /// Offers a picture, which a video stream sends as video to the groups in which every receiver decodes it.
    pub fn offer_picture(&mut self, width: u32, height: u32, now: Instant) -> Vec<Job> {
        let pixels = width as usize * height as usize;
        let can_be_video =
            self.options.mode == Mode::Video && video::IS_AVAILABLE && video::fits(width, height);
        self.offer_frame(pixels, can_be_video, now)
    }

    fn offer_frame(&mut self, pixels: usize, can_be_video: bool, now: Instant) -> Vec<Job> {
        self.poll(now);
        Group::ALL
            .into_iter()
            .filter_map(|group| {
                let is_video = can_be_video && self.accepts_video(group);
                self.offer_to(group, pixels, is_video, now)
            })
            .collect()
    }

    /// Returns whether every receiver of a group decodes video, as far as they are known: stock Zenoh programs send no
    /// feedback.
    fn accepts_video(&self, group: Group) -> bool {
        self.members(group)
            .all(|state| state.feedback.accepts_video)
    }

    /// Returns the receivers of the robots in a group.
    fn members(&self, group: Group) -> impl Iterator<Item = &ReceiverState> {
        let is_in = move |robot: &Name| self.groups.of(robot) == Some(group);
        let members = self
            .receivers
            .iter()
            .filter(move |((robot, _), _)| is_in(robot));
        members.map(|(_, state)| state)
    }

    fn offer_to(
        &mut self,
        group: Group,
        pixels: usize,
        is_video: bool,
        now: Instant,
    ) -> Option<Job> {
        let is_adaptive = self.options.mode.is_adaptive();
        let rate = self.rate_of(group);
        let has_receivers = match group {
            Group::Slow if !is_adaptive => false,
            _ => self.outputs[group.index()]
                .has_subscribers
                .unwrap_or(rate.is_some()),
        };
        let frames_per_s = self.options.max_frames_per_s;
        let first = self.options.rates.initial();
        let output = &mut self.outputs[group.index()];
        if !has_receivers {
            output.ladder.forget();
            output.step = None;
            output.video.pause();
            output.first_sent = None;
            return None;
        }
        if is_video {
            output.step = None;
            if !output.pacer.is_due(frames_per_s, now) {
                return None;
            }
            let bytes_per_s = rate.unwrap_or(first);
            let settings = output.video.next(pixels, bytes_per_s, frames_per_s, now);
            return Some(Job {
                group,
                step: None,
                video: Some(settings),
            });
        }
        output.video.pause();
        if is_adaptive {
            let step = output.ladder.step(pixels, rate.unwrap_or(first), now);
            output.changes += u64::from(output.step.is_some_and(|before| before != step));
            output.step = Some(step);
        }
        let step = output.step;
        output.pacer.is_due(frames_per_s, now).then_some(Job {
            group,
            step,
            video: None,
        })
    }

    /// Handles a frame that was encoded for a job and is sent now. Returns its attachment.
    pub fn on_encoded(&mut self, job: Job, payload: &Payload, now: Instant) -> Attachment {
        let bytes = payload.bytes.len();
        let rate = match self.options.mode {
            Mode::Fixed => f64::INFINITY,
            Mode::Adaptive | Mode::Video => self
                .rate_of(job.group)
                .unwrap_or_else(|| self.options.rates.initial()),
        };
        let is_unreported = self.is_unreported(job.group, now);
        let output = &mut self.outputs[job.group.index()];
        output.first_sent.get_or_insert(now);
        if let Some(step) = job.step {
            output.ladder.on_encoded(step, bytes, now);
        }
        if let Some(settings) = job.video {
            let is_key = bitstream::is_key_frame(&payload.bytes);
            output.video.on_encoded(settings, bytes, is_key, now);
        }
        let rate = if is_unreported {
            rate.min(UNREPORTED_BYTES_PER_S)
        } else {
            rate
        };
        output
            .pacer
            .on_sent(bytes, rate, self.options.max_frames_per_s, now);
        output.frames += 1;
        output.bytes += bytes as u64;
        let sequence = output.next;
        output.next = sequence.wrapping_add(1);
        Attachment {
            source: output.source,
            sequence,
            sent: Sent::Low(self.clock.low(now)),
            lifetime_ms: None,
        }
    }

    /// Handles Zenoh's report of whether a group's key has subscribers.
    pub fn on_subscribers(&mut self, group: Group, has_subscribers: bool) {
        self.outputs[group.index()].has_subscribers = Some(has_subscribers);
    }

    /// Handles the feedback of a receiver of `robot`. The key proves that the robot sent it, but its content may be
    /// wrong or forged; its influence on other robots is therefore limited.
    pub fn on_feedback(&mut self, robot: &Name, feedback: &Feedback, now: Instant) {
        if feedback.receiver == RECORDER {
            if feedback.needs_key {
                self.outputs[feedback.group.index()].video.ask_for_key();
            }
            return;
        }
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
        if feedback.frames > 0 && self.is_unreported(feedback.group, now) {
            self.outputs[feedback.group.index()].pacer.forget();
        }
        let limits = self.options.rates;
        let state = self.receivers.entry(key).or_insert_with(|| ReceiverState {
            rate: Rate::new(limits, now),
            since: now,
            last_report: now,
            feedback: *feedback,
            is_measured: false,
        });
        state.last_report = now;
        state.feedback = *feedback;
        state.is_measured |= feedback.frames > 0;
        state.rate.on_feedback(feedback, now);
        // A new robot joins the group that newcomers join, or the slow group, where it affects fewer robots.
        let group = match feedback.group {
            Group::Main => self.join(),
            Group::Slow => Group::Slow,
        };
        self.groups.on_robot(robot, group);
        if feedback.needs_key {
            self.outputs[feedback.group.index()].video.ask_for_key();
        }
        if self.options.mode.is_adaptive() && self.groups.of(robot) != Some(feedback.group) {
            self.notice_at.get_or_insert(now + REPEAT_NOTICE);
        }
        self.poll(now);
    }

    /// Returns whether the feedback is about frames of this sender, or about none yet. Feedback about the
    /// frames of an earlier program of this robot is ignored.
    fn is_of_this_stream(&self, feedback: &Feedback) -> bool {
        let is_newcomer = feedback.source == 0 && feedback.frames == 0;
        let was_sent = |output: &GroupOutput| {
            let ago = output.next.wrapping_sub(1).wrapping_sub(feedback.last);
            output.source == feedback.source && output.frames > 0 && ago < u32::MAX / 2
        };
        is_newcomer || self.outputs.iter().any(was_sent)
    }

    /// Returns the notice to publish now, if there is one.
    pub fn poll_notice(&mut self, now: Instant) -> Option<Notice> {
        self.notice_at.filter(|&at| now >= at)?;
        self.notice_at = None;
        Some(self.notice(now))
    }

    /// Returns the reply to a query for the notice.
    pub fn notice(&self, now: Instant) -> Notice {
        let names = |group| {
            let names = self.groups.members(group).take(MAX_NAMES);
            names.map(|name| name.as_str().to_owned()).collect()
        };
        let has_slow_group = self.groups.members(Group::Slow).next().is_some();
        let is_moving = self
            .receivers
            .iter()
            .any(|((robot, _), state)| self.groups.of(robot) != Some(state.feedback.group));
        let (main, slow) = if has_slow_group || is_moving {
            (names(Group::Main), names(Group::Slow))
        } else {
            Default::default()
        };
        Notice {
            time_ms: self.clock.at(now),
            join: self.join(),
            feedback_ms: u32::try_from(self.options.feedback_interval.as_millis())
                .unwrap_or(u32::MAX),
            main,
            slow,
        }
    }

    /// Returns the status of the stream.
    pub fn status(&self) -> Status {
        let groups = Group::ALL
            .into_iter()
            .filter_map(|group| self.group_status(group));
        let receivers = self
            .receivers
            .iter()
            .map(|((robot, receiver), state)| ReceiverStatus {
                robot: robot.as_str().to_owned(),
                receiver: *receiver,
                group: state.feedback.group,
                last: state.feedback.last,
                age_ms: state.feedback.age_ms,
                frames_per_s: f64::from(state.feedback.frames) * 1000.0
                    / f64::from(state.feedback.span_ms.max(1)),
                lost_share: state.rate.lost_share(),
                bytes_per_s: state.rate.bytes_per_s(),
                pace_bytes_per_s: state.feedback.pace_bytes_per_s,
            });
        Status {
            groups: groups.collect(),
            receivers: receivers.collect(),
        }
    }

    fn group_status(&self, group: Group) -> Option<GroupStatus> {
        let output = &self.outputs[group.index()];
        let rate = self.rate_of(group);
        output
            .has_subscribers
            .unwrap_or(rate.is_some())
            .then(|| GroupStatus {
                group,
                bytes_per_s: rate.unwrap_or_else(|| self.options.rates.initial()),
                step: output.step,
                frame_bytes: match (output.step, output.frames) {
                    (Some(_), _) => output.ladder.frame_bytes(),
                    (None, frames) => output.bytes as f64 / frames.max(1) as f64,
                },
                frames: output.frames,
                bytes: output.bytes,
                changes: output.changes,
                video: output.video.status().map(VideoStatus::from),
                last_change: output.step.and(output.ladder.last_change()).map(in_words),
            })
    }

    /// Removes silent receivers, and updates the groups.
    fn poll(&mut self, now: Instant) {
        if now.saturating_duration_since(self.polled) < Duration::from_millis(50) {
            return;
        }
        self.polled = now;
        let removed_after = REMOVED_AFTER.max(self.options.feedback_interval * 3);
        self.receivers
            .retain(|_, state| now.saturating_duration_since(state.last_report) < removed_after);
        self.receivers
            .values_mut()
            .for_each(|state| state.rate.poll(now));
        if self.options.mode.is_adaptive() && self.groups.update(&self.potentials(), now) {
            self.notice_at = Some(now);
        }
    }

    /// Returns the potential rate of each robot. A robot that has not reported a frame yet is assumed to be as fast as
    /// the fastest.
    fn potentials(&self) -> BTreeMap<Name, f64> {
        let enough = self.outputs[0]
            .ladder
            .max_useful_bytes_per_s()
            .min(self.options.rates.max_bytes_per_s);
        let mut potentials = BTreeMap::new();
        for ((robot, _), state) in &self.receivers {
            let potential = if state.is_measured {
                state.rate.potential().min(enough)
            } else {
                f64::INFINITY
            };
            let lowest = potentials.entry(robot.clone()).or_insert(f64::INFINITY);
            *lowest = potential.min(*lowest);
        }
        let finite = potentials
            .values()
            .copied()
            .filter(|potential| potential.is_finite());
        // Without any report of a frame, all robots are equally fast.
        let best = finite.reduce(f64::max).unwrap_or(1.0);
        potentials
            .values_mut()
            .for_each(|potential| *potential = potential.min(best));
        potentials
    }

    /// Returns the lowest rate among the receivers that are assigned to a group or have not left it yet. `None` if
    /// there are none. In the slow group, [`MIN_SHARE_OF_NEXT`] limits the influence of the slowest robot.
    fn rate_of(&self, group: Group) -> Option<f64> {
        let now = self.polled;
        let leaves_within = LEAVES_WITHIN.max(self.options.feedback_interval * 3);
        let counts = |((robot, _), state): &(&(Name, u16), &ReceiverState)| {
            let is_leaving = self.groups.is_leaving(robot, group, leaves_within, now);
            let is_new = now.saturating_duration_since(state.since) < NEWCOMER;
            (self.groups.of(robot) == Some(group) || (is_leaving && state.feedback.group == group))
                && (state.is_measured || is_new)
        };
        let mut robots = BTreeMap::new();
        for ((robot, _), state) in self.receivers.iter().filter(counts) {
            let lowest = robots.entry(robot).or_insert(f64::INFINITY);
            *lowest = state.rate.bytes_per_s().min(*lowest);
        }
        if robots.is_empty() {
            // Nobody is limited by a robot that has not noticed for long that it was moved.
            let late = (self.receivers.values())
                .filter(|state| state.is_measured && state.feedback.group == group);
            return late.map(|state| state.rate.bytes_per_s()).reduce(f64::min);
        }
        let mut rates: Vec<f64> = robots.into_values().collect();
        rates.sort_by(f64::total_cmp);
        let lowest = rates.first().copied()?;
        Some(match (group, rates.get(1)) {
            (Group::Slow, Some(next)) => {
                lowest.max((next * MIN_SHARE_OF_NEXT).min(self.options.rates.initial()))
            }
            _ => lowest,
        })
    }

    /// Returns whether no receiver of a group has reported a frame, and one may still do so.
    fn is_unreported(&self, group: Group, now: Instant) -> bool {
        if !self.options.mode.is_adaptive() {
            return false;
        }
        let is_recent = |since: Instant, within| now.saturating_duration_since(since) < within;
        if self.members(group).next().is_none() {
            let first_sent = self.outputs[group.index()].first_sent;
            return is_recent(first_sent.unwrap_or(now), UNREPORTED);
        }
        let mut members = self.members(group);
        let is_one_new = members.any(|state| is_recent(state.since, REPORTED_WITHIN));
        is_one_new && self.members(group).all(|state| !state.is_measured)
    }

    /// Returns the group that newcomers join: the slow group if the main group's frames would fill a slow link for
    /// seconds, and otherwise the main group.
    fn join(&self) -> Group {
        let first = self.options.rates.initial();
        let is_heavy = self
            .rate_of(Group::Main)
            .is_some_and(|rate| rate > first * 2.0);
        if self.options.mode.is_adaptive() && is_heavy {
            Group::Slow
        } else {
            Group::Main
        }
    }
}

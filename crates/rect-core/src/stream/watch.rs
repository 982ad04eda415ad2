//! Drives the receiving end of a stream: subscribes to the group that the sender assigns, asks for the sender's notices,
//! sends feedback, and delivers the frames.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::{
    feedback_key,
    frame::ReceivedFrame,
    notice::Notice,
    notice_key,
    read::{FrameReader, SharedPending},
    receiver::Receiver,
    Group,
};
use crate::{
    driver::{Action, Declaration, Driver, Event, Get, Id, Reaction, Sample, Step},
    message::{attachment::Attachment, encoding::Encoding, payload::Payload, urgency::Urgency},
    name::{key::KeySpace, topic::Topic, Name},
    video::{self, bitstream},
};

/// How long the receiver stays subscribed to the previous group after a change, to receive the frames in flight.
const LINGER: Duration = Duration::from_millis(300);
/// The timeout of a question for the sender's notice.
const TIMEOUT: Duration = Duration::from_secs(3);
const FEEDBACK: Id = Id(0);
const NOTICES: Id = Id(1);
const FRAMES: [Id; 2] = [Id(2), Id(3)];
/// The id of the first question; the next ones follow.
const FIRST_QUESTION: u64 = 16;

/// The receiving end of a stream.
#[derive(Debug)]
pub struct StreamWatch {
    sender: KeySpace,
    topic: Topic,
    receiver: Receiver,
    ordinal: u64,
    lost: u64,
    pending: SharedPending,
    sees_video: bool,
    actions: VecDeque<Action>,
    /// The group to which the receiver belongs, and since when.
    group: Option<(Group, Instant)>,
    is_subscribed: [bool; 2],
    /// When the questions that are in flight were sent.
    asked_at: BTreeMap<Id, Instant>,
    next_question: u64,
    is_closed: bool,
}

impl StreamWatch {
    /// Creates the receiving end of the stream `topic` of `sender`, for a program of the robot of `place`. `id` is a random
    /// number that distinguishes the programs of this robot.
    pub fn new(place: &KeySpace, sender: Name, topic: Topic, id: u16, now: Instant) -> Self {
        let feedback = Declaration::Publisher {
            key: feedback_key(place, &sender, &topic),
            qos: Urgency::Urgent.qos().drop_when_congested(),
            observes_matching: false,
        };
        let sender = KeySpace {
            fleet: place.fleet.clone(),
            robot: sender,
        };
        let key = notice_key(&sender, &topic);
        let actions = [
            (FEEDBACK, feedback),
            (NOTICES, Declaration::Subscriber { key }),
        ];
        let actions = actions.map(|(id, declaration)| Action::Declare { id, declaration });
        Self {
            receiver: Receiver::new(place.robot.clone(), id, now),
            sender,
            topic,
            ordinal: 0,
            lost: 0,
            pending: SharedPending::new(),
            sees_video: false,
            actions: actions.into(),
            group: None,
            is_subscribed: [false; 2],
            asked_at: BTreeMap::new(),
            next_question: FIRST_QUESTION,
            is_closed: false,
        }
    }

    /// Returns the round trip of a small message to the sender; `None` until the first one has been measured.
    pub fn round_trip(&self) -> Option<Duration> {
        self.receiver.round_trip()
    }

    /// Leaves the decoding of video to the program, which gets the frames as they were sent, from a key frame on.
    pub fn leave_undecoded(&mut self) {
        self.pending.lock().leave_undecoded();
    }

    /// Asks the sender for a key frame, for a decoder of the program.
    pub fn ask_for_key(&mut self) {
        self.pending.lock().ask_for_key();
    }

    /// Returns the reader of the frames that arrive.
    pub fn reader(&self) -> FrameReader {
        FrameReader::new(self.pending.clone())
    }

    fn on_frame(&mut self, now: Instant, sample: Sample) -> Option<ReceivedFrame> {
        let attachment = sample.attachment.as_deref().and_then(Attachment::decode);
        let bytes = sample.payload.bytes.len();
        let seen = self.receiver.on_frame(attachment, bytes, now)?;
        self.ordinal += 1 + u64::from(seen.skipped);
        self.lost += u64::from(seen.skipped);
        self.sees_video = bitstream::is_video(&sample.payload);
        let is_after_gap = seen.skipped > 0 || seen.is_restarted;
        if self.sees_video && !self.can_decode(&sample.payload, is_after_gap) {
            return None;
        }
        Some(ReceivedFrame {
            payload: sample.payload,
            number: seen.number,
            age: seen.age,
            ordinal: self.ordinal,
            lost: self.lost,
        })
    }

    /// Handles a frame of a video. Returns whether it and all those that it depends on have arrived.
    fn can_decode(&mut self, payload: &Payload, is_after_gap: bool) -> bool {
        let mut pending = self.pending.lock();
        if !video::IS_AVAILABLE && !pending.is_undecoded() {
            return true;
        }
        if is_after_gap {
            pending.on_gap();
        }
        let is_key = bitstream::is_key_frame(&payload.bytes);
        pending.on_frame(self.ordinal, &payload.bytes, is_key)
    }

    /// Passes the state of the video to the receiver. Returns whether it needs a key frame.
    fn tell_receiver(&mut self) -> bool {
        let pending = self.pending.lock();
        let accepts_video = video::IS_AVAILABLE || pending.is_undecoded();
        let needs_key = accepts_video && pending.needs_key();
        self.receiver
            .set_video(accepts_video, needs_key, self.sees_video);
        needs_key && self.sees_video
    }

    fn ask(&mut self, now: Instant) {
        let id = Id(self.next_question);
        self.next_question += 1;
        self.asked_at.insert(id, now);
        let get = Get {
            qos: Urgency::Urgent.qos(),
            ..Get::new(notice_key(&self.sender, &self.topic), TIMEOUT)
        };
        self.actions.push_back(Action::Get { id, get });
    }

    /// Subscribes to a group; the subscription to the other group ends [`LINGER`] later.
    fn subscribe_to(&mut self, group: Group, now: Instant) {
        let (this, other) = (group.index(), 1 - group.index());
        if !self.is_subscribed[this] {
            self.is_subscribed[this] = true;
            let key = group.key(&self.sender, &self.topic);
            let declaration = Declaration::Subscriber { key };
            let id = FRAMES[this];
            self.actions.push_back(Action::Declare { id, declaration });
        }
        match self.group {
            Some((known, since)) if known == group => {
                let lingered = now.saturating_duration_since(since) >= LINGER;
                if lingered && std::mem::take(&mut self.is_subscribed[other]) {
                    let id = FRAMES[other];
                    self.actions.push_back(Action::Undeclare { id });
                }
            }
            _ => self.group = Some((group, now)),
        }
    }

    /// Returns when the subscription to the previous group ends.
    fn unsubscribe_at(&self) -> Option<Instant> {
        let (group, since) = self.group?;
        self.is_subscribed[1 - group.index()].then(|| since + LINGER)
    }
}

impl Driver for StreamWatch {
    type Item = ReceivedFrame;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<ReceivedFrame> {
        match event {
            Event::Sample {
                id: NOTICES,
                sample,
            } => match Notice::decode(&sample.payload.bytes) {
                Ok(notice) => {
                    self.receiver.on_notice(&notice);
                    Reaction::POLL
                }
                Err(_) => Reaction::NONE,
            },
            Event::Sample { sample, .. } => {
                let items = self.on_frame(now, sample).into_iter().collect();
                let polls = self.sees_video && self.tell_receiver();
                Reaction { items, polls }
            }
            Event::Reply {
                id,
                reply: Ok(sample),
            } => {
                let asked_at = self.asked_at.get(&id).copied();
                match (asked_at, Notice::decode(&sample.payload.bytes)) {
                    (Some(asked_at), Ok(notice)) => {
                        self.receiver.on_reply(&notice, asked_at, now);
                        Reaction::POLL
                    }
                    _ => Reaction::NONE,
                }
            }
            Event::Ended { id } => {
                self.asked_at.remove(&id);
                Reaction::NONE
            }
            Event::Closed => {
                self.is_closed = true;
                Reaction::POLL
            }
            _ => Reaction::NONE,
        }
    }

    fn poll(&mut self, now: Instant) -> Step<ReceivedFrame, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        self.tell_receiver();
        let group = self.receiver.poll_group(now);
        if self.receiver.poll_query(now) {
            self.ask(now);
        }
        if let Some(group) = group {
            self.subscribe_to(group, now);
        }
        if let Some(feedback) = self.receiver.poll_feedback(now) {
            self.actions.push_back(Action::Put {
                publisher: FEEDBACK,
                payload: Payload::new(feedback.encode(), Encoding::BYTES),
                attachment: None,
            });
        }
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        let poll_at = self.receiver.poll_at(now);
        let unsubscribe_at = self.unsubscribe_at();
        Step::Wait(Some(unsubscribe_at.map_or(poll_at, |at| at.min(poll_at))))
    }
}

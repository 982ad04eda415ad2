//! Drives the receiving end of a stream: subscribes to the group that the sender assigns, asks for the sender's notices,
//! sends feedback, and delivers the frames.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use super::{feedback_key, notice::Notice, notice_key, receiver::Receiver, Group};
use crate::core::{
    attachment::Attachment,
    driver::{Action, Declaration, Driver, Event, Get, Id, Reaction, Sample, Step},
    encoding::Encoding,
    key::KeySpace,
    name::Name,
    payload::Payload,
    topic::Topic,
    urgency::Urgency,
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

/// A frame that arrived.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceivedFrame {
    /// The picture or value.
    pub payload: Payload,
    /// The number of the frame. It starts again when the sender restarts or assigns this receiver to another group.
    pub number: u32,
    /// The age of the frame on arrival. Until the offset of the clocks is known, the delay relative to the fastest frame of
    /// the last minute. `None` if the sender is a stock Zenoh program.
    pub age: Option<Duration>,
    /// The number of frames that were sent since the first one that arrived, including this one.
    pub ordinal: u64,
}

/// Counts the frames that a program has not read: those that did not arrive, and those that newer ones replaced.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameCounter(Option<u64>);

impl FrameCounter {
    /// Handles that the program reads a frame. Returns the number of frames since the previous one that it read.
    pub fn on_read(&mut self, ordinal: u64) -> u32 {
        let skipped = self.0.map_or(0, |last| ordinal.saturating_sub(last + 1));
        self.0 = Some(ordinal);
        u32::try_from(skipped).unwrap_or(u32::MAX)
    }
}

/// The receiving end of a stream.
#[derive(Debug)]
pub struct StreamWatch {
    sender: KeySpace,
    topic: Topic,
    receiver: Receiver,
    ordinal: u64,
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

    fn on_frame(&mut self, now: Instant, sample: Sample) -> Option<ReceivedFrame> {
        let attachment = sample.attachment.as_deref().and_then(Attachment::decode);
        let bytes = sample.payload.bytes.len();
        let seen = self.receiver.on_frame(attachment, bytes, now)?;
        self.ordinal += 1 + u64::from(seen.skipped);
        Some(ReceivedFrame {
            payload: sample.payload,
            number: seen.number,
            age: seen.age,
            ordinal: self.ordinal,
        })
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
                Reaction::deliver(self.on_frame(now, sample).into_iter().collect())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_the_frames_that_the_program_did_not_read() {
        let mut counter = FrameCounter::default();
        let skipped = [3, 4, 7].map(|ordinal| counter.on_read(ordinal));
        assert_eq!(skipped, [0, 0, 2]);
    }
}

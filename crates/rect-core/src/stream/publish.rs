//! Drives the sending end of a stream: offers frames to the groups that have receivers, handles feedback, and tells the
//! receivers by notices which group they belong to.
use std::{collections::VecDeque, time::Instant};

use super::{
    feedback::Feedback,
    feedback_from, feedback_keys,
    job::Job,
    notice_key,
    picture::LossyFormat,
    sender::{Options, Sender},
    status::Status,
    Group,
};
use crate::{
    driver::{Action, Answer, Declaration, Driver, Event, Id, QueryId, Reaction, Step},
    message::{encoding::Encoding, payload::Payload, urgency::Urgency},
    name::{key::KeySpace, topic::Topic},
};

const FRAMES: [Id; 2] = [Id(0), Id(1)];
const FEEDBACK: Id = Id(2);
const NOTICE: Id = Id(3);

/// The sending end of a stream.
#[derive(Debug)]
pub struct StreamPublish {
    place: KeySpace,
    notice_key: String,
    lossy_format: LossyFormat,
    sender: Sender,
    actions: VecDeque<Action>,
    /// Questions for the notice. They are answered with the time of the answer.
    questions: VecDeque<QueryId>,
    has_feedback: bool,
    is_closed: bool,
}

impl StreamPublish {
    /// Creates the stream `topic` of the robot of `place`. `source` is a random number, and `unix_ms` the time in
    /// milliseconds since 1970.
    pub fn new(
        place: &KeySpace,
        topic: &Topic,
        options: Options,
        urgency: Urgency,
        source: u16,
        unix_ms: u64,
        now: Instant,
    ) -> Self {
        let frames = |group: Group| Declaration::Publisher {
            key: group.key(place, topic),
            qos: urgency.qos().drop_when_congested(),
            observes_matching: true,
        };
        let [main, slow] = Group::ALL.map(frames);
        let notice_key = notice_key(place, topic);
        let feedback = Declaration::Subscriber {
            key: feedback_keys(place, topic),
        };
        let notice = Declaration::Queryable {
            key: notice_key.clone(),
            complete: true,
        };
        let actions = [
            (FRAMES[0], main),
            (FRAMES[1], slow),
            (FEEDBACK, feedback),
            (NOTICE, notice),
        ];
        Self {
            place: place.clone(),
            notice_key,
            lossy_format: options.lossy_format,
            sender: Sender::new(options, source, unix_ms, now),
            actions: actions
                .map(|(id, declaration)| Action::Declare { id, declaration })
                .into(),
            questions: VecDeque::new(),
            has_feedback: false,
            is_closed: false,
        }
    }

    /// Offers a frame of `pixels` pixels. Returns a job for each group that is due for a frame.
    pub fn offer(&mut self, pixels: usize, now: Instant) -> Vec<Job> {
        self.sender.offer(pixels, now)
    }

    /// Offers a picture, which a video stream sends as video. Returns a job for each group that is due for a frame.
    pub fn offer_picture(&mut self, width: u32, height: u32, now: Instant) -> Vec<Job> {
        self.sender.offer_picture(width, height, now)
    }

    /// Returns the action that sends the frame that was encoded for a job.
    pub fn frame(&mut self, job: Job, payload: Payload, now: Instant) -> Action {
        let attachment = self.sender.on_encoded(job, &payload, now);
        Action::Put {
            publisher: FRAMES[job.group.index()],
            payload,
            attachment: Some(attachment.encode().to_vec()),
        }
    }

    /// Returns the format of pictures with loss.
    pub fn lossy_format(&self) -> LossyFormat {
        self.lossy_format
    }

    /// Returns the current rate, throughput and step of each group.
    pub fn status(&self) -> Status {
        self.sender.status()
    }

    /// Returns the key of the notices, which identifies the stream.
    pub fn notice_key(&self) -> &str {
        &self.notice_key
    }

    fn notice(bytes: Vec<u8>) -> Payload {
        Payload::new(bytes, Encoding::JSON)
    }
}

impl Driver for StreamPublish {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Matching { id, matching } => {
                if let Some(group) = Group::ALL.into_iter().find(|g| FRAMES[g.index()] == id) {
                    self.sender.on_subscribers(group, matching);
                }
                return Reaction::NONE;
            }
            Event::Sample { sample, .. } => {
                let robot = feedback_from(&self.place, &sample.key);
                let feedback = Feedback::decode(&sample.payload.bytes);
                let (Some(robot), Ok(feedback)) = (robot, feedback) else {
                    return Reaction::NONE;
                };
                self.sender.on_feedback(&robot, &feedback, now);
                self.has_feedback = true;
            }
            Event::Query { query, .. } => self.questions.push_back(query),
            Event::Closed => self.is_closed = true,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if let Some(action) = self.actions.pop_front() {
            return Step::Act(action);
        }
        if let Some(query) = self.questions.pop_front() {
            let payload = Self::notice(self.sender.notice(now).encode());
            let key = self.notice_key.clone();
            let answer = Answer::Reply { key, payload };
            return Step::Act(Action::Answer { query, answer });
        }
        if std::mem::take(&mut self.has_feedback) {
            if let Some(notice) = self.sender.poll_notice(now) {
                return Step::Act(Action::PutOnce {
                    key: self.notice_key.clone(),
                    payload: Self::notice(notice.encode()),
                    qos: Urgency::Normal.qos(),
                });
            }
        }
        Step::Wait(None)
    }
}

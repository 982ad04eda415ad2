//! Simulates a stream in virtual time: a camera, its sender, and receivers behind a link each. A link has a limited
//! capacity and drops frames for which there is no room, like `ble/` links.
use std::{
    collections::{BTreeSet, VecDeque},
    time::{Duration, Instant},
};

use super::{
    ladder::Step,
    notice::Notice,
    receiver::Receiver,
    sender::{Options, Sender},
    Group,
};
use crate::{
    message::{
        attachment::{Attachment, Sent},
        encoding::Encoding,
        payload::Payload,
    },
    name::Name,
};

const STEP: Duration = Duration::from_millis(1);
/// A droppable message that is not sent within this time is dropped, like `droppable=` of a `ble/` link.
const DROPPABLE: Duration = Duration::from_millis(100);

/// A seeded generator (SplitMix64), so that runs can be repeated.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Returns a number from 0 to 1.
    pub fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// The condition of a link at some time.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    pub bytes_per_s: f64,
    /// Whether everything is lost.
    pub is_cut: bool,
    /// The share of delivered frames that is lost nevertheless.
    pub loss: f64,
    /// Reliable traffic of the same priority, in bytes per second; messages of 1 kB.
    pub others_bytes_per_s: f64,
    /// The bytes that wait for the link at most; further frames are dropped.
    pub queue_bytes: f64,
}

impl Condition {
    pub fn of(bytes_per_s: f64) -> Self {
        Self {
            bytes_per_s,
            is_cut: false,
            loss: 0.0,
            others_bytes_per_s: 0.0,
            queue_bytes: bytes_per_s * DROPPABLE.as_secs_f64(),
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Packet {
    left: f64,
    frame: Option<(Group, Attachment, usize, Instant)>,
}

/// A frame that a receiver accepted.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Time since the beginning.
    pub at: Duration,
    /// True age.
    pub age: Duration,
    /// Age as the receiver estimates it.
    pub estimated: Option<Duration>,
    pub bytes: usize,
    pub step: Step,
    pub group: Group,
}

type ConditionAt = Box<dyn Fn(Duration) -> Condition>;

pub struct Endpoint {
    pub name: Name,
    receiver: Receiver,
    condition_at: ConditionAt,
    one_way: Duration,
    present: Box<dyn Fn(Duration) -> bool>,
    is_present: bool,
    listens: BTreeSet<Group>,
    leaves: Option<(Instant, Group)>,
    queue: VecDeque<Packet>,
    others: f64,
    arriving: VecDeque<(Instant, Packet)>,
    /// Small messages to the sender and back.
    to_sender: VecDeque<(Instant, Small)>,
    from_sender: VecDeque<(Instant, Small)>,
    pub arrivals: Vec<Arrival>,
    pub carried: f64,
    pub groups: Vec<(Duration, Group)>,
}

#[derive(Clone, Debug)]
enum Small {
    Query(Instant),
    Reply(Instant, Notice),
    Feedback(super::feedback::Feedback),
    Notice(Notice),
}

type Forge = Box<dyn FnMut(&mut Sender, [Option<Attachment>; 2], Duration, Instant)>;

/// The simulated world.
pub struct World {
    pub start: Instant,
    pub now: Instant,
    pub sender: Sender,
    pub endpoints: Vec<Endpoint>,
    random: Random,
    camera_every: Duration,
    camera_at: Instant,
    pixels: usize,
    /// The size of the pictures at some time, as a multiple of the usual size.
    pub scene: Box<dyn Fn(Duration) -> f64>,
    steps: Vec<(u64, Group, Step)>,
    /// The changes of each group's step.
    pub changes: Vec<(Duration, Group, Step)>,
    /// The rate of each group, sampled ten times per second.
    pub rates: Vec<(Duration, Group, f64)>,
    pub feedback_bytes: usize,
    pub encoded: usize,
    /// Feedback of an attacker who knows the newest frame of each group, sent twice per second.
    pub forge: Forge,
    newest: [Option<Attachment>; 2],
}

impl World {
    pub fn new(options: Options, pixels: usize, seed: u64) -> Self {
        let start = Instant::now();
        let mut random = Random(seed);
        let unix_ms = 1_795_000_000_000 + random.next() % 100_000;
        Self {
            start,
            now: start,
            sender: Sender::new(options, random.next() as u16, unix_ms, start),
            endpoints: Vec::new(),
            random,
            camera_every: Duration::from_millis(50),
            camera_at: start,
            pixels,
            scene: Box::new(|_| 1.0),
            steps: Vec::new(),
            changes: Vec::new(),
            rates: Vec::new(),
            feedback_bytes: 0,
            encoded: 0,
            forge: Box::new(|_, _, _, _| {}),
            newest: [None; 2],
        }
    }

    pub fn add(
        &mut self,
        name: &str,
        one_way_ms: u64,
        condition_at: impl Fn(Duration) -> Condition + 'static,
    ) {
        self.add_at_times(name, one_way_ms, condition_at, |_| true);
    }

    pub fn add_at_times(
        &mut self,
        name: &str,
        one_way_ms: u64,
        condition_at: impl Fn(Duration) -> Condition + 'static,
        present: impl Fn(Duration) -> bool + 'static,
    ) {
        let name = Name::new(name).expect("a name");
        self.endpoints.push(Endpoint {
            receiver: Receiver::new(name.clone(), self.random.next() as u16, self.now),
            name,
            condition_at: Box::new(condition_at),
            one_way: Duration::from_millis(one_way_ms),
            present: Box::new(present),
            is_present: false,
            listens: BTreeSet::new(),
            leaves: None,
            queue: VecDeque::new(),
            others: 0.0,
            arriving: VecDeque::new(),
            to_sender: VecDeque::new(),
            from_sender: VecDeque::new(),
            arrivals: Vec::new(),
            carried: 0.0,
            groups: Vec::new(),
        });
    }

    pub fn endpoint(&self, name: &str) -> &Endpoint {
        let is_it = |endpoint: &&Endpoint| endpoint.name.as_str() == name;
        self.endpoints.iter().find(is_it).expect("endpoint")
    }

    pub fn run(&mut self, seconds: u64) {
        let end = self.now + Duration::from_secs(seconds);
        while self.now < end {
            self.now += STEP;
            if self.now >= self.camera_at {
                self.camera_at += self.camera_every;
                self.picture();
            }
            if let Some(notice) = self.sender.poll_notice(self.now) {
                for endpoint in &mut self.endpoints {
                    endpoint.deliver(Small::Notice(notice.clone()), self.now);
                }
            }
            for n in 0..self.endpoints.len() {
                self.step(n);
            }
            let since = self.now - self.start;
            if since.as_millis() % 500 == 0 {
                (self.forge)(&mut self.sender, self.newest, since, self.now);
            }
            if since.as_millis() % 100 == 0 {
                for group in self.sender.status().groups {
                    self.rates.push((since, group.group, group.bytes_per_s));
                }
            }
        }
    }

    fn picture(&mut self) {
        let now = self.now;
        let matched = Group::ALL.map(|group| {
            self.endpoints
                .iter()
                .any(|endpoint| endpoint.is_connected(group, now - self.start))
        });
        for group in Group::ALL {
            self.sender.on_subscribers(group, matched[group.index()]);
        }
        for job in self.sender.offer(self.pixels, now) {
            let step = job.step.expect("adaptive");
            let bytes = self.encoded_bytes(step);
            self.encoded += 1;
            let payload = Payload::new(vec![0; bytes], Encoding::BYTES);
            let attachment = self.sender.on_encoded(job, &payload, now);
            self.newest[job.group.index()] = Some(attachment);
            let last = self
                .changes
                .iter()
                .rev()
                .find(|(_, group, _)| *group == job.group);
            if last.is_none_or(|&(_, _, before)| before != step) {
                self.changes.push((now - self.start, job.group, step));
            }
            self.steps.push((id(&attachment), job.group, step));
            for endpoint in &mut self.endpoints {
                endpoint.push(job.group, attachment, bytes, now, self.start);
            }
        }
    }

    /// Returns a size that differs from the estimate and varies randomly.
    fn encoded_bytes(&mut self, step: Step) -> usize {
        let quality = match step.coding {
            super::ladder::Coding::Lossless => 100,
            super::ladder::Coding::Lossy(quality) => u64::from(quality),
        };
        let bias = 0.75 + 0.6 * Random(quality * 31 + u64::from(step.quarters)).share();
        let noise = 0.9 + 0.2 * self.random.share();
        let scene = (self.scene)(self.now - self.start);
        (step.guess() * self.pixels as f64 * bias * noise * scene) as usize
    }

    fn step(&mut self, n: usize) {
        let (now, start) = (self.now, self.start);
        let endpoint = &mut self.endpoints[n];
        endpoint.come_and_go(now, start);
        endpoint.carry(now, start);
        // Deliver what arrives.
        while endpoint.arriving.front().is_some_and(|(at, _)| *at <= now) {
            let Some((
                _,
                Packet {
                    frame: Some((group, attachment, bytes, sent)),
                    ..
                },
            )) = endpoint.arriving.pop_front()
            else {
                continue;
            };
            let condition = (endpoint.condition_at)(now - start);
            if !endpoint.listens.contains(&group) || self.random.share() < condition.loss {
                continue;
            }
            if let Some(seen) = endpoint.receiver.on_frame(Some(attachment), bytes, now) {
                let step = self
                    .steps
                    .iter()
                    .rev()
                    .find(|(known, _, _)| *known == id(&attachment));
                endpoint.arrivals.push(Arrival {
                    at: now - start,
                    age: now - sent,
                    estimated: seen.age,
                    bytes,
                    step: step.expect("it was sent").2,
                    group,
                });
            }
        }
        let due = |queue: &mut VecDeque<(Instant, Small)>| {
            let is_due = queue.front().is_some_and(|(at, _)| *at <= now);
            is_due
                .then(|| queue.pop_front())
                .flatten()
                .map(|(_, small)| small)
        };
        while let Some(small) = due(&mut endpoint.from_sender) {
            match small {
                Small::Reply(asked, notice) => endpoint.receiver.on_reply(&notice, asked, now),
                Small::Notice(notice) => endpoint.receiver.on_notice(&notice),
                _ => {}
            }
        }
        if endpoint.is_present {
            if endpoint.receiver.poll_query(now) {
                endpoint.send(Small::Query(now), now, start);
            }
            if let Some(feedback) = endpoint.receiver.poll_feedback(now) {
                self.feedback_bytes += feedback.encode().len();
                endpoint.send(Small::Feedback(feedback), now, start);
            }
        }
        while let Some(small) = due(&mut endpoint.to_sender) {
            match small {
                Small::Query(asked) => {
                    endpoint.deliver(Small::Reply(asked, self.sender.notice(now)), now)
                }
                Small::Feedback(feedback) => {
                    self.sender.on_feedback(&endpoint.name, &feedback, now)
                }
                _ => {}
            }
        }
    }
}

fn id(attachment: &Attachment) -> u64 {
    let Sent::Low(_) = attachment.sent else {
        panic!("frames of streams have short times")
    };
    u64::from(attachment.source) << 32 | u64::from(attachment.sequence)
}

impl Endpoint {
    fn is_connected(&self, group: Group, since: Duration) -> bool {
        self.listens.contains(&group) && !(self.condition_at)(since).is_cut
    }

    fn come_and_go(&mut self, now: Instant, start: Instant) {
        let is_present = (self.present)(now - start);
        if is_present && !self.is_present {
            self.receiver = Receiver::new(self.name.clone(), self.receiver_id(), now);
        } else if !is_present {
            self.listens.clear();
        }
        self.is_present = is_present;
        let Some(group) = self.receiver.poll_group(now).filter(|_| is_present) else {
            return;
        };
        if self.listens.insert(group) {
            self.groups.push((now - start, group));
        }
        // The receiver unsubscribes from the old group shortly after it has subscribed to the new one.
        let other = Group::ALL[1 - group.index()];
        if self.listens.contains(&other) {
            match self.leaves {
                Some((at, leaving)) if leaving == other => {
                    if now >= at {
                        self.listens.remove(&other);
                        self.leaves = None;
                    }
                }
                _ => self.leaves = Some((now + Duration::from_millis(100), other)),
            }
        }
    }

    fn receiver_id(&self) -> u16 {
        self.name
            .as_str()
            .bytes()
            .fold(self.arrivals.len() as u16, |sum, byte| {
                sum.wrapping_mul(31) + u16::from(byte)
            })
    }

    fn push(
        &mut self,
        group: Group,
        attachment: Attachment,
        bytes: usize,
        now: Instant,
        start: Instant,
    ) {
        if !self.is_connected(group, now - start) {
            return;
        }
        let condition = (self.condition_at)(now - start);
        let waiting: f64 = self.queue.iter().map(|packet| packet.left).sum();
        if waiting <= condition.queue_bytes {
            self.queue.push_back(Packet {
                left: bytes as f64 + 60.0,
                frame: Some((group, attachment, bytes, now)),
            });
        }
    }

    fn carry(&mut self, now: Instant, start: Instant) {
        let condition = (self.condition_at)(now - start);
        if condition.is_cut {
            self.queue.clear();
            self.arriving.clear();
            self.from_sender.clear();
            self.to_sender.clear();
            return;
        }
        self.others += condition.others_bytes_per_s * STEP.as_secs_f64();
        if self.others >= 1000.0 {
            self.others -= 1000.0;
            self.queue.push_back(Packet {
                left: 1000.0,
                frame: None,
            });
        }
        let mut left = condition.bytes_per_s * STEP.as_secs_f64();
        while let Some(head) = self.queue.front_mut().filter(|_| left > 0.0) {
            let now_sent = head.left.min(left);
            head.left -= now_sent;
            left -= now_sent;
            self.carried += now_sent;
            if head.left <= 0.0 {
                if let Some(packet) = self.queue.pop_front() {
                    self.arriving.push_back((now + self.one_way, packet));
                }
            }
        }
    }

    fn send(&mut self, small: Small, now: Instant, start: Instant) {
        if !(self.condition_at)(now - start).is_cut {
            self.to_sender.push_back((now + self.one_way, small));
        }
    }

    fn deliver(&mut self, small: Small, now: Instant) {
        self.from_sender.push_back((now + self.one_way, small));
    }
}

//! A stream in virtual time: a camera, its sender, and receivers behind a link each, which carries so much and drops what
//! has no room, as `ble/` links do.
use std::{
    collections::{BTreeSet, VecDeque},
    time::{Duration, Instant},
};

use super::{
    ladder::Level,
    notice::Notice,
    receiver::Receiver,
    sender::{Options, Sender},
    Group,
};
use crate::core::{
    attachment::{Attachment, Sent},
    name::Name,
};

const STEP: Duration = Duration::from_millis(1);
/// What must be sent before a droppable message within this time, or it is dropped: `droppable=` of a `ble/` link.
const DROPPABLE: Duration = Duration::from_millis(100);

/// A seeded generator (SplitMix64): a run can be repeated.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// 0 to 1.
    pub fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// What a link is like at a time.
#[derive(Clone, Copy, Debug)]
pub struct Condition {
    pub bytes_per_s: f64,
    /// Everything is lost.
    pub is_cut: bool,
    /// Of the frames that got through, so many are lost after all.
    pub loss: f64,
    /// Bytes per second of reliable messages of the same priority, in messages of 1 kB.
    pub others_bytes_per_s: f64,
}

impl Condition {
    pub fn of(bytes_per_s: f64) -> Self {
        Self {
            bytes_per_s,
            is_cut: false,
            loss: 0.0,
            others_bytes_per_s: 0.0,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Packet {
    left: f64,
    frame: Option<(Group, Attachment, usize, Instant)>,
}

/// A frame as it was seen.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Since the beginning.
    pub at: Duration,
    /// Truly.
    pub age: Duration,
    /// As the receiver has it.
    pub told: Option<Duration>,
    pub bytes: usize,
    pub level: Level,
    pub group: Group,
}

type Weather = Box<dyn Fn(Duration) -> Condition>;

pub struct Place {
    pub name: Name,
    receiver: Receiver,
    weather: Weather,
    one_way: Duration,
    present: Box<dyn Fn(Duration) -> bool>,
    is_present: bool,
    listens: BTreeSet<Group>,
    leaves: Option<(Instant, Group)>,
    queue: VecDeque<Packet>,
    others: f64,
    arriving: VecDeque<(Instant, Packet)>,
    /// To the sender and back: small messages.
    to_sender: VecDeque<(Instant, Small)>,
    from_sender: VecDeque<(Instant, Small)>,
    pub arrivals: Vec<Arrival>,
    pub carried: f64,
    pub groups: Vec<(Duration, Group)>,
}

#[derive(Clone, Debug)]
enum Small {
    Question(Instant),
    Answer(Instant, Notice),
    Feedback(super::feedback::Feedback),
    Notice(Notice),
}

type Forge = Box<dyn FnMut(&mut Sender, [Option<Attachment>; 2], Duration, Instant)>;

/// Everything.
pub struct World {
    pub start: Instant,
    pub now: Instant,
    pub sender: Sender,
    pub places: Vec<Place>,
    random: Random,
    camera_every: Duration,
    camera_at: Instant,
    pixels: usize,
    /// What the picture shows takes so many times what is usual.
    pub scene: Box<dyn Fn(Duration) -> f64>,
    levels: Vec<(u64, Group, Level)>,
    /// Each change of a group's step.
    pub changes: Vec<(Duration, Group, Level)>,
    /// The rate of each group, ten times a second.
    pub rates: Vec<(Duration, Group, f64)>,
    pub feedback_bytes: usize,
    pub encoded: usize,
    /// The feedback that a forger who knows the newest frame of each group sends twice a second.
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
            places: Vec::new(),
            random,
            camera_every: Duration::from_millis(50),
            camera_at: start,
            pixels,
            scene: Box::new(|_| 1.0),
            levels: Vec::new(),
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
        weather: impl Fn(Duration) -> Condition + 'static,
    ) {
        self.add_at_times(name, one_way_ms, weather, |_| true);
    }

    pub fn add_at_times(
        &mut self,
        name: &str,
        one_way_ms: u64,
        weather: impl Fn(Duration) -> Condition + 'static,
        present: impl Fn(Duration) -> bool + 'static,
    ) {
        let name = Name::new(name).expect("a name");
        self.places.push(Place {
            receiver: Receiver::new(name.clone(), self.random.next() as u16, self.now),
            name,
            weather: Box::new(weather),
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

    pub fn place(&self, name: &str) -> &Place {
        let is_it = |place: &&Place| place.name.as_str() == name;
        self.places.iter().find(is_it).expect("such a place")
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
                for place in &mut self.places {
                    place.tell(Small::Notice(notice.clone()), self.now);
                }
            }
            for n in 0..self.places.len() {
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
            self.places
                .iter()
                .any(|place| place.is_connected(group, now - self.start))
        });
        for group in Group::ALL {
            self.sender.on_subscribers(group, matched[group.index()]);
        }
        for job in self.sender.offer(self.pixels, now) {
            let level = job.level.expect("adaptive");
            let bytes = self.encoded_bytes(level);
            self.encoded += 1;
            let attachment = self.sender.on_encoded(job, bytes, now);
            self.newest[job.group.index()] = Some(attachment);
            let last = self
                .changes
                .iter()
                .rev()
                .find(|(_, group, _)| *group == job.group);
            if last.is_none_or(|&(_, _, before)| before != level) {
                self.changes.push((now - self.start, job.group, level));
            }
            self.levels.push((id(&attachment), job.group, level));
            for place in &mut self.places {
                place.push(job.group, attachment, bytes, now, self.start);
            }
        }
    }

    /// Not what is guessed of the step, and not twice the same.
    fn encoded_bytes(&mut self, level: Level) -> usize {
        let quality = match level.coding {
            super::ladder::Coding::Lossless => 100,
            super::ladder::Coding::Lossy(quality) => u64::from(quality),
        };
        let wrong = 0.75 + 0.6 * Random(quality * 31 + u64::from(level.quarters)).share();
        let noise = 0.9 + 0.2 * self.random.share();
        let scene = (self.scene)(self.now - self.start);
        (level.guess() * self.pixels as f64 * wrong * noise * scene) as usize
    }

    fn step(&mut self, n: usize) {
        let (now, start) = (self.now, self.start);
        let place = &mut self.places[n];
        place.come_and_go(now, start);
        place.carry(now, start);
        // What arrives.
        while place.arriving.front().is_some_and(|(at, _)| *at <= now) {
            let Some((
                _,
                Packet {
                    frame: Some((group, attachment, bytes, sent)),
                    ..
                },
            )) = place.arriving.pop_front()
            else {
                continue;
            };
            let condition = (place.weather)(now - start);
            if !place.listens.contains(&group) || self.random.share() < condition.loss {
                continue;
            }
            if let Some(seen) = place.receiver.on_frame(Some(attachment), bytes, now) {
                let level = self
                    .levels
                    .iter()
                    .rev()
                    .find(|(known, _, _)| *known == id(&attachment));
                place.arrivals.push(Arrival {
                    at: now - start,
                    age: now - sent,
                    told: seen.age,
                    bytes,
                    level: level.expect("it was sent").2,
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
        while let Some(small) = due(&mut place.from_sender) {
            match small {
                Small::Answer(asked, notice) => place.receiver.on_answer(&notice, asked, now),
                Small::Notice(notice) => place.receiver.on_notice(&notice),
                _ => {}
            }
        }
        if place.is_present {
            if place.receiver.poll_question(now) {
                place.say(Small::Question(now), now, start);
            }
            if let Some(feedback) = place.receiver.poll_feedback(now) {
                self.feedback_bytes += feedback.encode().len();
                place.say(Small::Feedback(feedback), now, start);
            }
        }
        while let Some(small) = due(&mut place.to_sender) {
            match small {
                Small::Question(asked) => {
                    place.tell(Small::Answer(asked, self.sender.notice(now)), now)
                }
                Small::Feedback(feedback) => self.sender.on_feedback(&place.name, &feedback, now),
                _ => {}
            }
        }
    }
}

fn id(attachment: &Attachment) -> u64 {
    let Sent::Low(_) = attachment.sent else {
        panic!("a stream's frames have short times")
    };
    u64::from(attachment.source) << 32 | u64::from(attachment.sequence)
}

impl Place {
    fn is_connected(&self, group: Group, since: Duration) -> bool {
        self.listens.contains(&group) && !(self.weather)(since).is_cut
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
        // The other is left when the new one is there, and that takes a moment to be known.
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
        let condition = (self.weather)(now - start);
        let waiting: f64 = self.queue.iter().map(|packet| packet.left).sum();
        if waiting <= condition.bytes_per_s * DROPPABLE.as_secs_f64() {
            self.queue.push_back(Packet {
                left: bytes as f64 + 60.0,
                frame: Some((group, attachment, bytes, now)),
            });
        }
    }

    fn carry(&mut self, now: Instant, start: Instant) {
        let condition = (self.weather)(now - start);
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

    fn say(&mut self, small: Small, now: Instant, start: Instant) {
        if !(self.weather)(now - start).is_cut {
            self.to_sender.push_back((now + self.one_way, small));
        }
    }

    fn tell(&mut self, small: Small, now: Instant) {
        self.from_sender.push_back((now + self.one_way, small));
    }
}

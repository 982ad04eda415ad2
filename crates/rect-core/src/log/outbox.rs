//! Gives the lines of a program to the router of its robot, and never blocks the program.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::{batch::Batch, line::Line, GIVEN, QOS, UNNAMED};
use crate::{
    driver::{Action, Declaration, Driver, Event, Id, Reaction, Step},
    name::{key::KeySpace, Name},
};

/// The maximum size of the lines that wait, in bytes. Beyond it the oldest ones are lost.
const MAX_WAITING: usize = 512 << 10;
/// The size at which a batch ends, in bytes of its lines.
const BATCH: usize = 64 << 10;
/// The least time between two batches. Lines that are logged meanwhile share the second one.
const TOGETHER: Duration = Duration::from_millis(20);

const PUBLISHER: Id = Id(0);

/// The lines of a program that its router does not have yet.
#[derive(Debug)]
pub struct Outbox {
    key: String,
    run: u32,
    waiting: VecDeque<(Line, bool)>,
    /// The size of those, in bytes.
    size: usize,
    /// The number of the first one.
    first: u64,
    lost: u64,
    send_at: Option<Instant>,
    /// The earliest time of the next batch.
    not_before: Option<Instant>,
    is_declared: bool,
    /// Whether the router receives lines. Until then they wait.
    is_received: bool,
    /// When they are sent even if it is not known whether it does, because the program ends.
    force_at: Option<Instant>,
    is_closed: bool,
}

impl Outbox {
    /// Creates the lines of a program, which may have no name. `run` is a random number.
    pub fn new(place: &KeySpace, program: Option<&Name>, run: u32) -> Self {
        let program = program.map_or(UNNAMED, Name::as_str);
        Self {
            key: place.own(Some(&place.robot), &format!("{GIVEN}/{program}")),
            run,
            waiting: VecDeque::new(),
            size: 0,
            first: 0,
            lost: 0,
            send_at: None,
            not_before: None,
            is_declared: false,
            is_received: false,
            force_at: None,
            is_closed: false,
        }
    }

    /// Adds a line; private ones stay on the robot. Returns whether to poll, because the first line waits. Beyond the limit the
    /// oldest lines are lost, and counted.
    pub fn log(&mut self, line: Line, is_private: bool, now: Instant) -> bool {
        if self.is_closed {
            return false;
        }
        let line = line.clean();
        self.size += line.size();
        self.waiting.push_back((line, is_private));
        while self.size > MAX_WAITING {
            if let Some((line, _)) = self.waiting.pop_front() {
                self.size -= line.size();
                self.first += 1;
                self.lost += 1;
            }
        }
        let is_first = self.send_at.is_none();
        let earliest = self.not_before.map_or(now, |at| at.max(now));
        self.send_at.get_or_insert(earliest);
        is_first
    }

    /// Returns how many lines were lost because the program logs faster than they can be sent.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Sends the lines that wait, because the program ends: as soon as the router receives them, and at that time in any case.
    pub fn flush(&mut self, now: Instant, at: Instant) {
        self.force_at = Some(at);
        if self.send_at.is_some() {
            self.send_at = Some(now);
        }
    }

    /// Returns whether all lines were sent.
    pub fn is_empty(&self) -> bool {
        // The last batch was sent when the driver is polled after it.
        self.waiting.is_empty() && self.send_at.is_none()
    }

    fn take(&mut self) -> Option<Batch> {
        let (_, private) = *self.waiting.front()?;
        let mut batch = Batch {
            run: self.run,
            first: self.first,
            private,
            lines: Vec::new(),
        };
        let mut size = 0;
        while size < BATCH {
            match self.waiting.pop_front() {
                Some((line, is_private)) if is_private == private => {
                    size += line.size();
                    batch.lines.push(line);
                }
                Some(other) => {
                    self.waiting.push_front(other);
                    break;
                }
                None => break,
            }
        }
        self.size -= size;
        self.first += batch.lines.len() as u64;
        Some(batch)
    }
}

impl Driver for Outbox {
    type Item = std::convert::Infallible;
    type Output = ();

    fn on_event(&mut self, _now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Closed => self.is_closed = true,
            Event::Matching { matching, .. } => self.is_received = matching,
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, ()> {
        if self.is_closed {
            return Step::Finished(());
        }
        if !std::mem::replace(&mut self.is_declared, true) {
            let declaration = Declaration::Publisher {
                key: self.key.clone(),
                qos: QOS,
                observes_matching: true,
            };
            let id = PUBLISHER;
            return Step::Act(Action::Declare { id, declaration });
        }
        match self.send_at {
            Some(_) if !self.is_received && self.force_at.is_none_or(|at| at > now) => {
                Step::Wait(self.force_at)
            }
            Some(at) if at <= now => match self.take() {
                Some(batch) => Step::Act(Action::Put {
                    publisher: PUBLISHER,
                    payload: batch.write(),
                    attachment: None,
                }),
                None => {
                    self.send_at = None;
                    self.not_before = Some(now + TOGETHER);
                    Step::Wait(None)
                }
            },
            at => Step::Wait(at),
        }
    }
}

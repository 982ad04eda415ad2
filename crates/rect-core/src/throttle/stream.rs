//! Decides which messages of a topic are sent to a robot, and when.
use std::time::{Duration, Instant};

use bytes::Bytes;

use super::wishes::Asked;
use crate::message::{payload::Payload, throttled::header::Header};

/// The messages of a topic for a robot.
#[derive(Debug)]
pub(super) struct Stream {
    asked: Asked,
    /// The number of messages that were sent.
    sent: u8,
    is_first: bool,
    /// When the next message may be sent.
    earliest: Instant,
    /// The newest message, if it was not sent.
    waiting: Option<Received>,
    last: Option<Received>,
    /// When the last message is repeated.
    repeat_at: Option<Instant>,
}

/// A message of a program.
#[derive(Clone, Debug)]
pub(super) struct Received {
    pub(super) payload: Payload,
    pub(super) attachment: Option<Bytes>,
}

impl Stream {
    pub(super) fn new(asked: Asked, now: Instant) -> Self {
        Self {
            asked,
            sent: 0,
            is_first: true,
            earliest: now,
            waiting: None,
            last: None,
            repeat_at: None,
        }
    }

    /// Sets what the robot asks for now.
    pub(super) fn set_asked(&mut self, asked: Asked) {
        if asked.interval < self.asked.interval {
            // The longer interval does not delay the next message.
            let sooner = self
                .earliest
                .checked_sub(self.asked.interval - asked.interval);
            self.earliest = sooner.unwrap_or(self.earliest);
        }
        self.asked = asked;
    }

    /// Handles a message. Returns whether to poll.
    pub(super) fn on_message(&mut self, received: Received, now: Instant) -> bool {
        if self.asked.on_change && self.is_last(&received.payload) {
            self.waiting = None;
            return false;
        }
        let was_waiting = self.waiting.replace(received).is_some();
        !was_waiting || self.is_due(now)
    }

    /// Returns the payload and the attachment of a message that is due.
    pub(super) fn poll(&mut self, now: Instant) -> Option<(Payload, Vec<u8>)> {
        if self.waiting.is_some() && self.is_due(now) {
            let interval = self.asked.interval;
            self.earliest = (self.earliest + interval).max(now);
            let slowest = self.asked.slowest;
            self.repeat_at = (slowest > interval).then(|| now + slowest);
            let waiting = self.waiting.take()?;
            return Some(self.send(waiting, false));
        }
        if self.repeat_at.is_some_and(|at| at <= now) {
            self.repeat_at = None;
            let last = self.last.take()?;
            return Some(self.send(last, true));
        }
        None
    }

    /// Returns when something is due.
    pub(super) fn due(&self) -> Option<Instant> {
        let waiting = self.waiting.as_ref().map(|_| self.earliest);
        [waiting, self.repeat_at].into_iter().flatten().min()
    }

    /// Returns whether the next message may be sent. The intervals of a publisher vary, and one that publishes as fast as is asked for
    /// is not delayed.
    fn is_due(&self, now: Instant) -> bool {
        now + self.asked.interval / 8 >= self.earliest
    }

    fn is_last(&self, payload: &Payload) -> bool {
        let last = self.last.as_ref();
        last.is_some_and(|last| last.payload == *payload)
    }

    fn send(&mut self, message: Received, repeats: bool) -> (Payload, Vec<u8>) {
        let header = Header {
            number: self.sent,
            is_unchanged: repeats || self.is_last(&message.payload),
            is_first: self.is_first,
            repeats,
        };
        self.sent = self.sent.wrapping_add(1);
        self.is_first = false;
        let attachment = header.encode(message.attachment.as_deref());
        let payload = message.payload.clone();
        self.last = Some(message);
        (payload, attachment)
    }
}

impl Asked {
    /// The wishes of nobody.
    pub(super) const NOTHING: Self = Self {
        interval: Duration::MAX,
        slowest: Duration::ZERO,
        on_change: true,
    };
}

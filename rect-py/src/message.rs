//! Makes messages from the samples that Zenoh delivers, and counts missed ones.
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use bytes::Bytes;
use pyo3::prelude::*;
use rect_core::{
    clock::unix::ms_since_1970,
    message::{
        self,
        encoding::Encoding,
        payload::Payload,
        retained::{Arrival, Following},
        Delivery, Message, Undelivered,
    },
    name::{
        key::{Audience, Selected},
        topic::Pattern,
        Name,
    },
};

use crate::{
    errors::OrRaise,
    key_space::{self, KeySpace},
    urgency,
};

/// The state of one subscription: the counts and the sequence numbers of its senders.
#[pyclass(frozen, module = "rect._rect")]
pub struct Inbound(Mutex<message::Inbound>);

/// The fields of a message except its payload.
#[pyclass(frozen, module = "rect._rect")]
pub struct MessageMetadata {
    message: Message,
    arrived_at: Instant,
}

#[pymethods]
impl Inbound {
    /// Creates the state of a subscription to a pattern.
    #[new]
    fn new(key_space: &KeySpace, pattern: &str) -> PyResult<Self> {
        let pattern = Pattern::new(pattern).or_raise()?;
        let selected = key_space.0.subscriptions(&pattern);
        Ok(Self::of(key_space, selected.into()))
    }

    /// Creates the state of the subscriptions of a recorder.
    #[staticmethod]
    fn of_recorder(key_space: &KeySpace, patterns: Vec<String>) -> PyResult<Self> {
        let selected = key_space.0.recorded(&key_space::patterns(&patterns)?);
        Ok(Self::of(key_space, selected))
    }

    /// Returns the key expressions to subscribe to. The number of one of them is that of `OnMessage`.
    fn keys(&self) -> Vec<String> {
        let inbound = self.inbound();
        let keys = inbound
            .selected()
            .iter()
            .map(|selected| selected.key.clone());
        keys.collect()
    }

    /// Returns the number of received and missed messages of each sender.
    fn counts_by_sender(&self) -> Vec<(String, u64, u64)> {
        let inbound = self.inbound();
        let counts = inbound.counts_by_sender();
        counts
            .map(|(robot, counts)| (robot.to_string(), counts.received, counts.missed))
            .collect()
    }
}

impl Inbound {
    fn of(key_space: &KeySpace, selected: Vec<Selected>) -> Self {
        let inbound = message::Inbound::new(key_space.0.clone(), selected, Instant::now());
        Self(Mutex::new(inbound))
    }

    /// Makes a message from a sample, or returns the reason why the sample is not delivered.
    pub fn on_delivery(
        &self,
        key: &str,
        attachment: Option<&[u8]>,
        priority: u8,
        is_deleted: bool,
        subscription: usize,
    ) -> Result<MessageMetadata, Undelivered> {
        let delivered = Delivery {
            key,
            // The payload bytes stay in Python: the core does not need them.
            payload: Payload::new(Bytes::new(), Encoding::BYTES),
            attachment,
            priority,
            is_deleted,
            subscription,
        };
        let delivered = self.inbound().on_delivery(delivered, Instant::now);
        delivered.map(MessageMetadata::of)
    }

    /// Returns the key expressions of messages to all robots.
    pub fn keys_of_all(&self) -> Vec<String> {
        let inbound = self.inbound();
        let all = (inbound.selected().iter()).filter(|one| one.audience == Audience::All);
        all.map(|selected| selected.key.clone()).collect()
    }

    /// Lets retained messages come through the router alone, if it can.
    pub fn follow(&self, following: Following) {
        self.inbound().follow(following);
    }

    /// Returns the messages of retained values that are selected and were not delivered before.
    pub fn on_retained(&self, arrival: &Arrival) -> Vec<Message> {
        self.inbound().on_retained(arrival)
    }

    fn inbound(&self) -> MutexGuard<'_, message::Inbound> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MessageMetadata {
    /// Wraps a message that has just arrived, and whose payload is not used.
    pub fn of(message: Message) -> Self {
        Self {
            message,
            arrived_at: Instant::now(),
        }
    }

    /// Returns when the message arrived at this program.
    pub fn arrived_at(&self) -> Instant {
        self.arrived_at
    }

    /// Returns the message without its payload.
    pub fn message(&self) -> Message {
        self.message.clone()
    }

    pub fn sender_name(&self) -> &Name {
        &self.message.sender
    }
}

#[pymethods]
impl MessageMetadata {
    #[getter]
    fn sender(&self) -> &str {
        self.message.sender.as_str()
    }

    #[getter]
    fn recipient(&self) -> Option<&str> {
        self.message.recipient.as_ref().map(|name| name.as_str())
    }

    #[getter]
    fn topic(&self) -> &str {
        self.message.topic.as_str()
    }

    #[getter]
    fn urgency(&self) -> &'static str {
        urgency::as_str(self.message.urgency)
    }

    #[getter]
    fn sent_at_ms(&self) -> Option<u64> {
        self.message.sent_at.map(ms_since_1970)
    }

    #[getter]
    fn sequence(&self) -> Option<u32> {
        self.message.sequence
    }

    #[getter]
    pub fn missed(&self) -> u32 {
        self.message.missed
    }

    /// Whether the message has expired.
    #[getter]
    fn is_expired(&self) -> bool {
        self.message.is_expired(Instant::now())
    }

    #[getter]
    fn late(&self) -> bool {
        self.message.late
    }

    #[getter]
    fn replayed(&self) -> bool {
        self.message.replayed
    }

    /// The age of a retained value in seconds, whether its program has ended, and whether its topic is forgotten.
    #[getter]
    fn retained(&self) -> Option<(f64, bool, bool)> {
        let retained = self.message.retained?;
        let age_s = retained.age.as_secs_f64();
        Some((age_s, retained.has_ended, retained.is_forgotten))
    }
}

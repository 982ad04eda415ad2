//! Makes messages from the samples that Zenoh delivers, and counts missed ones.
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use bytes::Bytes;
use pyo3::prelude::*;
use rect::core::{
    encoding::Encoding,
    message::{self, Delivery, Message, Undelivered},
    name::Name,
    payload::Payload,
};

use crate::{key_space::KeySpace, urgency};

/// The state of one subscription: the counts and the sequence numbers of its senders.
#[pyclass(frozen, module = "rect._rect")]
pub struct Inbound(Mutex<message::Inbound>);

/// The fields of a message except its payload.
#[pyclass(frozen, module = "rect._rect")]
pub struct MessageMetadata(Message);

#[pymethods]
impl Inbound {
    #[new]
    fn new(key_space: &KeySpace) -> Self {
        Self(Mutex::new(message::Inbound::new(
            key_space.0.clone(),
            Instant::now(),
        )))
    }

    /// Makes a message from a sample. Returns `None` if the sample is not a message for this robot, if its topic is
    /// invalid, if it has expired, or if another Zenoh subscriber delivers it. `directed` is whether the subscriber's key is that of
    /// messages sent to this robot alone.
    #[pyo3(name = "on_delivery")]
    fn on_delivered_or_none(
        &self,
        key: &str,
        attachment: Option<&[u8]>,
        priority: u8,
        directed: bool,
    ) -> Option<MessageMetadata> {
        self.on_delivery(key, attachment, priority, directed).ok()
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
    /// Makes a message from a sample, or returns the reason why the sample is not delivered.
    pub fn on_delivery(
        &self,
        key: &str,
        attachment: Option<&[u8]>,
        priority: u8,
        directed: bool,
    ) -> Result<MessageMetadata, Undelivered> {
        let delivered = Delivery {
            key,
            // The payload bytes stay in Python: the core does not need them.
            payload: Payload::new(Bytes::new(), Encoding::BYTES),
            attachment,
            priority,
            directed,
        };
        let delivered = self.inbound().on_delivery(delivered, Instant::now);
        delivered.map(MessageMetadata)
    }

    fn inbound(&self) -> MutexGuard<'_, message::Inbound> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl MessageMetadata {
    /// Wraps a message, whose payload is not used.
    pub fn of(message: Message) -> Self {
        Self(message)
    }

    /// Returns the message without its payload.
    pub fn message(&self) -> Message {
        self.0.clone()
    }

    pub fn sender_name(&self) -> &Name {
        &self.0.sender
    }
}

#[pymethods]
impl MessageMetadata {
    #[getter]
    fn sender(&self) -> &str {
        self.0.sender.as_str()
    }

    #[getter]
    fn recipient(&self) -> Option<&str> {
        self.0.recipient.as_ref().map(|name| name.as_str())
    }

    #[getter]
    fn topic(&self) -> &str {
        self.0.topic.as_str()
    }

    #[getter]
    fn urgency(&self) -> &'static str {
        urgency::as_str(self.0.urgency)
    }

    #[getter]
    fn sent_ms(&self) -> Option<u64> {
        self.0.sent_ms
    }

    #[getter]
    fn sequence(&self) -> Option<u32> {
        self.0.sequence
    }

    #[getter]
    pub fn missed(&self) -> u32 {
        self.0.missed
    }

    /// Whether the message has expired.
    #[getter]
    fn is_expired(&self) -> bool {
        self.0.is_expired(Instant::now())
    }

    #[getter]
    fn late(&self) -> bool {
        self.0.late
    }

    #[getter]
    fn replayed(&self) -> bool {
        self.0.replayed
    }
}

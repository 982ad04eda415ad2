//! Makes messages from the samples that Zenoh delivers, and counts missed ones.
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant, UNIX_EPOCH},
};

use bytes::Bytes;
use pyo3::prelude::*;
use rect_core::{
    clock::unix::ms_since_1970,
    message::{
        self,
        encoding::Encoding,
        payload::Payload,
        retained::{Arrival, Following, Retained},
        throttled::Wish,
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
    /// Creates the state of a subscription to a pattern: to all messages, to at most `max_hz` per second, or to those whose value differs.
    #[new]
    #[pyo3(signature = (key_space, pattern, max_hz=None, on_change=false))]
    fn new(
        key_space: &KeySpace,
        pattern: &str,
        max_hz: Option<f64>,
        on_change: bool,
    ) -> PyResult<Self> {
        let pattern = Pattern::new(pattern).or_raise()?;
        let wish = Wish::new(max_hz, on_change).or_raise()?;
        let place = key_space.0.clone();
        let inbound = message::Inbound::of_pattern(place, &pattern, wish, Instant::now());
        Ok(Self(Mutex::new(inbound)))
    }

    /// Creates the state of the subscriptions of a recorder.
    #[staticmethod]
    fn of_recorder(key_space: &KeySpace, patterns: Vec<String>) -> PyResult<Self> {
        let selected = key_space.0.recorded(&key_space::patterns(&patterns)?);
        Ok(Self::of(key_space, selected))
    }

    /// Returns the key expressions to subscribe to. The number of one of them is that of `OnMessage`.
    fn keys(&self) -> Vec<String> {
        self.inbound().keys()
    }

    /// Returns the key of the token by which a throttled subscription asks for messages.
    fn token(&self) -> Option<String> {
        self.inbound().token().map(str::to_owned)
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

/// Sender, recipient, topic, urgency, time of sending, numbers, flags, the seconds until the message expires (negative: since it
/// has expired), and what is known of a retained value.
type Fields = (
    String,
    Option<String>,
    String,
    String,
    Option<u64>,
    Option<u32>,
    Option<u16>,
    u32,
    bool,
    bool,
    Option<f64>,
    Option<(f64, bool, bool)>,
);

#[pymethods]
impl MessageMetadata {
    /// Makes the metadata that `__reduce__` has described.
    #[new]
    fn new(py: Python<'_>, fields: Fields) -> PyResult<Self> {
        let (sender, recipient, topic, urgency, sent_at_ms, sequence, publisher) = (
            fields.0, fields.1, fields.2, fields.3, fields.4, fields.5, fields.6,
        );
        let (missed, late, replayed, expires_s, retained) =
            (fields.7, fields.8, fields.9, fields.10, fields.11);
        let recipient = recipient.as_deref().map(key_space::name).transpose()?;
        let now = Instant::now();
        let of_s = |s: f64| Duration::try_from_secs_f64(s).unwrap_or_default();
        let expires_at = expires_s.map(|s| match s < 0.0 {
            true => now.checked_sub(of_s(-s)).unwrap_or(now),
            false => now + of_s(s),
        });
        let message = Message {
            recipient,
            urgency: urgency::parse(py, &urgency)?,
            sent_at: sent_at_ms.and_then(|ms| UNIX_EPOCH.checked_add(Duration::from_millis(ms))),
            sequence,
            publisher,
            missed,
            late,
            replayed,
            expires_at,
            retained: retained.map(|(age_s, has_ended, is_forgotten)| Retained {
                age: of_s(age_s),
                has_ended,
                is_forgotten,
            }),
            ..Message::new(
                key_space::name(&sender)?,
                key_space::topic(&topic)?,
                Payload::new(Bytes::new(), Encoding::BYTES),
            )
        };
        Ok(Self::of(message))
    }

    /// Returns how `pickle` and `copy` make the same metadata.
    fn __reduce__<'py>(this: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (Fields,)) {
        let message = &this.get().message;
        let now = Instant::now();
        let expires_s = message.expires_at.map(|at| match at < now {
            true => -(now - at).as_secs_f64(),
            false => (at - now).as_secs_f64(),
        });
        let fields = (
            message.sender.to_string(),
            message.recipient.as_ref().map(Name::to_string),
            message.topic.to_string(),
            urgency::as_str(message.urgency).to_owned(),
            this.get().sent_at_ms(),
            message.sequence,
            message.publisher,
            message.missed,
            message.late,
            message.replayed,
            expires_s,
            this.get().retained(),
        );
        (this.get_type().into_any(), (fields,))
    }

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

    #[getter]
    fn skipped(&self) -> u32 {
        self.message.skipped
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

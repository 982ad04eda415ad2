//! Owns making messages of what Zenoh delivers, and what is missing among them.
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use pyo3::prelude::*;
use rect::core::{
    encoding::Encoding,
    key::NoMessage,
    message::{self, Delivered, Message},
    name::Name,
    payload::Payload,
};

use crate::{place::Place, urgency};

/// The messages of one subscription.
#[pyclass(frozen, module = "rect._rect")]
pub struct Inbound(Mutex<message::Inbound>);

/// What a message says of itself, beside its payload.
#[pyclass(frozen, module = "rect._rect")]
pub struct Said(Message);

#[pymethods]
impl Inbound {
    #[new]
    fn new(place: &Place) -> Self {
        Self(Mutex::new(message::Inbound::new(place.0.clone())))
    }

    /// A message; `None`: none for this robot, or one that the other subscription brings.
    #[pyo3(name = "on_delivered")]
    fn on_delivered_or_none(
        &self,
        key: &str,
        attachment: Option<&[u8]>,
        priority: u8,
        directed: bool,
    ) -> Option<Said> {
        self.on_delivered(key, attachment, priority, directed).ok()
    }

    /// What came of each robot, and what did not.
    fn tallies(&self) -> Vec<(String, u64, u64)> {
        let inbound = self.inbound();
        let tallies = inbound.tallies();
        tallies
            .map(|(robot, tally)| (robot.to_string(), tally.received, tally.missed))
            .collect()
    }
}

impl Inbound {
    /// Makes the message, or says why there is none.
    pub fn on_delivered(
        &self,
        key: &str,
        attachment: Option<&[u8]>,
        priority: u8,
        directed: bool,
    ) -> Result<Said, NoMessage> {
        let delivered = Delivered {
            key,
            // The bytes stay Python's; the core passes them on without looking.
            payload: Payload::new(Bytes::new(), Encoding::BYTES),
            attachment,
            priority,
            directed,
        };
        self.inbound().on_delivered(delivered).map(Said)
    }

    fn inbound(&self) -> MutexGuard<'_, message::Inbound> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Said {
    pub fn from(&self) -> &Name {
        &self.0.from
    }
}

#[pymethods]
impl Said {
    #[getter]
    fn sender(&self) -> &str {
        self.0.from.as_str()
    }

    #[getter]
    fn to(&self) -> Option<&str> {
        self.0.to.as_ref().map(|to| to.as_str())
    }

    #[getter]
    fn topic(&self) -> &str {
        self.0.topic.as_str()
    }

    #[getter]
    fn urgency(&self) -> &'static str {
        urgency::word(self.0.urgency)
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

    #[getter]
    fn late(&self) -> bool {
        self.0.late
    }
}

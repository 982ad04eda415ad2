//! Publishes the messages of one topic: holds the Zenoh publisher and the numbering of its messages.
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tokio::{runtime::Handle, task::JoinHandle};
use zenoh::{bytes::Encoding as ZenohEncoding, pubsub::Publisher, Session, Wait};

use super::{
    convert::{attachment, now_ms},
    queries,
};
use crate::error::Error;
use rect_core::{
    message::{
        attachment::Sent, counters::AtomicCounters, encoding::Encoding, payload::Payload,
        urgency::Qos,
    },
    session::publication::{Numbering, LARGE_BYTES},
};

#[derive(Debug)]
pub(super) struct Publication {
    publisher: Publisher<'static>,
    state: Mutex<State>,
    counting: Arc<AtomicCounters>,
}

/// A message that Zenoh has taken, or that a thread waits to give it.
#[must_use]
pub(super) enum Put {
    Done,
    Waiting(JoinHandle<Result<(), Error>>),
}

impl Put {
    /// Waits until Zenoh has taken the message. Does not need the caller's runtime.
    pub(super) async fn done(self) -> Result<(), Error> {
        match self {
            Self::Done => Ok(()),
            Self::Waiting(put) => put.await.map_err(|_| Error::Closed)?,
        }
    }
}

#[derive(Debug)]
struct State {
    numbering: Numbering,
    /// The encoding of the last message, as RECT's and as Zenoh's type, whose lookup is slow.
    encoding: (Encoding, ZenohEncoding),
}

impl Publication {
    pub(super) fn declare(
        session: &Session,
        key: String,
        qos: Qos,
        counting: Arc<AtomicCounters>,
    ) -> Result<Self, Error> {
        Ok(Self {
            counting,
            publisher: queries::publisher(session, key, qos)?,
            state: Mutex::new(State {
                numbering: Numbering::new(rand::random()),
                encoding: (Encoding::BYTES, ZenohEncoding::ZENOH_BYTES),
            }),
        })
    }

    /// Publishes a payload, which repeats that of a message of `recorded_ms` if there is one, and counts it. Waits while the link has
    /// no room, for a large payload in another thread.
    pub(super) fn put(
        self: &Arc<Self>,
        payload: Payload,
        recorded_ms: Option<u64>,
        lifetime: Option<Duration>,
        runtime: &Handle,
    ) -> Result<Put, Error> {
        if payload.bytes.len() < LARGE_BYTES {
            self.put_now(payload, recorded_ms, lifetime)?;
            return Ok(Put::Done);
        }
        let publication = self.clone();
        let put = move || publication.put_now(payload, recorded_ms, lifetime);
        Ok(Put::Waiting(runtime.spawn_blocking(put)))
    }

    /// Returns the Zenoh publisher.
    pub(super) fn publisher(&self) -> &Publisher<'static> {
        &self.publisher
    }

    fn put_now(
        &self,
        payload: Payload,
        recorded_ms: Option<u64>,
        lifetime: Option<Duration>,
    ) -> Result<(), Error> {
        // Locked while the message is sent, so that messages of two threads are sent in the order of their numbers.
        let mut state = self.state();
        if state.encoding.0 != payload.encoding {
            let same = ZenohEncoding::from(payload.encoding.as_str());
            state.encoding = (payload.encoding, same);
        }
        let bytes = payload.bytes.len();
        let sent = recorded_ms.map_or_else(|| Sent::At(now_ms()), Sent::Replayed);
        let put = self
            .publisher
            .put(payload.bytes)
            .encoding(state.encoding.1.clone())
            .attachment(attachment(state.numbering.attachment(sent, lifetime)));
        put.wait()
            .map_err(Error::zenoh("cannot send the message"))?;
        state.numbering.on_sent();
        self.counting.on_sent(bytes);
        Ok(())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

//! Publishes the messages of one topic: holds the Zenoh publisher and the numbering of its messages.
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tokio::runtime::Handle;
use zenoh::{bytes::Encoding as ZenohEncoding, pubsub::Publisher, Session, Wait};

use super::{convert::now_ms, queries};
use crate::{
    core::{
        attachment::Sent,
        encoding::Encoding,
        payload::Payload,
        publication::{Numbering, LARGE_BYTES},
        urgency::Qos,
    },
    error::Error,
};

#[derive(Debug)]
pub(super) struct Publication {
    publisher: Publisher<'static>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    numbering: Numbering,
    /// The encoding of the last message, as RECT's and as Zenoh's type, whose lookup is slow.
    encoding: (Encoding, ZenohEncoding),
}

impl Publication {
    pub(super) fn declare(session: &Session, key: String, qos: Qos) -> Result<Self, Error> {
        Ok(Self {
            publisher: queries::publisher(session, key, qos)?,
            state: Mutex::new(State {
                numbering: Numbering::new(rand::random()),
                encoding: (Encoding::BYTES, ZenohEncoding::ZENOH_BYTES),
            }),
        })
    }

    /// Publishes a payload, which repeats that of a message of `recorded_ms` if there is one; waits while the link has no room. Does not
    /// need the caller's runtime.
    pub(super) async fn put(
        self: Arc<Self>,
        payload: Payload,
        recorded_ms: Option<u64>,
        lifetime: Option<Duration>,
        runtime: &Handle,
    ) -> Result<(), Error> {
        if payload.bytes.len() < LARGE_BYTES {
            return self.put_now(payload, recorded_ms, lifetime);
        }
        let put = runtime.spawn_blocking(move || self.put_now(payload, recorded_ms, lifetime));
        put.await.map_err(|_| Error::Closed)?
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
        let sent = recorded_ms.map_or_else(|| Sent::At(now_ms()), Sent::Replayed);
        let put = self
            .publisher
            .put(payload.bytes)
            .encoding(state.encoding.1.clone())
            .attachment(state.numbering.attachment(sent, lifetime));
        put.wait()
            .map_err(Error::zenoh("cannot send the message"))?;
        state.numbering.on_sent();
        Ok(())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

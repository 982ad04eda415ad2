//! Publishes the messages of one topic: holds the Zenoh publisher and numbers its messages.
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{SystemTime, UNIX_EPOCH},
};

use tokio::runtime::Handle;
use zenoh::{
    bytes::Encoding as ZenohEncoding,
    pubsub::Publisher,
    qos::{CongestionControl, Priority},
    Session, Wait,
};

use crate::{
    core::{
        attachment::{Attachment, Sent},
        encoding::Encoding,
        payload::Payload,
        urgency::Qos,
    },
    error::Error,
};

/// Payloads of this size and above are sent on a blocking thread, since they may have to wait for room in a queue.
const LARGE_BYTES: usize = 16 * 1024;

#[derive(Debug)]
pub(super) struct Publication {
    publisher: Publisher<'static>,
    source: u16,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    next_sequence: u32,
    /// The encoding of the last message, as RECT's and as Zenoh's type, whose lookup is slow.
    encoding: (Encoding, ZenohEncoding),
}

impl Publication {
    pub(super) fn declare(session: &Session, key: String, qos: Qos) -> Result<Self, Error> {
        let congestion_control = if qos.droppable {
            CongestionControl::Drop
        } else {
            CongestionControl::Block
        };
        let publisher = session
            .declare_publisher(key)
            .priority(priority(qos))
            .express(qos.express)
            .congestion_control(congestion_control)
            .wait()
            .map_err(Error::zenoh("cannot declare the publisher"))?;
        Ok(Self {
            publisher,
            source: rand::random(),
            state: Mutex::new(State {
                next_sequence: 0,
                encoding: (Encoding::BYTES, ZenohEncoding::ZENOH_BYTES),
            }),
        })
    }

    /// Publishes a payload; waits while the link has no room. Does not need the caller's runtime.
    pub(super) async fn put(
        self: Arc<Self>,
        payload: Payload,
        runtime: &Handle,
    ) -> Result<(), Error> {
        if payload.bytes.len() < LARGE_BYTES {
            return self.put_now(payload);
        }
        let put = runtime.spawn_blocking(move || self.put_now(payload));
        put.await.map_err(|_| Error::Closed)?
    }

    fn put_now(&self, payload: Payload) -> Result<(), Error> {
        // Locked while the message is sent, so that messages of two threads are sent in the order of their numbers.
        let mut state = self.state();
        if state.encoding.0 != payload.encoding {
            let same = ZenohEncoding::from(payload.encoding.as_str());
            state.encoding = (payload.encoding, same);
        }
        let attachment = Attachment {
            source: self.source,
            sequence: state.next_sequence,
            sent: Sent::At(now_ms()),
        };
        let put = self
            .publisher
            .put(payload.bytes)
            .encoding(state.encoding.1.clone())
            .attachment(attachment.encode());
        put.wait()
            .map_err(Error::zenoh("cannot send the message"))?;
        state.next_sequence = state.next_sequence.wrapping_add(1);
        Ok(())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(super) fn priority(qos: Qos) -> Priority {
    Priority::try_from(qos.priority).unwrap_or_default()
}

/// Returns the time of this computer's clock, in milliseconds since 1970.
pub(super) fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| u64::try_from(since.as_millis()).unwrap_or(0))
}

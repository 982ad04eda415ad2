//! Owns what a program says about one topic: a publisher of Zenoh's, and the numbers of its messages.
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

/// Larger ones than this may have to wait for room, and do so on a thread of their own.
const LARGE_BYTES: usize = 16 * 1024;

#[derive(Debug)]
pub(super) struct Publication {
    publisher: Publisher<'static>,
    source: u16,
    speaking: Mutex<Speaking>,
}

#[derive(Debug)]
struct Speaking {
    next: u32,
    /// What the last message was, in our words and in Zenoh's, which it takes a while to look up.
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
            .map_err(Error::zenoh("the publisher is refused"))?;
        Ok(Self {
            publisher,
            source: rand::random(),
            speaking: Mutex::new(Speaking {
                next: 0,
                encoding: (Encoding::BYTES, ZenohEncoding::ZENOH_BYTES),
            }),
        })
    }

    /// Says it; waits where the link has no room. Needs no runtime of who speaks.
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
        // Held while it is sent: two threads' messages go out in the order of their numbers.
        let mut speaking = self.speaking();
        if speaking.encoding.0 != payload.encoding {
            let same = ZenohEncoding::from(payload.encoding.as_str());
            speaking.encoding = (payload.encoding, same);
        }
        let attachment = Attachment {
            source: self.source,
            sequence: speaking.next,
            sent: Sent::At(now_ms()),
        };
        let put = self
            .publisher
            .put(payload.bytes)
            .encoding(speaking.encoding.1.clone())
            .attachment(attachment.encode());
        put.wait()
            .map_err(Error::zenoh("the message is not sent"))?;
        speaking.next = speaking.next.wrapping_add(1);
        Ok(())
    }

    fn speaking(&self) -> MutexGuard<'_, Speaking> {
        self.speaking.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

pub(super) fn priority(qos: Qos) -> Priority {
    Priority::try_from(qos.priority).unwrap_or_default()
}

/// Milliseconds since 1970, by this computer's clock.
pub(super) fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| u64::try_from(since.as_millis()).unwrap_or(0))
}

//! Publishes the messages of one topic: holds the Zenoh publisher and the numbering of its messages.
use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime},
};

use rect_core::{
    clock::unix::ms_since_1970,
    message::{
        attachment::Sent, counters::AtomicCounters, encoding::Encoding, payload::Payload,
        urgency::Qos,
    },
    session::publication::{Numbering, LARGE_BYTES},
};
use tokio::{runtime::Handle, sync::oneshot, task};
use zenoh::{bytes::Encoding as ZenohEncoding, pubsub::Publisher, Session, Wait};

use super::{convert::attachment, queries};
use crate::error::Error;

/// One topic's publisher. Its messages are sent one after the other, in the order of their numbers.
#[derive(Debug)]
pub(super) struct Publication {
    publisher: Publisher<'static>,
    state: Mutex<State>,
    counting: Arc<AtomicCounters>,
}

/// A message that Zenoh has taken, or that another thread gives it.
#[must_use]
pub(super) enum Put {
    Done,
    Waiting(oneshot::Receiver<Result<(), Error>>),
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
    /// Whether a thread has the [`Turn`].
    is_sending: bool,
    /// The messages behind the one that is sent.
    waiting: VecDeque<Waiting>,
}

/// A message to publish.
#[derive(Debug)]
struct Outgoing {
    payload: Payload,
    /// When the message was sent that this one repeats, in milliseconds since 1970.
    recorded_ms: Option<u64>,
    lifetime: Option<Duration>,
}

#[derive(Debug)]
struct Waiting {
    outgoing: Outgoing,
    sent: oneshot::Sender<Result<(), Error>>,
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
                is_sending: false,
                waiting: VecDeque::new(),
            }),
        })
    }

    /// Publishes a payload, which repeats that of a message of `recorded_ms` if there is one, and counts it.
    ///
    /// Zenoh blocks the sending thread while the link has no room. A task of tokio must not block its worker, and a large
    /// payload blocks for long: these are sent by a thread for blocking work. Any other thread sends the message itself, unless
    /// another message of this topic is being sent.
    pub(super) fn put(
        self: &Arc<Self>,
        payload: Payload,
        recorded_ms: Option<u64>,
        lifetime: Option<Duration>,
        runtime: &Handle,
    ) -> Result<Put, Error> {
        let may_block = payload.bytes.len() < LARGE_BYTES && task::try_id().is_none();
        let outgoing = Outgoing {
            payload,
            recorded_ms,
            lifetime,
        };
        let mut state = self.state();
        if may_block && !state.is_sending {
            state.is_sending = true;
            drop(state);
            let turn = Turn::of(self);
            let sent = self.send(outgoing);
            turn.pass_on(runtime);
            return sent.map(|()| Put::Done);
        }
        let (sent, put) = oneshot::channel();
        state.waiting.push_back(Waiting { outgoing, sent });
        if !state.is_sending {
            state.is_sending = true;
            drop(state);
            Turn::of(self).pass_on(runtime);
        }
        Ok(Put::Waiting(put))
    }

    /// Returns the Zenoh publisher.
    pub(super) fn publisher(&self) -> &Publisher<'static> {
        &self.publisher
    }

    /// Gives a message to Zenoh. Only the thread that has the turn calls it, so that messages are sent in the order of their
    /// numbers although the lock is not held while Zenoh blocks.
    fn send(&self, outgoing: Outgoing) -> Result<(), Error> {
        let Outgoing {
            payload,
            recorded_ms,
            lifetime,
        } = outgoing;
        let bytes = payload.bytes.len();
        let sent = recorded_ms.map_or_else(
            || Sent::At(ms_since_1970(SystemTime::now())),
            Sent::Replayed,
        );
        let mut state = self.state();
        if state.encoding.0 != payload.encoding {
            let same = ZenohEncoding::from(payload.encoding.as_str());
            state.encoding = (payload.encoding, same);
        }
        let put = self
            .publisher
            .put(payload.bytes)
            .encoding(state.encoding.1.clone())
            .attachment(attachment(state.numbering.attachment(sent, lifetime)));
        drop(state);
        put.wait()
            .map_err(Error::zenoh("cannot send the message"))?;
        self.state().numbering.on_sent();
        self.counting.on_sent(bytes);
        Ok(())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The right to send messages, which one thread has at a time. Dropping it rejects the messages that wait: their thread has
/// panicked, or the runtime has ended.
struct Turn {
    publication: Arc<Publication>,
    has_ended: bool,
}

impl Turn {
    fn of(publication: &Arc<Publication>) -> Self {
        Self {
            publication: publication.clone(),
            has_ended: false,
        }
    }

    /// Ends the turn. If messages wait, a thread for blocking work sends them.
    fn pass_on(mut self, runtime: &Handle) {
        if !self.end_if_idle() {
            runtime.spawn_blocking(move || self.send_waiting());
        }
    }

    fn send_waiting(mut self) {
        while !self.end_if_idle() {
            let next = self.publication.state().waiting.pop_front();
            if let Some(Waiting { outgoing, sent }) = next {
                // The program may have dropped its future; the message is published nevertheless.
                let _ = sent.send(self.publication.send(outgoing));
            }
        }
    }

    /// Ends the turn if no message waits, and returns whether it has ended.
    fn end_if_idle(&mut self) -> bool {
        let mut state = self.publication.state();
        if state.waiting.is_empty() {
            state.is_sending = false;
            self.has_ended = true;
        }
        self.has_ended
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        if !self.has_ended {
            let mut state = self.publication.state();
            state.is_sending = false;
            state.waiting.clear();
        }
    }
}

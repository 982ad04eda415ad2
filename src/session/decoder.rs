//! Decodes payloads that a sender's codec has encoded, fetches the dictionaries for that from the senders, and serves this
//! program's own dictionaries.
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use zenoh::{qos::Priority, query::Query, query::Queryable, Session, Wait};

use super::robot::Robot;
use crate::{
    core::{
        codec::{self, dictionary::DictionaryCodec, CodecError, Limits},
        dictionary::{Dictionary, RobotDictionaries},
        key::KeySpace,
        message::Message,
        name::Name,
        payload::Payload,
    },
    error::Error,
};

/// Timeout for fetching a dictionary: 100 kB take 3 s at 34 kB/s, and the link carries other traffic, too.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Shortest time between two attempts to fetch the same dictionary, so that not every message of a series waits for one.
const RETRY_AFTER: Duration = Duration::from_secs(30);
/// Largest number of dictionaries that are remembered as unavailable.
const MAX_MISSING: usize = 256;

/// Decodes the payloads that one program receives.
pub(super) struct Decoder {
    session: Session,
    place: KeySpace,
    limits: Limits,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    dictionaries: RobotDictionaries,
    missing: HashMap<(Name, u32), Instant>,
    served: HashMap<u32, Queryable<()>>,
}

impl Decoder {
    pub(super) fn new(session: &Session, place: &KeySpace) -> Arc<Self> {
        Arc::new(Self {
            session: session.clone(),
            place: place.clone(),
            limits: Limits::default(),
            state: Mutex::default(),
        })
    }

    /// Decodes a message's payload in place. If that fails, the payload stays encoded and the error is attached.
    pub(super) async fn decode_message(&self, message: &mut Message) {
        // Most payloads are not encoded and skip the asynchronous path.
        if codec::is_encoded(&message.payload.encoding) {
            let decoded = self.decode(&message.sender, &mut message.payload).await;
            message.problem = decoded.err();
        }
    }

    /// Decodes a message's payload in place, with the dictionaries that are already known.
    pub(super) fn decode_message_now(&self, message: &mut Message) {
        message.problem = self.decode_now(&message.sender, &mut message.payload).err();
    }

    /// Decodes a payload of the robot `sender` in place, fetching a missing dictionary; on an error the payload is unchanged.
    pub(super) async fn decode(
        &self,
        sender: &Name,
        payload: &mut Payload,
    ) -> Result<(), CodecError> {
        match self.decode_now(sender, payload) {
            // Boxed: this future is large and rarely needed, and would otherwise be moved with every message.
            Err(CodecError::Dictionary { id }) if Box::pin(self.fetch(sender, id)).await => {
                self.decode_now(sender, payload)
            }
            done => done,
        }
    }

    fn decode_now(&self, sender: &Name, payload: &mut Payload) -> Result<(), CodecError> {
        if codec::is_encoded(&payload.encoding) {
            let state = self.state();
            *payload = codec::decode(payload, &self.limits, state.dictionaries.of(sender))?;
        }
        Ok(())
    }

    /// Requests a dictionary from the sender; returns whether it is available now.
    async fn fetch(&self, sender: &Name, id: u32) -> bool {
        let dictionary_key = (sender.clone(), id);
        let asked = self.state().missing.get(&dictionary_key).copied();
        if asked.is_some_and(|asked| asked.elapsed() < RETRY_AFTER) {
            return false;
        }
        let key = self.key(sender, id);
        let asked = self.session.get(&key).timeout(TIMEOUT);
        let Ok(replies) = asked.priority(Priority::DataHigh).await else {
            return false;
        };
        let mut found = None;
        while let (None, Ok(reply)) = (&found, replies.recv_async().await) {
            let sample = reply.into_result().ok();
            let bytes = sample.map(|sample| sample.payload().to_bytes().into_owned());
            let dictionary = bytes.and_then(|bytes| Dictionary::new(bytes).ok());
            found = dictionary.filter(|dictionary| dictionary.id() == id);
        }
        let mut state = self.state();
        let added = found.is_some();
        if let Some(dictionary) = found {
            state.dictionaries.add(sender, Arc::new(dictionary));
        } else {
            tracing::warn!(
                "{sender} does not provide the dictionary {id}: messages that were compressed with it cannot be decoded"
            );
            if state.missing.len() >= MAX_MISSING {
                state.missing.clear();
            }
            state.missing.insert(dictionary_key, Instant::now());
        }
        added
    }

    /// Serves a dictionary to receivers until the session ends.
    fn share(&self, dictionary: &Arc<Dictionary>) -> Result<(), Error> {
        let id = dictionary.id();
        let mut state = self.state();
        if state.served.contains_key(&id) {
            return Ok(());
        }
        let key = self.key(&self.place.robot, id);
        let (key_of_answer, shared) = (key.clone(), dictionary.clone());
        let queryable = self.session.declare_queryable(key).complete(true);
        let queryable = queryable.callback(move |query: Query| {
            let reply = query.reply(&key_of_answer, shared.as_bytes()).wait();
            if let Err(error) = reply {
                tracing::debug!("cannot reply to a request for the dictionary {id}: {error}");
            }
        });
        let queryable = queryable
            .wait()
            .map_err(Error::zenoh("cannot share the dictionary"))?;
        state.served.insert(id, queryable);
        // A program may receive its own messages.
        state
            .dictionaries
            .add(&self.place.robot, dictionary.clone());
        Ok(())
    }

    /// Returns the key at which `robot` serves one of its dictionaries.
    fn key(&self, robot: &Name, id: u32) -> String {
        self.place.own(Some(robot), &format!("dictionary/{id}"))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Robot {
    /// Returns a handle that compresses the payloads of messages and requests with zstd and `dictionary`, which makes
    /// small JSON messages much smaller.
    ///
    /// Each receiver fetches the dictionary once. This program serves it until the session ends.
    ///
    /// ```no_run
    /// # async fn publish(robot: rect::Robot) -> Result<(), Box<dyn std::error::Error>> {
    /// let dictionary = rect::core::dictionary::Dictionary::read("telemetry.dictionary")?;
    /// let compressed = robot.with_dictionary(dictionary.into())?;
    /// compressed.publish("telemetry", rect::Json([1, 2, 3])).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Zenoh`] if the session is closed.
    pub fn with_dictionary(&self, dictionary: Arc<Dictionary>) -> Result<Self, Error> {
        self.inner.decoder.share(&dictionary)?;
        Ok(self.with_codec(Arc::new(DictionaryCodec::new(dictionary))))
    }
}

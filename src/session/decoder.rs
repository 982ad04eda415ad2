//! Owns undoing what a sender's codec has packed, and fetching the dictionaries for that from whoever made them.
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use zenoh::{qos::Priority, query::Query, query::Queryable, Session, Wait};

use super::robot::Robot;
use crate::{
    core::{
        codec::{self, dictionary::Packed, CodecError, Limits},
        dictionary::{Dictionary, RobotDictionaries},
        key::Place,
        message::Message,
        name::Name,
        payload::Payload,
    },
    error::Error,
};

/// How long a dictionary may take to come: 100 kB at 34 kB/s, and what else is on the link.
const PATIENCE: Duration = Duration::from_secs(5);
/// Who did not have it is asked again after this time at the earliest, so that a stream of messages of that kind does not
/// wait for each.
const ASK_AGAIN: Duration = Duration::from_secs(30);
/// The most dictionaries that are remembered as not to be had.
const MAX_MISSING: usize = 256;

/// What one program knows of codecs.
pub(super) struct Decoder {
    session: Session,
    place: Place,
    limits: Limits,
    known: Mutex<Known>,
}

#[derive(Default)]
struct Known {
    dictionaries: RobotDictionaries,
    missing: HashMap<(Name, u32), Instant>,
    served: HashMap<u32, Queryable<()>>,
}

impl Decoder {
    pub(super) fn new(session: &Session, place: &Place) -> Arc<Self> {
        Arc::new(Self {
            session: session.clone(),
            place: place.clone(),
            limits: Limits::default(),
            known: Mutex::default(),
        })
    }

    /// Makes it the message that was said. What can't be undone stays as it came, with what is wrong with it.
    pub(super) async fn message(&self, message: &mut Message) {
        // Most are not: what unpacks them is not entered.
        if codec::is_packed(&message.payload.encoding) {
            let unpacked = self.unpack(&message.from, &mut message.payload).await;
            message.flaw = unpacked.err();
        }
    }

    /// The same with what is known already.
    pub(super) fn message_now(&self, message: &mut Message) {
        message.flaw = self.unpack_now(&message.from, &mut message.payload).err();
    }

    /// Makes a payload of that robot's what it was before it was packed; on an error it stays as it is.
    pub(super) async fn unpack(
        &self,
        from: &Name,
        payload: &mut Payload,
    ) -> Result<(), CodecError> {
        match self.unpack_now(from, payload) {
            // Boxed: it is rare and large, and would be moved with every message.
            Err(CodecError::Dictionary { id }) if Box::pin(self.fetch(from, id)).await => {
                self.unpack_now(from, payload)
            }
            done => done,
        }
    }

    fn unpack_now(&self, from: &Name, payload: &mut Payload) -> Result<(), CodecError> {
        if codec::is_packed(&payload.encoding) {
            let known = self.known();
            *payload = codec::decode(payload, &self.limits, known.dictionaries.of(from))?;
        }
        Ok(())
    }

    /// Asks the sender for a dictionary; whether it is here now.
    async fn fetch(&self, from: &Name, id: u32) -> bool {
        let which = (from.clone(), id);
        let asked = self.known().missing.get(&which).copied();
        if asked.is_some_and(|asked| asked.elapsed() < ASK_AGAIN) {
            return false;
        }
        let key = self.key(from, id);
        let asked = self.session.get(&key).timeout(PATIENCE);
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
        let mut known = self.known();
        let added = found.is_some();
        if let Some(dictionary) = found {
            known.dictionaries.add(from, Arc::new(dictionary));
        } else {
            tracing::warn!(
                "{from} has no dictionary {id}: its messages that were packed with it stay packed"
            );
            if known.missing.len() >= MAX_MISSING {
                known.missing.clear();
            }
            known.missing.insert(which, Instant::now());
        }
        added
    }

    /// Gives it to whoever asks, until the session ends.
    fn share(&self, dictionary: &Arc<Dictionary>) -> Result<(), Error> {
        let id = dictionary.id();
        let mut known = self.known();
        if known.served.contains_key(&id) {
            return Ok(());
        }
        let key = self.key(&self.place.robot, id);
        let (key_of_answer, shared) = (key.clone(), dictionary.clone());
        let queryable = self.session.declare_queryable(key).complete(true);
        let queryable = queryable.callback(move |query: Query| {
            let reply = query.reply(&key_of_answer, shared.as_bytes()).wait();
            if let Err(error) = reply {
                tracing::debug!("who asked for dictionary {id} got no answer: {error}");
            }
        });
        let queryable = queryable
            .wait()
            .map_err(Error::zenoh("the dictionary can't be shared"))?;
        known.served.insert(id, queryable);
        // One's own messages are heard, too.
        known
            .dictionaries
            .add(&self.place.robot, dictionary.clone());
        Ok(())
    }

    /// Where a robot has a dictionary that it made.
    fn key(&self, robot: &Name, id: u32) -> String {
        self.place.own(Some(robot), &format!("dictionary/{id}"))
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Robot {
    /// The same robot; what it says is packed with that dictionary (`zstd`), which small JSON needs to get much smaller.
    /// Whoever hears it fetches the dictionary once.
    ///
    /// # Errors
    /// [`Error::Zenoh`] when the session is closed.
    pub fn packed_with(&self, dictionary: Arc<Dictionary>) -> Result<Self, Error> {
        self.inner.decoder.share(&dictionary)?;
        Ok(self.encoded(Arc::new(Packed::new(dictionary))))
    }
}

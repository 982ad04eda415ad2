//! Decodes received payloads with the core's decoder, fetches dictionaries, and serves this program's own.
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use rect_core::{
    codec::{self, dictionary::Dictionary, CodecError},
    message::{
        payload::{Payload, PayloadError},
        Message,
    },
    name::{key::KeySpace, Name},
    session::decoder,
};
use zenoh::{query::Query, query::Queryable, Session, Wait};

use super::{executor::Executor, shared::NoItems};
use crate::error::Error;

/// Decodes the payloads that one program receives.
pub(super) struct Decoder {
    session: Session,
    core: Mutex<decoder::Decoder>,
    served: Mutex<HashMap<u32, Queryable<()>>>,
}

impl Decoder {
    pub(super) fn new(session: &Session, place: &KeySpace) -> Arc<Self> {
        Arc::new(Self {
            session: session.clone(),
            core: Mutex::new(decoder::Decoder::new(place.clone())),
            served: Mutex::default(),
        })
    }

    /// Decodes a message's payload in place. If that fails, the payload stays encoded and the error is attached.
    pub(super) async fn decode_message(&self, message: &mut Message) {
        // Most payloads are not encoded and skip the asynchronous path.
        if codec::is_encoded(&message.payload.encoding) {
            let decoded = self.decode(&message.sender, &mut message.payload).await;
            message.value = decoded.map_err(PayloadError::from);
        }
    }

    /// Decodes a message's payload in place, with the dictionaries that are already known.
    pub(super) fn decode_message_now(&self, message: &mut Message) {
        let decoded = self.decode_now(&message.sender, &mut message.payload);
        message.value = decoded.map_err(PayloadError::from);
    }

    /// Decodes a payload of the robot `sender` in place, fetching a missing dictionary; on an error the payload is unchanged.
    pub(super) async fn decode(
        &self,
        sender: &Name,
        payload: &mut Payload,
    ) -> Result<(), CodecError> {
        let Err(error) = self.decode_now(sender, payload) else {
            return Ok(());
        };
        // Boxed: this future is large and rarely needed, and would otherwise be moved with every message.
        if Box::pin(self.fetch(sender, &error)).await {
            self.decode_now(sender, payload)
        } else {
            Err(error)
        }
    }

    fn decode_now(&self, sender: &Name, payload: &mut Payload) -> Result<(), CodecError> {
        if codec::is_encoded(&payload.encoding) {
            if let Some(decoded) = self.core().decode(sender, payload)? {
                *payload = decoded;
            }
        }
        Ok(())
    }

    /// Fetches the dictionary that is missing according to `error`. Returns whether it is available now.
    async fn fetch(&self, sender: &Name, error: &CodecError) -> bool {
        let fetch = self.core().fetch(Instant::now(), sender, error);
        let Some(fetch) = fetch else { return false };
        let Ok(fetched) = Executor::new(&self.session, fetch, NoItems).run().await else {
            return false;
        };
        if fetched.dictionary.is_none() {
            tracing::warn!("{fetched}");
        }
        self.core().on_fetched(Instant::now(), fetched)
    }

    /// Serves a dictionary to receivers until the session ends.
    pub(super) fn serve(&self, dictionary: &Arc<Dictionary>) -> Result<(), Error> {
        let id = dictionary.id();
        let Some(key) = self.core().serve(dictionary)? else {
            return Ok(());
        };
        let (key_of_answer, shared) = (key.clone(), dictionary.clone());
        let queryable = self.session.declare_queryable(key).complete(true);
        let queryable = queryable.callback(move |query: Query| {
            let reply = query.reply(&key_of_answer, shared.as_bytes()).wait();
            if let Err(error) = reply {
                tracing::debug!("cannot reply to a request for the dictionary {id}: {error}");
            }
        });
        let declared = queryable.wait().map_err(|error| {
            self.core().on_not_served(id);
            Error::zenoh("cannot share the dictionary")(error)
        })?;
        let mut served = self.served.lock().unwrap_or_else(PoisonError::into_inner);
        served.insert(id, declared);
        Ok(())
    }

    fn core(&self) -> MutexGuard<'_, decoder::Decoder> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

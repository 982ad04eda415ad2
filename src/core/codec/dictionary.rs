//! Owns packing with a shared dictionary: small JSON messages look alike, and what they share is in the dictionary instead
//! of in each message.
use std::sync::Arc;

use super::{zstd, Codec, CodecError, Limits};
use crate::core::{
    dictionary::{Dictionaries, Dictionary},
    payload::Payload,
};

const NAME: &str = "dictionary";

/// zstd with a dictionary. The frame says with which; who has it not gets [`CodecError::Dictionary`].
#[derive(Clone, Debug)]
pub struct Packed {
    dictionary: Arc<Dictionary>,
}

impl Packed {
    /// With this dictionary.
    pub fn new(dictionary: Arc<Dictionary>) -> Self {
        Self { dictionary }
    }

    /// The dictionary.
    pub fn dictionary(&self) -> &Arc<Dictionary> {
        &self.dictionary
    }
}

impl Codec for Packed {
    /// `dictionary:<id>`, which [`parse`](super::parse) does not read: the id is not the dictionary.
    fn name(&self) -> String {
        format!("{NAME}:{}", self.dictionary.id())
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        let prepared = self.dictionary.prepared();
        zstd::packed(payload, zstd::pack(&payload.bytes, 0, Some(prepared))?)
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        let encoding = zstd::unpacked(payload, NAME)?;
        let dictionaries = Dictionaries::of(self.dictionary.clone());
        let bytes = zstd::unpack(&payload.bytes, limits.max_bytes, &dictionaries)?;
        Ok(Payload::new(bytes, encoding))
    }
}

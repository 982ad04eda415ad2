//! Compresses payloads with a shared dictionary. Small JSON messages resemble each other; the common parts are in the
//! dictionary instead of in each message.
use std::sync::Arc;

use super::{zstd, Codec, CodecError, Limits};
use crate::{
    codec::dictionary::{Dictionaries, Dictionary},
    message::payload::Payload,
};

const NAME: &str = "dictionary";

/// The zstd codec with a dictionary, to which the frame refers by its id. A receiver without the dictionary reports
/// [`CodecError::Dictionary`].
#[derive(Clone, Debug)]
pub struct DictionaryCodec {
    dictionary: Arc<Dictionary>,
}

impl DictionaryCodec {
    /// Creates a codec with a dictionary.
    pub fn new(dictionary: Arc<Dictionary>) -> Self {
        Self { dictionary }
    }

    /// Returns the dictionary.
    pub fn dictionary(&self) -> &Arc<Dictionary> {
        &self.dictionary
    }
}

impl Codec for DictionaryCodec {
    /// Returns `dictionary:<id>`. [`parse`](super::parse) does not accept it, because the dictionary cannot be restored
    /// from its id.
    fn name(&self) -> String {
        format!("{NAME}:{}", self.dictionary.id())
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        let prepared = self.dictionary.prepared();
        zstd::smaller_of(payload, zstd::compress(&payload.bytes, 0, Some(prepared))?)
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        let encoding = zstd::inner_encoding(payload, NAME)?;
        let dictionaries = Dictionaries::of(self.dictionary.clone());
        let bytes = zstd::decompress(&payload.bytes, limits.max_bytes, &dictionaries)?;
        Ok(Payload::new(bytes, encoding))
    }
}

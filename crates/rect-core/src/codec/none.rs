//! Implements the codec that leaves payloads unchanged.
use super::{no_option, Codec, CodecError, Limits};
use crate::message::payload::Payload;

/// The name of the codec.
pub const NAME: &str = "none";

/// A codec that leaves payloads unchanged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plain;

impl Plain {
    pub(super) fn parse(option: Option<&str>) -> Result<Self, CodecError> {
        no_option(NAME, option)?;
        Ok(Self)
    }
}

impl Codec for Plain {
    fn name(&self) -> String {
        NAME.to_owned()
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        Ok(payload.clone())
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        limits.bytes(NAME, payload.bytes.len() as u64)?;
        Ok(payload.clone())
    }
}

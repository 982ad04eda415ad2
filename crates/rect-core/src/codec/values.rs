//! Reads payloads as pictures and arrays, whichever codec has encoded them.
use super::{jpeg, png, quantised, webp, Limits};
use crate::{
    codec::{array::Array, picture::Picture},
    message::{
        encoding::EncodingKind,
        payload::{Payload, PayloadError},
    },
};

impl Payload {
    /// Decodes the payload as a picture: raw, PNG, JPEG or WebP.
    ///
    /// # Errors
    /// Returns [`PayloadError::Mismatch`] if the payload is something else, and [`PayloadError::Codec`] if it is
    /// damaged or too large.
    pub fn picture(&self, limits: &Limits) -> Result<Picture, PayloadError> {
        let bytes = &self.bytes;
        let picture = match self.encoding.kind() {
            EncodingKind::Png => png::read(bytes, limits),
            EncodingKind::Jpeg => jpeg::read(bytes, limits),
            EncodingKind::Webp => webp::read(bytes, limits),
            _ => Picture::raw(self, limits).ok_or_else(|| self.mismatch("a picture"))?,
        };
        Ok(picture?)
    }

    /// Reads the payload as an array, raw or quantised.
    ///
    /// # Errors
    /// Returns [`PayloadError::Mismatch`] if the payload is something else, and [`PayloadError::Codec`] if it is
    /// damaged or too large.
    pub fn array(&self, limits: &Limits) -> Result<Array, PayloadError> {
        if self.encoding.kind() == EncodingKind::Raw
            && self.encoding.schema() == Some(quantised::NAME)
        {
            return Ok(quantised::read(&self.bytes, limits)?);
        }
        Ok(Array::raw(self, limits).ok_or_else(|| self.mismatch("an array"))??)
    }
}

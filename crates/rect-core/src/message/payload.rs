//! Defines payloads, and converts a program's values into payloads and back.
use bytes::Bytes;
use serde::{de::DeserializeOwned, Serialize};

use super::{
    encoding::{Encoding, EncodingKind, TooLong},
    mismatch::{convert, Mismatch},
};
use crate::{cause::Cause, message::codec_error::CodecError};

/// Bytes with their encoding. Clones share the bytes.
///
/// ```
/// use rect_core::message::payload::{Json, ToPayload};
/// let payload = Json(vec![1, 2, 3]).to_payload()?;
/// assert_eq!(payload.encoding.as_str(), "application/json");
/// assert_eq!(payload.value::<Vec<u8>>()?, [1, 2, 3]);
/// # Ok::<(), rect_core::message::payload::PayloadError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Payload {
    /// The bytes.
    pub bytes: Bytes,
    /// The encoding of the bytes.
    pub encoding: Encoding,
}

/// A value cannot be converted into a payload, or a payload into a value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PayloadError {
    /// The value cannot be written in this format (in JSON, for example, a map with keys that are not text).
    #[error("this value cannot be written as {format}: {reason}")]
    Write {
        /// The format: `JSON`, `CBOR` and so on.
        format: &'static str,
        /// The reason that the serializer reports.
        #[source]
        reason: Cause,
    },
    /// The payload has another encoding than the call expects. Check [`Payload::encoding`] first.
    #[error("the payload is {found}, but {expected} is required")]
    Mismatch {
        /// The expected kind of payload.
        expected: &'static str,
        /// The actual encoding.
        found: Encoding,
    },
    /// The payload has the expected encoding, but its bytes are not valid.
    #[error("the payload is not valid {format}: {reason}")]
    Read {
        /// The format: `JSON`, `CBOR` and so on.
        format: &'static str,
        /// The reason that the parser reports.
        #[source]
        reason: Cause,
    },
    /// The value does not fit the type that the program has stated.
    #[error(transparent)]
    Type(#[from] Mismatch),
    /// The robot has forgotten the topic, so that the message has no value.
    #[error("the topic was forgotten: there is no value any more")]
    Forgotten,
    /// The encoding is too long to be sent.
    #[error(transparent)]
    Encoding(#[from] TooLong),
    /// The picture or array in the payload cannot be decoded.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// A value that can be sent. Text, bytes and JSON values are sent as they are; [`Json`] and [`Cbor`] send any type that
/// serde can serialize.
pub trait ToPayload {
    /// Converts the value into a payload.
    ///
    /// # Errors
    /// Returns [`PayloadError::Write`] if the value cannot be written in its format.
    fn to_payload(&self) -> Result<Payload, PayloadError>;

    /// Converts the value into a payload and consumes it, so that bytes that it owns are not copied.
    ///
    /// # Errors
    /// Fails like [`to_payload`](Self::to_payload).
    fn into_payload(self) -> Result<Payload, PayloadError>
    where
        Self: Sized,
    {
        self.to_payload()
    }
}

/// A type that a program states for the values that it receives: a type that serde deserializes, which values are
/// converted to, or [`Payload`], for payloads as they are.
pub trait FromPayload: Sized + 'static {
    /// The value: the type itself, and nothing for `Payload`.
    type Value: Send + 'static;

    /// Returns the value of a payload.
    ///
    /// # Errors
    /// Returns the errors of [`Payload::value`].
    fn from_payload(payload: &Payload) -> Result<Self::Value, PayloadError>;
}

impl FromPayload for Payload {
    type Value = ();

    fn from_payload(_: &Payload) -> Result<(), PayloadError> {
        Ok(())
    }
}

impl<T: DeserializeOwned + Send + 'static> FromPayload for T {
    type Value = T;

    fn from_payload(payload: &Payload) -> Result<T, PayloadError> {
        payload.value()
    }
}

/// A value that a publisher of the type `T` publishes: a `T` or `&T`, which is sent as JSON. A publisher of [`Payload`]
/// publishes everything that is [`ToPayload`].
pub trait ValueOf<T> {
    /// Converts the value into a payload.
    ///
    /// # Errors
    /// Returns [`PayloadError::Write`] if the value cannot be written in its format.
    fn payload(self) -> Result<Payload, PayloadError>;
}

impl<V: ToPayload> ValueOf<Payload> for V {
    fn payload(self) -> Result<Payload, PayloadError> {
        self.into_payload()
    }
}

impl<T: Serialize> ValueOf<T> for T {
    fn payload(self) -> Result<Payload, PayloadError> {
        Json(self).to_payload()
    }
}

impl<T: Serialize> ValueOf<T> for &T {
    fn payload(self) -> Result<Payload, PayloadError> {
        Json(self).to_payload()
    }
}

/// Sends a value as JSON: `Json(&reading)`.
#[derive(Clone, Copy, Debug)]
pub struct Json<T>(pub T);

/// Sends a value as CBOR, which is shorter than JSON, but not readable by people.
#[derive(Clone, Copy, Debug)]
pub struct Cbor<T>(pub T);

impl Payload {
    /// Creates a payload.
    pub fn new(bytes: impl Into<Bytes>, encoding: Encoding) -> Self {
        Self {
            bytes: bytes.into(),
            encoding,
        }
    }

    /// Returns the payload if it can be sent.
    ///
    /// # Errors
    /// Returns [`PayloadError::Encoding`] if its encoding is too long.
    #[inline]
    pub fn sendable(self) -> Result<Self, PayloadError> {
        self.encoding.check_length()?;
        Ok(self)
    }

    /// Returns the payload as text.
    ///
    /// # Errors
    /// Returns [`PayloadError::Mismatch`] if the encoding is not one of text, and [`PayloadError::Read`] if the bytes
    /// are not UTF-8.
    pub fn text(&self) -> Result<&str, PayloadError> {
        if !self.encoding.is_text() {
            return Err(self.mismatch("text in UTF-8"));
        }
        std::str::from_utf8(&self.bytes).map_err(|error| read("text", error))
    }

    /// Deserializes the payload from JSON, CBOR or text, depending on its encoding.
    ///
    /// # Errors
    /// Returns [`PayloadError::Mismatch`] for another encoding, [`PayloadError::Read`] if the bytes are not what the encoding says,
    /// and [`PayloadError::Type`] if the value does not fit `T`.
    pub fn value<T: DeserializeOwned>(&self) -> Result<T, PayloadError> {
        // The second step takes longer, and finds the part that does not fit. It fails if the bytes are not valid.
        self.parsed().or_else(|error| match self.parsed() {
            Ok(value) => Ok(convert(&value)?),
            Err(_) => Err(error),
        })
    }

    fn parsed<T: DeserializeOwned>(&self) -> Result<T, PayloadError> {
        match self.encoding.kind() {
            EncodingKind::Json => {
                serde_json::from_slice(&self.bytes).map_err(|error| read("JSON", error))
            }
            // Deeper nesting is rejected, because a peer could overflow the stack with it.
            EncodingKind::Cbor => {
                ciborium::de::from_reader_with_recursion_limit(&*self.bytes, MAX_DEPTH)
                    .map_err(|error| read("CBOR", error))
            }
            EncodingKind::Text => Ok(convert(&self.text()?.into())?),
            _ => Err(self.mismatch("JSON, CBOR or text in UTF-8")),
        }
    }

    pub(crate) fn mismatch(&self, expected: &'static str) -> PayloadError {
        let found = self.encoding.clone();
        PayloadError::Mismatch { expected, found }
    }
}

/// The maximum nesting of CBOR; the same as serde_json's.
pub const MAX_DEPTH: usize = 128;

fn read(
    format: &'static str,
    error: impl Into<Box<dyn std::error::Error + Send + Sync>>,
) -> PayloadError {
    let reason = Cause::new(error);
    PayloadError::Read { format, reason }
}

fn write(
    format: &'static str,
    error: impl Into<Box<dyn std::error::Error + Send + Sync>>,
) -> PayloadError {
    let reason = Cause::new(error);
    PayloadError::Write { format, reason }
}

/// Returns the value that a user has typed: JSON if it is valid JSON, otherwise a text.
pub fn typed(value: String) -> Payload {
    let is_json = serde_json::from_str::<serde::de::IgnoredAny>(&value).is_ok();
    let encoding = if is_json {
        Encoding::JSON
    } else {
        Encoding::TEXT
    };
    Payload::new(value, encoding)
}

impl<T: Serialize> ToPayload for Json<T> {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        let bytes = serde_json::to_vec(&self.0).map_err(|error| write("JSON", error))?;
        Ok(Payload::new(bytes, Encoding::JSON))
    }
}

impl<T: Serialize> ToPayload for Cbor<T> {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        let mut bytes = Vec::new();
        ciborium::into_writer(&self.0, &mut bytes).map_err(|error| write("CBOR", error))?;
        Ok(Payload::new(bytes, Encoding::CBOR))
    }
}

/// Nothing: `null` as JSON.
impl ToPayload for () {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        Ok(Payload::new("null", Encoding::JSON))
    }
}

impl ToPayload for serde_json::Value {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        Json(self).to_payload()
    }
}

impl ToPayload for Payload {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        Ok(self.clone())
    }

    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(self)
    }
}

impl ToPayload for str {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        let bytes = Bytes::copy_from_slice(self.as_bytes());
        Ok(Payload::new(bytes, Encoding::TEXT))
    }
}

impl ToPayload for String {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        self.as_str().to_payload()
    }

    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(Payload::new(self, Encoding::TEXT))
    }
}

impl ToPayload for [u8] {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        let bytes = Bytes::copy_from_slice(self);
        Ok(Payload::new(bytes, Encoding::BYTES))
    }
}

impl<const N: usize> ToPayload for [u8; N] {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        self.as_slice().to_payload()
    }
}

impl ToPayload for Vec<u8> {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        self.as_slice().to_payload()
    }

    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(Payload::new(self, Encoding::BYTES))
    }
}

impl ToPayload for Bytes {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        self.clone().into_payload()
    }

    #[inline]
    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(Payload::new(self, Encoding::BYTES))
    }
}

impl<T: ToPayload + ?Sized> ToPayload for &T {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        (**self).to_payload()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde::Deserialize;
    use serde_json::json;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Reading {
        angle_deg: f64,
        name: String,
    }

    #[test]
    fn values_round_trip() {
        let reading = Reading {
            angle_deg: 12.5,
            name: "arm".into(),
        };
        for payload in [Json(&reading).to_payload(), Cbor(&reading).to_payload()] {
            let payload = payload.expect("written");
            assert_eq!(payload.value::<Reading>().expect("read"), reading);
        }
        let json = json!({"a": [1, 2.5, null]}).to_payload().expect("written");
        assert_eq!(json.text().expect("readable"), r#"{"a":[1,2.5,null]}"#);
        assert_eq!("hä".to_payload().expect("text").text().expect("text"), "hä");
        assert_eq!(
            [1, 2].to_payload().expect("bytes").encoding,
            Encoding::BYTES
        );
    }

    #[test]
    fn payloads_of_another_encoding_or_shape_are_rejected() {
        let bytes = [1u8].to_payload().expect("bytes");
        assert!(matches!(bytes.text(), Err(PayloadError::Mismatch { .. })));
        assert!(matches!(
            bytes.value::<u8>(),
            Err(PayloadError::Mismatch { .. })
        ));
        for wrong in ["", "{", "[1,", "\u{1}"] {
            let wrong = Payload::new(wrong, Encoding::JSON);
            let error = wrong.value::<Reading>().expect_err("invalid").to_string();
            assert!(error.contains("JSON"), "{error}");
        }
        let map = BTreeMap::from([((1, 2), 3)]);
        assert!(matches!(
            Json(map).to_payload(),
            Err(PayloadError::Write { .. })
        ));
    }

    #[test]
    fn deep_nesting_does_not_overflow_the_stack() {
        let json = Payload::new("[".repeat(1_000_000), Encoding::JSON);
        assert!(json.value::<serde_json::Value>().is_err());
        let cbor = Payload::new(vec![0x81; 1_000_000], Encoding::CBOR);
        assert!(cbor.value::<serde_json::Value>().is_err());
    }
}

//! Owns payloads: bytes and what they are, and how a program's values become one and back.
use bytes::Bytes;
use serde::{de::DeserializeOwned, Serialize};

use super::{
    codec::CodecError,
    encoding::{Encoding, TooLong},
};

/// Bytes, and what they are. Cloning shares them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Payload {
    /// The bytes.
    pub bytes: Bytes,
    /// What they are.
    pub encoding: Encoding,
}

/// A value and its encoding do not fit.
#[derive(Debug, thiserror::Error)]
pub enum PayloadError {
    /// The value can't be written in that form (a map with keys that are not text in JSON, for example).
    #[error("this value can't be written as {what}: {reason}")]
    Write {
        /// `JSON`, `CBOR`, ...
        what: &'static str,
        /// What the serializer says.
        reason: String,
    },
    /// The payload is not what was asked for. [`Payload::encoding`] says what it is.
    #[error("the payload is {found}, not {wanted}")]
    Other {
        /// What was asked for.
        wanted: &'static str,
        /// What it is.
        found: Encoding,
    },
    /// It says that it is, and can't be read as such.
    #[error(
        "the payload says that it is {what}, and is not, or not of the wanted shape: {reason}"
    )]
    Read {
        /// `JSON`, `CBOR`, ...
        what: &'static str,
        /// What the parser says.
        reason: String,
    },
    /// The encoding can't be sent.
    #[error(transparent)]
    Encoding(#[from] TooLong),
    /// The picture or array in it can't be had.
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// What can be sent. Text, bytes and JSON values go as they are; [`Json`] and [`Cbor`] take anything of serde's.
pub trait ToPayload {
    /// The value as bytes.
    ///
    /// # Errors
    /// [`PayloadError::Write`]: it can't be written so.
    fn to_payload(&self) -> Result<Payload, PayloadError>;

    /// The same of a value that is not needed any more: bytes that it owns are not copied.
    ///
    /// # Errors
    /// As [`to_payload`](Self::to_payload).
    fn into_payload(self) -> Result<Payload, PayloadError>
    where
        Self: Sized,
    {
        self.to_payload()
    }
}

/// Sends a value of serde's as JSON: `Json(&reading)`.
#[derive(Clone, Copy, Debug)]
pub struct Json<T>(pub T);

/// Sends a value of serde's as CBOR: shorter than JSON, and not readable by eye.
#[derive(Clone, Copy, Debug)]
pub struct Cbor<T>(pub T);

impl Payload {
    /// Bytes that say what they are.
    pub fn new(bytes: impl Into<Bytes>, encoding: Encoding) -> Self {
        Self {
            bytes: bytes.into(),
            encoding,
        }
    }

    /// Returns the payload if it can be sent.
    ///
    /// # Errors
    /// [`PayloadError::Encoding`]: its encoding is too long.
    pub fn sendable(self) -> Result<Self, PayloadError> {
        self.encoding.check_length()?;
        Ok(self)
    }

    /// As text.
    ///
    /// # Errors
    /// It is something else ([`PayloadError::Other`]), or no UTF-8.
    pub fn text(&self) -> Result<&str, PayloadError> {
        if !self.encoding.is_text() {
            return Err(self.other("text"));
        }
        std::str::from_utf8(&self.bytes).map_err(|error| read("text", error))
    }

    /// As a value of serde's, by its encoding: JSON or CBOR.
    ///
    /// # Errors
    /// It is neither ([`PayloadError::Other`]), or not of this shape ([`PayloadError::Read`]).
    pub fn value<T: DeserializeOwned>(&self) -> Result<T, PayloadError> {
        if self.is(&Encoding::JSON) || self.encoding.as_str() == "text/json" {
            serde_json::from_slice(&self.bytes).map_err(|error| read("JSON", error))
        } else if self.is(&Encoding::CBOR) {
            // Nested deeper than this it is not read: a peer could fill the stack.
            ciborium::de::from_reader_with_recursion_limit(&*self.bytes, MAX_DEPTH)
                .map_err(|error| read("CBOR", error))
        } else {
            Err(self.other("JSON or CBOR"))
        }
    }

    fn is(&self, encoding: &Encoding) -> bool {
        self.encoding == *encoding
    }

    pub(super) fn other(&self, wanted: &'static str) -> PayloadError {
        let found = self.encoding.clone();
        PayloadError::Other { wanted, found }
    }
}

/// As deep as serde_json reads.
const MAX_DEPTH: usize = 128;

fn read(what: &'static str, error: impl std::fmt::Display) -> PayloadError {
    let reason = error.to_string();
    PayloadError::Read { what, reason }
}

fn write(what: &'static str, error: impl std::fmt::Display) -> PayloadError {
    let reason = error.to_string();
    PayloadError::Write { what, reason }
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
        Ok(Payload::new(self.clone(), Encoding::BYTES))
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
    fn values_come_back_as_they_were() {
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
    fn what_it_is_not_it_is_not_read_as() {
        let bytes = [1u8].to_payload().expect("bytes");
        assert!(matches!(bytes.text(), Err(PayloadError::Other { .. })));
        assert!(matches!(
            bytes.value::<u8>(),
            Err(PayloadError::Other { .. })
        ));
        for wrong in ["", "{", "[1,", "\u{1}"] {
            let wrong = Payload::new(wrong, Encoding::JSON);
            let error = wrong
                .value::<Reading>()
                .expect_err("no reading")
                .to_string();
            assert!(error.contains("JSON"), "{error}");
        }
        let map = BTreeMap::from([((1, 2), 3)]);
        assert!(matches!(
            Json(map).to_payload(),
            Err(PayloadError::Write { .. })
        ));
    }

    #[test]
    fn nesting_does_not_fill_the_stack() {
        let json = Payload::new("[".repeat(1_000_000), Encoding::JSON);
        assert!(json.value::<serde_json::Value>().is_err());
        let cbor = Payload::new(vec![0x81; 1_000_000], Encoding::CBOR);
        assert!(cbor.value::<serde_json::Value>().is_err());
    }
}

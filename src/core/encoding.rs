//! Owns the encodings: what a payload is, in the words that Zenoh's tools show, and how it is packed.
//!
//! An encoding is a media type and, after `;`, what more there is to say of it. Parts after `;` are separated by `;` too;
//! the last may name a packing: `application/json;zstd` is JSON in one zstd frame.
use std::{borrow::Cow, fmt};

/// The longest encoding that can be sent, in bytes. Zenoh allows 255 in a schema; the rest is for what RECT adds to it.
pub const MAX_BYTES: usize = 200;

/// How much of an encoding that is too long an error shows, in characters.
const SHOWN_CHARACTERS: usize = 40;

/// The encoding is longer than [`MAX_BYTES`]. Shorten it, or put what it says into the payload.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the encoding {beginning:?}... is {bytes} bytes long, and an encoding has at most {MAX_BYTES}"
)]
pub struct TooLong {
    /// How it begins.
    pub beginning: String,
    /// Its length, in bytes.
    pub bytes: usize,
}

/// What a payload is.
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct Encoding(Cow<'static, str>);

impl Encoding {
    /// Any bytes; Zenoh's default.
    pub const BYTES: Self = Self(Cow::Borrowed("zenoh/bytes"));
    /// Text in UTF-8.
    pub const TEXT: Self = Self(Cow::Borrowed("text/plain"));
    /// JSON.
    pub const JSON: Self = Self(Cow::Borrowed("application/json"));
    /// CBOR, RFC 8949.
    pub const CBOR: Self = Self(Cow::Borrowed("application/cbor"));
    /// A picture, PNG.
    pub const PNG: Self = Self(Cow::Borrowed("image/png"));
    /// A picture, JPEG.
    pub const JPEG: Self = Self(Cow::Borrowed("image/jpeg"));
    /// A picture, WebP.
    pub const WEBP: Self = Self(Cow::Borrowed("image/webp"));
    /// Bytes with a layout that the rest of the encoding tells: raw pictures, arrays.
    pub const RAW: &'static str = "application/octet-stream";

    /// As a peer or a program wrote it. A payload with one of more than [`MAX_BYTES`] can't be sent.
    pub fn new(text: impl Into<Cow<'static, str>>) -> Self {
        Self(text.into())
    }

    /// Checks that a payload with this encoding can be sent.
    ///
    /// # Errors
    /// [`TooLong`].
    pub fn check_length(&self) -> Result<(), TooLong> {
        let bytes = self.0.len();
        if bytes <= MAX_BYTES {
            return Ok(());
        }
        let beginning = self.0.chars().take(SHOWN_CHARACTERS).collect();
        Err(TooLong { beginning, bytes })
    }

    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The media type, without what is after `;`.
    pub fn media_type(&self) -> &str {
        self.0.split(';').next().unwrap_or_default()
    }

    /// What is after the first `;`, if anything.
    pub fn schema(&self) -> Option<&str> {
        self.0.split_once(';').map(|(_, schema)| schema)
    }

    /// Whether it is text, as JSON is too.
    pub fn is_text(&self) -> bool {
        self.0.starts_with("text/") || *self == Self::JSON
    }

    /// The same, packed by what `packing` names.
    #[must_use]
    pub fn packed(&self, packing: &str) -> Self {
        Self(format!("{};{packing}", self.0).into())
    }

    /// What it is once `packing` is undone; `None` if it is not packed so.
    pub fn unpacked(&self, packing: &str) -> Option<Self> {
        let rest = self.0.strip_suffix(packing)?.strip_suffix(';')?;
        Some(Self(rest.to_owned().into()))
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Debug for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_packing_is_the_last_part() {
        let packed = Encoding::JSON.packed("zstd");
        assert_eq!(packed.as_str(), "application/json;zstd");
        assert_eq!(
            (packed.media_type(), packed.schema()),
            ("application/json", Some("zstd"))
        );
        assert_eq!(packed.unpacked("zstd"), Some(Encoding::JSON));
        assert_eq!(packed.unpacked("std"), None);
        assert_eq!(Encoding::JSON.unpacked("json"), None);
    }

    #[test]
    fn an_encoding_of_more_than_200_bytes_is_rejected_before_it_is_sent() {
        let longest = Encoding::new("x".repeat(MAX_BYTES));
        assert_eq!(longest.check_length(), Ok(()));
        assert!(longest.packed("zstd").check_length().is_err());
        let long = Encoding::new("ä".repeat(MAX_BYTES));
        let error = long.check_length().expect_err("too long");
        assert_eq!(error.bytes, 2 * MAX_BYTES);
        let text = error.to_string();
        assert!(
            text.contains("400 bytes") && text.contains("at most 200"),
            "{text}"
        );
    }
}

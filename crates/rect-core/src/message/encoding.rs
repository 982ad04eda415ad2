//! Defines the encodings of payloads: what the bytes are, in the form that Zenoh's tools display, and how they are
//! compressed.
//!
//! An encoding is a media type, optionally followed by further parts, each after a `;`. The last part may name
//! the codec that compressed the payload: `application/json;zstd` is JSON in one zstd frame.
use std::{borrow::Cow, fmt};

/// The maximum length of an encoding that can be sent, in bytes. Zenoh allows 255; the rest is reserved for the parts
/// that RECT appends.
pub const MAX_BYTES: usize = 200;

/// How many characters of an encoding that is too long an error message quotes.
const SHOWN_CHARACTERS: usize = 40;

/// The encoding is longer than [`MAX_BYTES`]. Shorten it, or move part of its content into the payload.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the encoding {beginning:?}... is {bytes} bytes long, but an encoding has at most {MAX_BYTES} bytes"
)]
pub struct TooLong {
    /// The beginning of the encoding.
    pub beginning: String,
    /// The length of the encoding, in bytes.
    pub bytes: usize,
}

/// The kind of a payload, according to its encoding: how its bytes are read. See [`Encoding::kind`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum EncodingKind {
    /// JSON: `application/json`, `text/json`, or a type that ends in `+json`.
    Json,
    /// CBOR: `application/cbor`, or a type that ends in `+cbor`.
    Cbor,
    /// Text in UTF-8: `text/...`, or `zenoh/string`.
    Text,
    /// A PNG picture.
    Png,
    /// A JPEG picture.
    Jpeg,
    /// A WebP picture.
    Webp,
    /// A frame of a video in H.264.
    H264,
    /// A raw picture or array, or any bytes: `application/octet-stream`.
    Raw,
    /// Anything else. A payload that is still compressed is of this kind.
    Other,
}

impl EncodingKind {
    /// Returns the name: `json`, `cbor`, `text`, `png`, `jpeg`, `webp`, `h264`, `raw` or `other`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Cbor => "cbor",
            Self::Text => "text",
            Self::Png => "png",
            Self::Jpeg => "jpeg",
            Self::Webp => "webp",
            Self::H264 => "h264",
            Self::Raw => "raw",
            Self::Other => "other",
        }
    }
}

/// The encoding of a payload.
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct Encoding(Cow<'static, str>);

impl Encoding {
    /// The last part of the encoding of a payload that was compressed with zstd.
    pub const COMPRESSED: &'static str = "zstd";
    /// Any bytes; Zenoh's default.
    pub const BYTES: Self = Self(Cow::Borrowed("zenoh/bytes"));
    /// Text in UTF-8.
    pub const TEXT: Self = Self(Cow::Borrowed("text/plain"));
    /// JSON.
    pub const JSON: Self = Self(Cow::Borrowed("application/json"));
    /// CBOR, RFC 8949.
    pub const CBOR: Self = Self(Cow::Borrowed("application/cbor"));
    /// A PNG picture.
    pub const PNG: Self = Self(Cow::Borrowed("image/png"));
    /// A JPEG picture.
    pub const JPEG: Self = Self(Cow::Borrowed("image/jpeg"));
    /// A WebP picture.
    pub const WEBP: Self = Self(Cow::Borrowed("image/webp"));
    /// A frame of a video in H.264; see [`crate::video`].
    pub const H264: Self = Self(Cow::Borrowed("video/h264"));
    /// The media type of raw pictures and arrays, whose layout the rest of the encoding describes.
    pub const RAW: &'static str = "application/octet-stream";

    /// Creates an encoding from any text. A payload whose encoding is longer than [`MAX_BYTES`] cannot be sent.
    pub fn new(text: impl Into<Cow<'static, str>>) -> Self {
        Self(text.into())
    }

    /// Checks that a payload with this encoding can be sent.
    ///
    /// # Errors
    /// Returns [`TooLong`] if the encoding is longer than [`MAX_BYTES`].
    pub fn check_length(&self) -> Result<(), TooLong> {
        let bytes = self.0.len();
        if bytes <= MAX_BYTES {
            return Ok(());
        }
        let beginning = self.0.chars().take(SHOWN_CHARACTERS).collect();
        Err(TooLong { beginning, bytes })
    }

    /// Returns the encoding as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the media type: the part before the first `;`.
    pub fn media_type(&self) -> &str {
        self.0.split(';').next().unwrap_or_default()
    }

    /// Returns the part after the first `;`, if there is one.
    pub fn schema(&self) -> Option<&str> {
        self.0.split_once(';').map(|(_, schema)| schema)
    }

    /// Returns what the payload is. Like any media type, the encoding is compared without case and without parameters:
    /// `Application/JSON; charset=utf-8` is JSON. Only a parameter `charset` other than UTF-8 counts: such text is
    /// [`EncodingKind::Other`], since it cannot be read.
    pub fn kind(&self) -> EncodingKind {
        // Most messages have one of these, and need no further comparison.
        match self.as_str() {
            "application/json" => EncodingKind::Json,
            "zenoh/bytes" => EncodingKind::Other,
            "text/plain" => EncodingKind::Text,
            "application/cbor" => EncodingKind::Cbor,
            _ => self.compared_kind(),
        }
    }

    fn compared_kind(&self) -> EncodingKind {
        let mut parts = self.0.split(';').map(str::trim);
        let media_type = parts.next().unwrap_or_default();
        let media_type = media_type.to_ascii_lowercase();
        let kind = match media_type.as_str() {
            "application/json" | "text/json" => EncodingKind::Json,
            "application/cbor" => EncodingKind::Cbor,
            "zenoh/string" => EncodingKind::Text,
            "image/png" => EncodingKind::Png,
            "image/jpeg" => EncodingKind::Jpeg,
            "image/webp" => EncodingKind::Webp,
            "video/h264" => EncodingKind::H264,
            Self::RAW => EncodingKind::Raw,
            other if other.ends_with("+json") => EncodingKind::Json,
            other if other.ends_with("+cbor") => EncodingKind::Cbor,
            other if other.starts_with("text/") => EncodingKind::Text,
            _ => EncodingKind::Other,
        };
        let is_read = match kind {
            EncodingKind::Json | EncodingKind::Text => parts.clone().all(is_utf8),
            _ => true,
        };
        let is_compressed = parts.next_back() == Some(Self::COMPRESSED);
        match is_read && !is_compressed {
            true => kind,
            false => EncodingKind::Other,
        }
    }

    /// Returns whether the payload is text, which includes JSON.
    pub fn is_text(&self) -> bool {
        matches!(self.kind(), EncodingKind::Text | EncodingKind::Json)
    }

    /// Appends `;<suffix>`, for example the name of the codec that compressed the payload.
    #[must_use]
    pub fn with_suffix(&self, suffix: &str) -> Self {
        Self(format!("{};{suffix}", self.0).into())
    }

    /// Removes a trailing `;<suffix>`. Returns `None` if there is none.
    pub fn without_suffix(&self, suffix: &str) -> Option<Self> {
        let rest = self.0.strip_suffix(suffix)?.strip_suffix(';')?;
        Some(Self(rest.to_owned().into()))
    }
}

/// Returns whether a parameter of a media type allows reading text as UTF-8.
fn is_utf8(parameter: &str) -> bool {
    let Some((name, value)) = parameter.split_once('=') else {
        return true;
    };
    let value = value.trim().trim_matches('"');
    let known = ["utf-8", "utf8", "us-ascii"];
    !name.trim().eq_ignore_ascii_case("charset")
        || known.iter().any(|known| value.eq_ignore_ascii_case(known))
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
    fn a_codec_is_the_last_part_of_an_encoding() {
        let encoded = Encoding::JSON.with_suffix("zstd");
        assert_eq!(encoded.as_str(), "application/json;zstd");
        assert_eq!(
            (encoded.media_type(), encoded.schema()),
            ("application/json", Some("zstd"))
        );
        assert_eq!(encoded.without_suffix("zstd"), Some(Encoding::JSON));
        assert_eq!(encoded.without_suffix("std"), None);
        assert_eq!(Encoding::JSON.without_suffix("json"), None);
    }

    #[test]
    fn a_media_type_is_compared_without_case_and_parameters() {
        let kinds = [
            ("application/json; charset=utf-8", EncodingKind::Json),
            ("Application/JSON", EncodingKind::Json),
            ("application/json ;charset=\"UTF-8\"", EncodingKind::Json),
            ("text/json", EncodingKind::Json),
            ("application/geo+json", EncodingKind::Json),
            ("application/json;my-schema", EncodingKind::Json),
            ("application/json;zstd", EncodingKind::Other),
            ("application/json; charset=utf-16", EncodingKind::Other),
            ("application/json-seq", EncodingKind::Other),
            ("APPLICATION/CBOR;v=1", EncodingKind::Cbor),
            ("application/senml+cbor", EncodingKind::Cbor),
            ("zenoh/string", EncodingKind::Text),
            ("zenoh/string;utf-8", EncodingKind::Text),
            ("Text/Plain; Charset=UTF-8", EncodingKind::Text),
            ("text/html;charset=iso-8859-1", EncodingKind::Other),
            ("IMAGE/JPEG", EncodingKind::Jpeg),
            ("image/png; x=1", EncodingKind::Png),
            ("image/webp;zstd", EncodingKind::Other),
            ("video/H264", EncodingKind::H264),
            ("application/octet-stream;array;f32;3", EncodingKind::Raw),
            ("zenoh/serialized", EncodingKind::Other),
            ("", EncodingKind::Other),
        ];
        for (text, kind) in kinds {
            assert_eq!(Encoding::new(text).kind(), kind, "{text}");
        }
        assert!(Encoding::new("Application/JSON").is_text());
    }

    #[test]
    fn an_encoding_of_more_than_200_bytes_is_rejected_before_it_is_sent() {
        let longest = Encoding::new("x".repeat(MAX_BYTES));
        assert_eq!(longest.check_length(), Ok(()));
        assert!(longest.with_suffix("zstd").check_length().is_err());
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

//! Defines [`Codec`], which encodes payloads into smaller ones and decodes them, and the choice of a codec: by a
//! specification of the user ([`parse`]) or by a payload's encoding ([`decode`], [`Payload::picture`],
//! [`Payload::array`]).
//!
//! | specification | input | output |
//! |---|---|---|
//! | `none` | any payload | the same payload |
//! | `zstd[:level]`, 1 to 19, default 3 | any payload | `<encoding>;zstd` |
//! | [`DictionaryCodec`](dictionary_codec::DictionaryCodec), created from a dictionary | any payload | `<encoding>;zstd` |
//! | `png` | raw pictures | `image/png` |
//! | `jpeg[:quality]`, 1 to 100, default 80 | raw pictures | `image/jpeg` |
//! | `webp[:quality]`, 1 to 100, default 80 | raw pictures | `image/webp` |
//! | `quantised:<error>` | arrays of floats | `application/octet-stream;quantised` |
use std::{fmt, sync::Arc};

use self::dictionary::Dictionaries;
use crate::message::{codec_error::damaged, encoding::Encoding, payload::Payload};

pub use self::limits::Limits;
pub use crate::message::codec_error::CodecError;

pub mod array;
pub mod dictionary;
pub mod dictionary_codec;
pub mod jpeg;
pub mod json;
mod limits;
pub mod none;
pub mod picture;
pub mod png;
pub mod quantised;
mod values;
pub mod webp;
pub mod zstd;

/// Makes payloads smaller. Codecs for any payload append a part to the encoding, and the receiver decodes them before
/// the program gets the payload. Codecs for pictures and arrays produce an encoding of their own.
pub trait Codec: fmt::Debug + Send + Sync {
    /// Returns the name with all options, in the form that [`parse`] reads: `zstd:3`.
    fn name(&self) -> String;

    /// Encodes a payload.
    ///
    /// # Errors
    /// Returns an error if the codec does not support this kind of payload, or if the payload is too large.
    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError>;

    /// Decodes a payload whose encoding is one that this codec produces.
    ///
    /// # Errors
    /// Returns an error if the bytes are invalid, or if the result would exceed `limits`.
    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError>;
}

const AVAILABLE: &str =
    "none, zstd[:1 to 19], png, jpeg[:1 to 100], webp[:1 to 100], quantised:<largest error>";

/// The maximum number of nested compressed frames. Deeper nesting serves no purpose and would keep a receiver busy.
const MAX_NESTING: usize = 2;

/// Creates the codec of a specification such as `jpeg:60`. The module's table lists them.
///
/// ```
/// assert_eq!(rect_core::codec::parse("zstd")?.name(), "zstd:3");
/// # Ok::<(), rect_core::codec::CodecError>(())
/// ```
///
/// # Errors
/// Returns [`CodecError::Unknown`] or [`CodecError::Option`].
pub fn parse(spec: &str) -> Result<Arc<dyn Codec>, CodecError> {
    let (name, option) = match spec.split_once(':') {
        Some((name, option)) => (name, Some(option)),
        None => (spec, None),
    };
    Ok(match name {
        none::NAME => Arc::new(none::Plain::parse(option)?),
        zstd::NAME => Arc::new(zstd::Zstd::parse(option)?),
        png::NAME => Arc::new(png::Png::parse(option)?),
        jpeg::NAME => Arc::new(jpeg::Jpeg::parse(option)?),
        webp::NAME => Arc::new(webp::Webp::parse(option)?),
        quantised::NAME => Arc::new(quantised::Quantised::parse(option)?),
        _ => {
            let (name, available) = (shown(spec), AVAILABLE);
            return Err(CodecError::Unknown { name, available });
        }
    })
}

/// Returns whether a payload with this encoding must be decoded with [`decode`].
pub fn is_encoded(encoding: &Encoding) -> bool {
    encoding.without_suffix(zstd::NAME).is_some()
}

/// Decompresses a payload whose encoding ends in `;zstd`. Pictures and arrays stay as they are (see
/// [`Payload::picture`] and [`Payload::array`]), and so do payloads of unknown encodings.
///
/// # Errors
/// Returns a [`CodecError`] if the payload is damaged or too large, or if its dictionary is not among `dictionaries`.
pub fn decode(
    payload: &Payload,
    limits: &Limits,
    dictionaries: &Dictionaries,
) -> Result<Payload, CodecError> {
    let mut payload = payload.clone();
    let mut depth = 0;
    while let Some(encoding) = payload.encoding.without_suffix(zstd::NAME) {
        depth += 1;
        if depth > MAX_NESTING {
            return Err(CodecError::TooLarge {
                format: zstd::NAME,
                found: format!("more than {MAX_NESTING} nested frames"),
                limit: MAX_NESTING.to_string(),
            });
        }
        let bytes = zstd::decompress(&payload.bytes, limits.max_bytes, dictionaries)?;
        payload = Payload::new(bytes, encoding);
    }
    Ok(payload)
}

/// Returns the beginning of a user's input, for an error message.
fn shown(text: &str) -> String {
    text.chars().take(60).collect()
}

/// Rejects an option, for codecs that have none.
fn no_option(codec: &'static str, option: Option<&str>) -> Result<(), CodecError> {
    match option {
        None => Ok(()),
        Some(value) => Err(CodecError::Option {
            codec,
            value: shown(value),
            expected: "none",
        }),
    }
}

/// Parses an option that is a whole number within a range. Returns the default if there is no option.
fn number(
    codec: &'static str,
    option: Option<&str>,
    range: std::ops::RangeInclusive<u8>,
    default: u8,
    expected: &'static str,
) -> Result<u8, CodecError> {
    let Some(text) = option else {
        return Ok(default);
    };
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    match text.parse() {
        Ok(number) if digits && range.contains(&number) => Ok(number),
        _ => Err(CodecError::Option {
            codec,
            value: shown(text),
            expected,
        }),
    }
}

#[cfg(test)]
mod tests;

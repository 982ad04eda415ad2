//! Owns what all codecs have in common: [`Codec`], which turns a payload into a smaller one and back, the [`Limits`] of a
//! decoder, and the choice of one: by the user's words ([`parse`]) or by a payload's encoding ([`decode`]).
//!
//! | spec | takes | makes |
//! |---|---|---|
//! | `none` | anything | the same |
//! | `zstd[:level]`, 1 to 19, default 3 | anything | `<encoding>;zstd` |
//! | [`Packed`](dictionary::Packed), made of a dictionary | anything | `<encoding>;zstd` |
//! | `png` | raw pictures | `image/png` |
//! | `jpeg[:quality]`, 1 to 100, default 80 | raw pictures | `image/jpeg` |
//! | `webp[:quality]`, 1 to 100, default 80 | raw pictures | `image/webp` |
//! | `quantised:<error>` | arrays of floats | `application/octet-stream;quantised` |
use std::{fmt, sync::Arc};

use super::{dictionary::Dictionaries, encoding::Encoding, payload::Payload};

pub mod dictionary;
pub mod jpeg;
pub mod none;
pub mod png;
pub mod quantised;
pub mod webp;
pub mod zstd;

/// A way to make payloads smaller. Lossless ones ("packings") add a part to the encoding, and are undone before a program
/// sees the payload; those of pictures and arrays have an encoding of their own.
pub trait Codec: fmt::Debug + Send + Sync {
    /// What the user calls it, with its options, as [`parse`] reads it: `zstd:3`.
    fn name(&self) -> String;

    /// Makes it smaller.
    ///
    /// # Errors
    /// The payload is of a kind that this codec is not for, or too large.
    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError>;

    /// Undoes it, for what has an encoding that this codec makes.
    ///
    /// # Errors
    /// The bytes are not what the encoding says, or there is more in them than `limits` allow.
    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError>;
}

/// What a decoder may take, whatever a peer sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// The most bytes that come out of one payload; default 64 MiB.
    pub max_bytes: usize,
    /// The most pixels of one picture; default 16 million.
    pub max_pixels: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_bytes: 64 << 20,
            max_pixels: 16_000_000,
        }
    }
}

/// A codec can't do it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// No codec of that name. The text lists them.
    #[error("there is no codec {name:?}; there are: {known}")]
    Unknown {
        /// What was given.
        name: String,
        /// Those there are, with their options.
        known: &'static str,
    },
    /// An option that the codec does not have, or a value out of its range.
    #[error("{codec}: {value:?} is not its option: {wanted}")]
    Option {
        /// Which codec.
        codec: &'static str,
        /// What was given.
        value: String,
        /// What it takes.
        wanted: &'static str,
    },
    /// It is not for such payloads.
    #[error("{codec} is not for {found}: it is for {wanted}")]
    Kind {
        /// Which codec.
        codec: &'static str,
        /// What the payload is.
        found: Encoding,
        /// What it takes.
        wanted: &'static str,
    },
    /// The bytes are wrong or cut off.
    #[error("this is no valid {format}: {reason}")]
    Damaged {
        /// Which format.
        format: &'static str,
        /// What is wrong.
        reason: String,
    },
    /// There is more in it than may come out.
    #[error("this {format} holds {found}, and {limit} is the limit")]
    TooLarge {
        /// Which format.
        format: &'static str,
        /// How much it would be, with its unit, as far as known.
        found: String,
        /// How much may be, with its unit.
        limit: String,
    },
    /// The dictionary that it was made with is not here (yet).
    #[error("made with the dictionary {id}, which is not known here: the sender's program has it")]
    Dictionary {
        /// Its id.
        id: u32,
    },
    /// It could not be written, mostly for want of memory.
    #[error("{codec} could not write it: {reason}")]
    Failed {
        /// Which codec.
        codec: &'static str,
        /// What the library says.
        reason: String,
    },
}

const KNOWN: &str =
    "none, zstd[:1 to 19], png, jpeg[:1 to 100], webp[:1 to 100], quantised:<largest error>";

/// Packings within one another: deeper ones have no use but to keep a receiver busy.
const MAX_NESTING: usize = 2;

/// The codec of a spec, such as `jpeg:60`; the module's table lists them.
///
/// # Errors
/// [`CodecError::Unknown`], [`CodecError::Option`].
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
            let (name, known) = (shown(spec), KNOWN);
            return Err(CodecError::Unknown { name, known });
        }
    })
}

/// Whether there are packings to undo.
pub fn is_packed(encoding: &Encoding) -> bool {
    encoding.unpacked(zstd::NAME).is_some()
}

/// Undoes the packings of what a peer sent. Pictures and arrays stay as they are ([`Payload::picture`],
/// [`Payload::array`]), and so does what has an encoding that is not known here.
///
/// # Errors
/// What is packed is damaged, too large, or made with a dictionary that is not in `dictionaries`.
pub fn decode(
    payload: &Payload,
    limits: &Limits,
    dictionaries: &Dictionaries,
) -> Result<Payload, CodecError> {
    let mut payload = payload.clone();
    let mut depth = 0;
    while let Some(encoding) = payload.encoding.unpacked(zstd::NAME) {
        depth += 1;
        if depth > MAX_NESTING {
            return Err(CodecError::TooLarge {
                format: zstd::NAME,
                found: format!("more than {MAX_NESTING} packings in one another"),
                limit: MAX_NESTING.to_string(),
            });
        }
        let bytes = zstd::unpack(&payload.bytes, limits.max_bytes, dictionaries)?;
        payload = Payload::new(bytes, encoding);
    }
    Ok(payload)
}

impl Limits {
    /// For what is here already, such as a program's own.
    pub(super) fn any() -> Self {
        Self {
            max_bytes: isize::MAX as usize,
            max_pixels: usize::MAX,
        }
    }

    /// The bytes of a picture of these dimensions, if it may be.
    pub(super) fn picture(
        &self,
        format: &'static str,
        [width, height]: [u32; 2],
        channels: usize,
    ) -> Result<usize, CodecError> {
        if width == 0 || height == 0 {
            return Err(damaged(format, format_args!("{width}x{height} pixels")));
        }
        let pixels = u64::from(width) * u64::from(height);
        if pixels > self.max_pixels as u64 {
            return Err(CodecError::TooLarge {
                format,
                found: format!("{width}x{height} pixels"),
                limit: format!("{} pixels", self.max_pixels),
            });
        }
        self.bytes(format, pixels.saturating_mul(channels as u64))
    }

    /// So many bytes, if they may be.
    pub(super) fn bytes(&self, format: &'static str, bytes: u64) -> Result<usize, CodecError> {
        match usize::try_from(bytes) {
            Ok(bytes) if bytes <= self.max_bytes => Ok(bytes),
            _ => Err(CodecError::TooLarge {
                format,
                found: format!("{bytes} bytes"),
                limit: format!("{} bytes", self.max_bytes),
            }),
        }
    }
}

fn damaged(format: &'static str, reason: impl fmt::Display) -> CodecError {
    let reason = reason.to_string();
    CodecError::Damaged { format, reason }
}

/// What a user wrote, not repeated whole if it is long.
fn shown(text: &str) -> String {
    text.chars().take(60).collect()
}

/// For codecs without options.
fn no_option(codec: &'static str, option: Option<&str>) -> Result<(), CodecError> {
    match option {
        None => Ok(()),
        Some(value) => Err(CodecError::Option {
            codec,
            value: shown(value),
            wanted: "it has none",
        }),
    }
}

/// A whole number out of a range, or the default.
fn number(
    codec: &'static str,
    option: Option<&str>,
    range: std::ops::RangeInclusive<u8>,
    default: u8,
    wanted: &'static str,
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
            wanted,
        }),
    }
}

#[cfg(test)]
mod tests;

//! Defines [`CodecError`]: why a codec cannot be created, or cannot encode or decode a payload.
use std::error::Error;

use super::encoding::Encoding;
use crate::cause::Cause;

/// A codec cannot be created, or cannot encode or decode a payload.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// There is no codec of that name. The message lists those that exist.
    #[error("there is no codec {name:?}; available codecs: {available}")]
    Unknown {
        /// The name that was given.
        name: String,
        /// The available codecs, with their options.
        available: &'static str,
    },
    /// The codec does not have the option, or its value is out of range.
    #[error("{codec}: invalid option {value:?}: expected {expected}")]
    Option {
        /// The name of the codec.
        codec: &'static str,
        /// The value that was given.
        value: String,
        /// The expected option.
        expected: &'static str,
    },
    /// The codec does not support this kind of payload.
    #[error("{codec} cannot process {found}: it requires {expected}")]
    Kind {
        /// The name of the codec.
        codec: &'static str,
        /// The encoding of the payload.
        found: Encoding,
        /// The supported payloads.
        expected: &'static str,
    },
    /// The bytes are invalid or truncated.
    #[error("invalid {format}: {reason}")]
    Damaged {
        /// The format.
        format: &'static str,
        /// The reason.
        #[source]
        reason: Cause,
    },
    /// The decoded payload would exceed a limit.
    #[error("this {format} is too large: {found}; the limit is {limit}")]
    TooLarge {
        /// The format.
        format: &'static str,
        /// The decoded size with its unit, as far as it is known.
        found: String,
        /// The limit with its unit.
        limit: String,
    },
    /// The payload was encoded with a dictionary that this program does not have (yet).
    #[error("encoded with the dictionary {id}, which this program does not have: the sender must share it")]
    Dictionary {
        /// The id of the dictionary.
        id: u32,
    },
    /// Encoding failed, in most cases because there is not enough memory.
    #[error("{codec} failed: {reason}")]
    Failed {
        /// The name of the codec.
        codec: &'static str,
        /// The reason that the library reports.
        #[source]
        reason: Cause,
    },
}

/// Returns the error for bytes that are not of `format`.
pub(crate) fn damaged(
    format: &'static str,
    reason: impl Into<Box<dyn Error + Send + Sync>>,
) -> CodecError {
    let reason = Cause::new(reason);
    CodecError::Damaged { format, reason }
}

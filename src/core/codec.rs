//! Owns what all codecs have in common: [`Codec`], which turns a payload into a smaller one and back, the [`Limits`] of a
//! decoder, and the choice of one: by the user's words ([`parse`]) or by a payload's encoding ([`decode`]).
use std::fmt;

use super::{encoding::Encoding, payload::Payload};

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
}

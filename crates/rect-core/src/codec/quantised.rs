//! Encodes arrays of floats in quantised form: the error of each number is bounded, and smooth data takes a byte per
//! number or less.
//!
//! | bytes | content |
//! |---|---|
//! | 1 | high half: the version, 1; low half: the number of dimensions, 1 to 8 |
//! | 1 | bit 0: `f64` instead of `f32`; bits 1 and 2: the order of the prediction; bits 3 and 4: the body: 0 plain, 1 zstd, 2 raw |
//! | 1 or more each | the dimensions, LEB128 |
//! | 4 | the step, `f32` (not before a raw body) |
//! | 1 or more | the distance of the prediction, LEB128 (not before a raw body) |
//! | 1 or more | the number of exceptions, LEB128 (not before a raw body) |
//! | the rest | the body. Raw: the numbers themselves. Otherwise, optionally as one zstd frame: for each exception, the count of numbers since the previous exception (LEB128) and the number itself; then for each other number, its difference from the prediction in steps (zigzag and LEB128) |
//!
//! A number is `level * step` in `f64`, rounded to its type. The prediction of a level depends on the order. Order 0
//! predicts 0. Order 1 predicts the level that lies the distance before it. Order 2 continues the difference between
//! that level and the one at twice the distance. Exceptions are numbers that no level approximates closely enough: NaN,
//! the infinities, and too large numbers; the level of an exception is the one that order 1 predicts. All numbers are
//! little endian; levels have 64 bits and wrap around.
use std::borrow::Cow;

use super::{damaged, shown, zstd, Codec, CodecError, Limits};
use crate::{
    codec::{
        array::{self, Array, Element, MAX_DIMENSIONS},
        dictionary::Dictionaries,
    },
    message::{encoding::Encoding, payload::Payload},
};

mod body;
mod levels;
mod varint;
use levels::{Float, Prediction};

/// The name of the codec.
pub const NAME: &str = "quantised";
/// The encoding of quantised arrays.
pub const ENCODING: &str = "application/octet-stream;quantised";
const FORMAT: &str = "quantised array";

const VERSION: u8 = 1;
const DOUBLE: u8 = 1;
const PLAIN: u8 = 0;
const COMPRESSED: u8 = 1;
const RAW: u8 = 2;
/// The compression level of zstd for the body. Higher levels gain nothing on residuals.
const LEVEL: u8 = 3;

/// A lossy codec with a bounded error, for arrays of `f32` and `f64`.
#[derive(Clone, Copy, Debug)]
pub struct Quantised {
    error: f64,
}

impl Quantised {
    /// Creates a codec that changes each number by at most `error`, in the unit of the numbers. Range: 1e-30 to 1e30.
    ///
    /// # Errors
    /// Returns [`CodecError::Option`] if `error` is out of range.
    pub fn new(error: f64) -> Result<Self, CodecError> {
        if !(1e-30..=1e30).contains(&error) {
            return Err(invalid_error(&error.to_string()));
        }
        Ok(Self { error })
    }

    pub(super) fn parse(option: Option<&str>) -> Result<Self, CodecError> {
        let text = option.unwrap_or_default();
        let error = text.parse().map_err(|_| invalid_error(text))?;
        Self::new(error)
    }
}

fn invalid_error(text: &str) -> CodecError {
    CodecError::Option {
        codec: NAME,
        value: shown(text),
        expected: "the largest error of a number, 1e-30 to 1e30, such as `quantised:0.01`",
    }
}

impl Codec for Quantised {
    fn name(&self) -> String {
        format!("{NAME}:{}", self.error)
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        let array = Array::raw(payload, &Limits::any()).transpose()?;
        let bytes = array.and_then(|array| match array.element() {
            Element::F32 => Some(write(&array, &array.numbers::<f32>()?, self.error)),
            Element::F64 => Some(write(&array, &array.numbers::<f64>()?, self.error)),
            _ => None,
        });
        let bytes = bytes.ok_or_else(|| CodecError::Kind {
            codec: NAME,
            found: payload.encoding.clone(),
            expected: "raw arrays of f32 or f64",
        })?;
        Ok(Payload::new(bytes, Encoding::new(ENCODING)))
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        read(&payload.bytes, limits).map(Array::payload)
    }
}

fn write<T: Float>(array: &Array, numbers: &[T], error: f64) -> Vec<u8> {
    let step = levels::step(numbers, error);
    let level = |&number: &T| levels::level(number, step, error);
    let levels: Vec<Option<i64>> = numbers.iter().map(level).collect();
    let prediction = Prediction::best(&levels, array.shape());
    let body = body::write(numbers, &levels, prediction);
    let mut raw = head::<T>(array, 0, RAW);
    raw.extend_from_slice(array.bytes());
    // The decoder relies on this: a body is never larger than the array.
    if body.len() > array.bytes().len() {
        return raw;
    }
    let compressed = zstd::compress(&body, LEVEL, None).ok();
    let compressed = compressed.filter(|compressed| compressed.len() < body.len());
    let (kind, body) = match compressed {
        Some(compressed) => (COMPRESSED, compressed),
        None => (PLAIN, body),
    };
    let mut bytes = head::<T>(array, prediction.order, kind);
    bytes.extend_from_slice(&step.to_le_bytes());
    varint::write(&mut bytes, prediction.distance as u64);
    let exceptions = levels.iter().filter(|level| level.is_none()).count();
    varint::write(&mut bytes, exceptions as u64);
    bytes.extend_from_slice(&body);
    if bytes.len() < raw.len() {
        bytes
    } else {
        raw
    }
}

fn head<T: Float>(array: &Array, order: u8, body: u8) -> Vec<u8> {
    let double = if T::ELEMENT == Element::F64 {
        DOUBLE
    } else {
        0
    };
    // An array has eight dimensions at most.
    let dimensions = array.shape().len() as u8;
    let mut bytes = vec![VERSION << 4 | dimensions, double | order << 1 | body << 3];
    for &length in array.shape() {
        varint::write(&mut bytes, length as u64);
    }
    bytes
}

/// Decodes a quantised array.
pub(crate) fn read(bytes: &[u8], limits: &Limits) -> Result<Array, CodecError> {
    let (&[first, second], mut rest) = bytes.split_first_chunk().ok_or_else(truncated)?;
    let dimensions = usize::from(first & 15);
    if first >> 4 != VERSION || second >> 5 != 0 {
        return Err(damaged(FORMAT, "unsupported version"));
    }
    if !(1..=MAX_DIMENSIONS).contains(&dimensions) {
        return Err(damaged(FORMAT, format!("{dimensions} dimensions")));
    }
    let mut shape = Vec::with_capacity(dimensions);
    for _ in 0..dimensions {
        shape.push(length(&mut rest)?);
    }
    let element = match second & DOUBLE {
        0 => Element::F32,
        _ => Element::F64,
    };
    let size = array::size(element, &shape, limits)?;
    let (order, body) = (second >> 1 & 3, second >> 3);
    if body == RAW {
        return Array::new(element, &shape, rest.to_vec());
    }
    let (step, mut rest) = rest.split_first_chunk().ok_or_else(truncated)?;
    let step = f32::from_le_bytes(*step);
    if !(step.is_finite() && step > 0.0) {
        return Err(damaged(FORMAT, format!("a step of {step}")));
    }
    let (distance, exceptions) = (length(&mut rest)?, length(&mut rest)?);
    let count = size / element.bytes();
    if order > 2 || distance == 0 || distance > count.max(1) || exceptions > count {
        return Err(damaged(FORMAT, "its prediction is not possible"));
    }
    let body = match body {
        PLAIN => Cow::Borrowed(rest),
        // A larger body would have been stored raw.
        COMPRESSED => zstd::decompress(rest, size, &Dictionaries::default())?.into(),
        _ => return Err(damaged(FORMAT, "unsupported version")),
    };
    let body = body::Body {
        bytes: &body,
        count,
        exceptions,
        prediction: Prediction { order, distance },
        step,
    };
    let numbers = match element {
        Element::F64 => body.read::<f64>()?,
        _ => body.read::<f32>()?,
    };
    Array::new(element, &shape, numbers)
}

fn length(bytes: &mut &[u8]) -> Result<usize, CodecError> {
    let length = varint::read(bytes).ok_or_else(truncated)?;
    usize::try_from(length).map_err(|_| damaged(FORMAT, format!("a length of {length}")))
}

fn truncated() -> CodecError {
    damaged(FORMAT, "it is truncated")
}

#[cfg(test)]
mod tests;

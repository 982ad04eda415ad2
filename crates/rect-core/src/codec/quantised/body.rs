//! Encodes and decodes the body of a quantised array: the exceptions, then the residuals.
use super::{
    levels::{self, Float, Past, Prediction},
    truncated, varint, FORMAT,
};
use crate::codec::{damaged, CodecError};

/// Encodes the body. Numbers without a level are exceptions.
pub fn write<T: Float>(numbers: &[T], levels: &[Option<i64>], prediction: Prediction) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(numbers.len() + 16);
    let mut between = 0;
    for (number, level) in numbers.iter().zip(levels) {
        between += 1;
        if level.is_none() {
            varint::write(&mut bytes, between - 1);
            number.write(&mut bytes);
            between = 0;
        }
    }
    let mut past = Past::new(prediction);
    for &level in levels {
        if let Some(level) = level {
            let residual = level.wrapping_sub(past.prediction());
            varint::write(&mut bytes, varint::zigzag(residual));
        }
        past.push(level);
    }
    bytes
}

/// An untrusted body with the values of its header.
pub struct Body<'a> {
    pub bytes: &'a [u8],
    pub count: usize,
    pub exceptions: usize,
    pub prediction: Prediction,
    pub step: f32,
}

impl Body<'_> {
    /// Decodes the numbers, little endian.
    ///
    /// # Errors
    /// Returns an error if the body is truncated, or longer than its header states.
    pub fn read<T: Float>(&self) -> Result<Vec<u8>, CodecError> {
        let mut residuals = self.bytes;
        for _ in 0..self.exceptions {
            self.exception::<T>(&mut residuals)?;
        }
        // Each residual takes at least one byte. This is checked before memory is allocated.
        if residuals.len() < self.count - self.exceptions {
            return Err(truncated());
        }
        let mut exceptions = self.bytes;
        let mut left = self.exceptions;
        let mut next = self.next::<T>(&mut exceptions, &mut left)?;
        let mut past = Past::new(self.prediction);
        let mut numbers = Vec::with_capacity(self.count * T::ELEMENT.bytes());
        for _ in 0..self.count {
            if let Some((0, number)) = next {
                number.write(&mut numbers);
                past.push(None);
                next = self.next::<T>(&mut exceptions, &mut left)?;
                continue;
            }
            let residual = varint::read(&mut residuals).ok_or_else(truncated)?;
            let level = past.prediction().wrapping_add(varint::unzigzag(residual));
            levels::number::<T>(level, self.step).write(&mut numbers);
            past.push(Some(level));
            next = next.map(|(between, number)| (between - 1, number));
        }
        if next.is_some() || !residuals.is_empty() {
            return Err(damaged(FORMAT, "it is longer than its header states"));
        }
        Ok(numbers)
    }

    /// Reads the next exception, if any of the `left` exceptions remains.
    fn next<T: Float>(
        &self,
        exceptions: &mut &[u8],
        left: &mut usize,
    ) -> Result<Option<(u64, T)>, CodecError> {
        if *left == 0 {
            return Ok(None);
        }
        *left -= 1;
        self.exception(exceptions).map(Some)
    }

    /// Reads the count of numbers since the previous exception, and the exception.
    fn exception<T: Float>(&self, bytes: &mut &[u8]) -> Result<(u64, T), CodecError> {
        let between = varint::read(bytes).ok_or_else(truncated)?;
        let (number, rest) = bytes
            .split_at_checked(T::ELEMENT.bytes())
            .ok_or_else(truncated)?;
        *bytes = rest;
        Ok((between, T::read(number).ok_or_else(truncated)?))
    }
}

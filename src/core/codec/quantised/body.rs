//! Owns the body of a quantised array: the exceptions, then the residuals.
use super::{
    cut,
    levels::{self, Float, Past, Prediction},
    varint, FORMAT,
};
use crate::core::codec::{damaged, CodecError};

/// The body of these numbers; those without a level are exceptions.
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

/// A body that a peer sent, and what its head says of it.
pub struct Body<'a> {
    pub bytes: &'a [u8],
    pub count: usize,
    pub exceptions: usize,
    pub prediction: Prediction,
    pub step: f32,
}

impl Body<'_> {
    /// The numbers, little endian.
    ///
    /// # Errors
    /// It is cut off, or there is more in it than its head says.
    pub fn read<T: Float>(&self) -> Result<Vec<u8>, CodecError> {
        let mut residuals = self.bytes;
        for _ in 0..self.exceptions {
            self.exception::<T>(&mut residuals)?;
        }
        // Each takes a byte at least: before what they need is allocated.
        if residuals.len() < self.count - self.exceptions {
            return Err(cut());
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
            let residual = varint::read(&mut residuals).ok_or_else(cut)?;
            let level = past.prediction().wrapping_add(varint::unzigzag(residual));
            levels::number::<T>(level, self.step).write(&mut numbers);
            past.push(Some(level));
            next = next.map(|(between, number)| (between - 1, number));
        }
        if next.is_some() || !residuals.is_empty() {
            return Err(damaged(FORMAT, "there is more in it than it says"));
        }
        Ok(numbers)
    }

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

    /// How many numbers lie before it, and the exception.
    fn exception<T: Float>(&self, bytes: &mut &[u8]) -> Result<(u64, T), CodecError> {
        let between = varint::read(bytes).ok_or_else(cut)?;
        let (number, rest) = bytes.split_at_checked(T::ELEMENT.bytes()).ok_or_else(cut)?;
        *bytes = rest;
        Ok((between, T::read(number).ok_or_else(cut)?))
    }
}

//! Defines numeric arrays: numbers of one type in up to 8 dimensions, little endian, with the last index varying
//! fastest. They are sent with the encoding `application/octet-stream;array;f32;480x640`.
use bytes::Bytes;

use super::limits::Limits;
use crate::message::{
    codec_error::{damaged, CodecError},
    encoding::{Encoding, EncodingKind},
    payload::{Payload, PayloadError, ToPayload},
};

const KIND: &str = "array";
/// The maximum number of dimensions.
pub const MAX_DIMENSIONS: usize = 8;

/// An array of numbers of one type. Clones share the numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Array {
    element: Element,
    shape: Vec<usize>,
    bytes: Bytes,
}

/// A Rust type that can be the element of an array.
pub trait Number: Copy + sealed::Sealed {
    /// The element type.
    const ELEMENT: Element;
    /// Appends the number, little endian.
    fn write(self, bytes: &mut Vec<u8>);
    /// Reads a number from exactly [`Element::bytes`] bytes. Returns `None` if there are more or fewer.
    fn read(bytes: &[u8]) -> Option<Self>;
}

mod sealed {
    pub trait Sealed {}
}

macro_rules! elements {
    ($($name:ident $rust:ident),*) => {
        /// The element type of an array.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Element {
            $(#[doc = concat!("`", stringify!($rust), "`.")] $name,)*
        }

        impl Element {
            /// All element types.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Returns the name that encodings use.
            pub fn as_str(self) -> &'static str {
                match self { $(Self::$name => stringify!($rust),)* }
            }

            /// Returns the size of one number, in bytes.
            pub fn bytes(self) -> usize {
                match self { $(Self::$name => size_of::<$rust>(),)* }
            }
        }

        $(impl sealed::Sealed for $rust {}
        impl Number for $rust {
            const ELEMENT: Element = Element::$name;

            fn write(self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }

            fn read(bytes: &[u8]) -> Option<Self> {
                Some(Self::from_le_bytes(bytes.try_into().ok()?))
            }
        })*
    };
}

elements!(U8 u8, I8 i8, U16 u16, I16 i16, U32 u32, I32 i32, I64 i64, F32 f32, F64 f64);

impl Element {
    fn named(text: &str) -> Option<Self> {
        let mut all = Self::ALL.iter().copied();
        all.find(|element| element.as_str() == text)
    }
}

impl Array {
    /// Creates an array from the bytes of its numbers, little endian.
    ///
    /// # Errors
    /// Returns [`CodecError::Damaged`] if there are not one to eight dimensions, or if the number of bytes does not
    /// match them, and [`CodecError::TooLarge`] if no memory could hold an array of this shape.
    pub fn new(
        element: Element,
        shape: &[usize],
        bytes: impl Into<Bytes>,
    ) -> Result<Self, CodecError> {
        let bytes = bytes.into();
        if size(element, shape, &Limits::any())? != bytes.len() {
            let schema = schema(element, shape);
            let reason = format!("{} bytes are not the size of {schema}", bytes.len());
            return Err(damaged(KIND, reason));
        }
        let shape = shape.to_vec();
        Ok(Self {
            element,
            shape,
            bytes,
        })
    }

    /// Creates an array from numbers.
    ///
    /// # Errors
    /// Fails like [`new`](Self::new), if the count of numbers does not match the dimensions.
    pub fn of<T: Number>(shape: &[usize], numbers: &[T]) -> Result<Self, CodecError> {
        let mut bytes = Vec::with_capacity(size_of_val(numbers));
        numbers.iter().for_each(|number| number.write(&mut bytes));
        Self::new(T::ELEMENT, shape, bytes)
    }

    /// Returns the element type.
    pub fn element(&self) -> Element {
        self.element
    }

    /// Returns the dimensions. The index of the last one varies fastest.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Returns the bytes of the numbers, little endian.
    pub fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// Returns the numbers. `None` if they are of another type than `T`.
    pub fn numbers<T: Number>(&self) -> Option<Vec<T>> {
        if self.element != T::ELEMENT {
            return None;
        }
        let numbers = self.bytes.chunks_exact(self.element.bytes());
        numbers.map(T::read).collect()
    }

    /// Reads a raw array. Returns `None` if the payload is something else.
    pub(super) fn raw(payload: &Payload, limits: &Limits) -> Option<Result<Self, CodecError>> {
        let schema = payload.encoding.schema()?.strip_prefix(KIND)?;
        let schema = schema.strip_prefix(';')?;
        if payload.encoding.kind() != EncodingKind::Raw {
            return None;
        }
        let described = || {
            let (element, shape) = schema.split_once(';')?;
            let shape = shape.split('x').map(|length| length.parse().ok());
            let shape: Vec<usize> = shape.take(MAX_DIMENSIONS + 1).collect::<Option<_>>()?;
            Some((Element::named(element)?, shape))
        };
        Some(match described() {
            None => Err(damaged(
                KIND,
                format!("{schema:?} is not a valid element type and shape"),
            )),
            Some((element, shape)) => size(element, &shape, limits)
                .and_then(|_| Self::new(element, &shape, payload.bytes.clone())),
        })
    }

    pub(super) fn payload(self) -> Payload {
        let encoding = format!("{};{}", Encoding::RAW, schema(self.element, &self.shape));
        Payload::new(self.bytes, Encoding::new(encoding))
    }
}

/// Returns the size of an array of this shape in bytes, if the limits allow it.
pub(super) fn size(
    element: Element,
    shape: &[usize],
    limits: &Limits,
) -> Result<usize, CodecError> {
    if !(1..=MAX_DIMENSIONS).contains(&shape.len()) {
        let found = shape.len();
        let reason = format!("it has {found} dimensions, but must have 1 to {MAX_DIMENSIONS}");
        return Err(damaged(KIND, reason));
    }
    // An array with an empty dimension has no bytes, but its other dimensions must be within the limits nevertheless.
    let lengths = shape.iter().map(|&length| length.max(1) as u64);
    let bytes = lengths.fold(element.bytes() as u64, u64::saturating_mul);
    let bytes = limits.bytes(KIND, bytes)?;
    Ok(if shape.contains(&0) { 0 } else { bytes })
}

/// Returns the description of an array in its encoding: `array;f32;480x640`.
fn schema(element: Element, shape: &[usize]) -> String {
    let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
    format!("{KIND};{};{}", element.as_str(), shape.join("x"))
}

impl ToPayload for Array {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        Ok(self.clone().payload())
    }

    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(self.payload())
    }
}

#[cfg(test)]
mod tests;

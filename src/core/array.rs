//! Owns numeric arrays: numbers of one type in up to 8 dimensions, little endian, the last index running fastest, and how
//! they are sent: `application/octet-stream;array;f32;480x640`.
use bytes::Bytes;

use super::{
    codec::{quantised, CodecError, Limits},
    encoding::Encoding,
    payload::{Payload, PayloadError, ToPayload},
};

const KIND: &str = "array";
/// The most dimensions.
pub const MAX_DIMENSIONS: usize = 8;

/// Numbers of one type. Cloning shares them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Array {
    element: Element,
    shape: Vec<usize>,
    bytes: Bytes,
}

/// A Rust type that arrays may have.
pub trait Number: Copy + sealed::Sealed {
    /// What it is called.
    const ELEMENT: Element;
    /// Appends it, little endian.
    fn write(self, bytes: &mut Vec<u8>);
    /// Reads one of exactly [`Element::bytes`].
    fn read(bytes: &[u8]) -> Option<Self>;
}

mod sealed {
    pub trait Sealed {}
}

macro_rules! elements {
    ($($name:ident $rust:ident),*) => {
        /// The type of an array's numbers.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Element {
            $(#[doc = concat!("`", stringify!($rust), "`.")] $name,)*
        }

        impl Element {
            /// All there are.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// As in an encoding.
            pub fn as_str(self) -> &'static str {
                match self { $(Self::$name => stringify!($rust),)* }
            }

            /// How many bytes one takes.
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
    /// Of bytes, little endian.
    ///
    /// # Errors
    /// Not one to eight dimensions, or not the number of bytes that they make ([`CodecError::Damaged`]).
    pub fn new(
        element: Element,
        shape: &[usize],
        bytes: impl Into<Bytes>,
    ) -> Result<Self, CodecError> {
        let bytes = bytes.into();
        if size(element, shape, &Limits::any())? != bytes.len() {
            let text = text(element, shape);
            let reason = format!("{} bytes are not the numbers of {text}", bytes.len());
            return Err(damaged(reason));
        }
        let shape = shape.to_vec();
        Ok(Self {
            element,
            shape,
            bytes,
        })
    }

    /// Of numbers.
    ///
    /// # Errors
    /// Not one to eight dimensions, or not as many numbers as they make ([`CodecError::Damaged`]).
    pub fn of<T: Number>(shape: &[usize], numbers: &[T]) -> Result<Self, CodecError> {
        let mut bytes = Vec::with_capacity(size_of_val(numbers));
        numbers.iter().for_each(|number| number.write(&mut bytes));
        Self::new(T::ELEMENT, shape, bytes)
    }

    /// The type of its numbers.
    pub fn element(&self) -> Element {
        self.element
    }

    /// Its dimensions, the one that runs slowest first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Its numbers, little endian.
    pub fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// Its numbers; `None`: they are of another type.
    pub fn numbers<T: Number>(&self) -> Option<Vec<T>> {
        if self.element != T::ELEMENT {
            return None;
        }
        let numbers = self.bytes.chunks_exact(self.element.bytes());
        numbers.map(T::read).collect()
    }

    /// A raw one; `None`: the payload is something else.
    pub(super) fn raw(payload: &Payload, limits: &Limits) -> Option<Result<Self, CodecError>> {
        let schema = payload.encoding.schema()?.strip_prefix(KIND)?;
        let schema = schema.strip_prefix(';')?;
        if payload.encoding.media_type() != Encoding::RAW {
            return None;
        }
        let described = || {
            let (element, shape) = schema.split_once(';')?;
            let shape = shape.split('x').map(|length| length.parse().ok());
            let shape: Vec<usize> = shape.take(MAX_DIMENSIONS + 1).collect::<Option<_>>()?;
            Some((Element::named(element)?, shape))
        };
        Some(match described() {
            None => Err(damaged(format!(
                "{schema:?} does not say how its numbers lie"
            ))),
            Some((element, shape)) => size(element, &shape, limits)
                .and_then(|_| Self::new(element, &shape, payload.bytes.clone())),
        })
    }

    pub(super) fn payload(self) -> Payload {
        let encoding = format!("{};{}", Encoding::RAW, text(self.element, &self.shape));
        Payload::new(self.bytes, Encoding::new(encoding))
    }
}

/// The bytes of an array of this shape, if it may be.
pub(super) fn size(
    element: Element,
    shape: &[usize],
    limits: &Limits,
) -> Result<usize, CodecError> {
    if !(1..=MAX_DIMENSIONS).contains(&shape.len()) {
        let found = shape.len();
        return Err(damaged(format!(
            "it has {found} dimensions, and may have 1 to {MAX_DIMENSIONS}"
        )));
    }
    // One of no length is empty; the others are to be possible all the same.
    let lengths = shape.iter().map(|&length| length.max(1) as u64);
    let bytes = lengths.fold(element.bytes() as u64, u64::saturating_mul);
    let bytes = limits.bytes(KIND, bytes)?;
    Ok(if shape.contains(&0) { 0 } else { bytes })
}

fn text(element: Element, shape: &[usize]) -> String {
    let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
    format!("{KIND};{};{}", element.as_str(), shape.join("x"))
}

fn damaged(reason: String) -> CodecError {
    CodecError::Damaged {
        format: KIND,
        reason,
    }
}

impl ToPayload for Array {
    fn to_payload(&self) -> Result<Payload, PayloadError> {
        Ok(self.clone().payload())
    }

    fn into_payload(self) -> Result<Payload, PayloadError> {
        Ok(self.payload())
    }
}

impl Payload {
    /// As an array: a raw or a quantised one.
    ///
    /// # Errors
    /// It is something else ([`PayloadError::Other`]), damaged or too large ([`PayloadError::Codec`]).
    pub fn array(&self, limits: &Limits) -> Result<Array, PayloadError> {
        if self.encoding.as_str() == quantised::ENCODING {
            return Ok(quantised::read(&self.bytes, limits)?);
        }
        Ok(Array::raw(self, limits).ok_or_else(|| self.other("an array"))??)
    }
}

#[cfg(test)]
mod tests;

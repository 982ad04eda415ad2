//! Converts numeric arrays between C and the library.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use rect_core::{
    codec::array::{Array as LibraryArray, Element as LibraryElement},
    message::payload::ToPayload,
};

use crate::{
    argument::{items, require},
    boundary::{call, require_out, write_out, ErrorOut},
    failure::Code,
    handle::{self, Object},
    payload::PayloadView,
    picture::{write_encoding, CodecLimits, ENCODING_BYTES},
    text::{choice, number},
};

/// The type of the numbers of an array.
#[repr(C)]
pub enum Element {
    /// `uint8_t`.
    U8 = 0,
    /// `int8_t`.
    I8 = 1,
    /// `uint16_t`.
    U16 = 2,
    /// `int16_t`.
    I16 = 3,
    /// `uint32_t`.
    U32 = 4,
    /// `int32_t`.
    I32 = 5,
    /// `int64_t`.
    I64 = 6,
    /// `float`.
    F32 = 7,
    /// `double`.
    F64 = 8,
}

const ELEMENTS: [(u32, LibraryElement); 9] = [
    (Element::U8 as u32, LibraryElement::U8),
    (Element::I8 as u32, LibraryElement::I8),
    (Element::U16 as u32, LibraryElement::U16),
    (Element::I16 as u32, LibraryElement::I16),
    (Element::U32 as u32, LibraryElement::U32),
    (Element::I32 as u32, LibraryElement::I32),
    (Element::I64 as u32, LibraryElement::I64),
    (Element::F32 as u32, LibraryElement::F32),
    (Element::F64 as u32, LibraryElement::F64),
];

/// The maximum number of dimensions of an array.
pub const MAX_DIMENSIONS: usize = 8;

const _: () = assert!(MAX_DIMENSIONS == rect_core::codec::array::MAX_DIMENSIONS);

/// An array of numbers of one type, in little-endian byte order and row-major order (the last index varies fastest). It is
/// valid until `rect_drop(&array.id, ..)`.
#[repr(C)]
pub struct Array {
    /// The handle.
    pub id: u64,
    /// The type of the numbers: a `rect_element`.
    pub element: u32,
    /// Number of dimensions, 1 to `RECT_MAX_DIMENSIONS`.
    pub dimensions: u32,
    /// Size of each dimension, the slowest-varying one first.
    pub shape: [usize; MAX_DIMENSIONS],
    /// The numbers, at an address that is a multiple of 8.
    pub numbers: *const u8,
    /// Size of `numbers` in bytes.
    pub len: usize,
}

/// The bytes of an array, stored as 64-bit numbers so that they are aligned for every element type.
struct OwnedArray(Vec<u64>);

impl Object for OwnedArray {
    const KIND: &'static str = "array";
}

/// Copies the bytes to an address that is a multiple of 8.
fn aligned(bytes: &[u8]) -> Vec<u64> {
    let mut numbers = vec![0u64; bytes.len().div_ceil(8)];
    for (number, chunk) in numbers.iter_mut().zip(bytes.chunks(8)) {
        let mut eight = [0; 8];
        eight[..chunk.len()].copy_from_slice(chunk);
        *number = u64::from_ne_bytes(eight);
    }
    numbers
}

fn into_c(array: &LibraryArray) -> Array {
    let mut shape = [0; MAX_DIMENSIONS];
    // The number fits into 32 bits, because an array has at most 8 dimensions.
    let dimensions = array.shape().len() as u32;
    for (target, &size) in shape.iter_mut().zip(array.shape()) {
        *target = size;
    }
    let owned = Arc::new(OwnedArray(aligned(array.bytes())));
    let numbers = owned.0.as_ptr().cast();
    Array {
        element: number(&ELEMENTS, &array.element()),
        dimensions,
        shape,
        numbers,
        len: array.bytes().len(),
        id: handle::insert_shared(owned),
    }
}

/// Writes the encoding for a payload of numbers to `encoding`, e.g. `application/octet-stream;array;f32;2x3`.
///
/// `element` is a `rect_element`. `shape` points to the sizes of the dimensions, of which there are `dimensions`. `numbers`
/// are `len` bytes in little-endian byte order. The payload consists of the same bytes together with this encoding.
///
/// Returns `RECT_CODE_CODEC` if `len` does not match the shape. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_array_encoding(
    element: u32,
    shape: *const usize,
    dimensions: usize,
    numbers: *const c_void,
    len: usize,
    encoding: Option<&mut MaybeUninit<[c_char; ENCODING_BYTES]>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let element = choice("element", &ELEMENTS, element)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (shape, numbers) = unsafe {
            (
                items("shape", shape, dimensions)?,
                items("numbers", numbers.cast::<u8>(), len)?,
            )
        };
        // The copy is only used to check the length.
        let array = LibraryArray::new(element, shape, numbers.to_vec())?;
        write_encoding(array.to_payload()?.encoding.as_str(), encoding)
    })
}

/// Reads the array, raw or quantised, from a payload. `limits` may be NULL for the defaults.
///
/// Returns `RECT_CODE_PAYLOAD` if the payload is not an array, and `RECT_CODE_CODEC` if it is damaged or exceeds the limits.
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_array_read(
    payload: Option<&PayloadView>,
    limits: Option<&CodecLimits>,
    array: Option<&mut MaybeUninit<Array>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("array", &array)?;
        // SAFETY: the caller follows the rules of rect.h.
        let payload = unsafe { require("payload", payload)?.read() }?;
        let read = payload.array(&CodecLimits::read(limits))?;
        write_out("array", array, into_c(&read))
    })
}

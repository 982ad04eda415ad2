//! Owns numeric arrays as C gives and gets them.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use rect::core::array::{Array as Numbers, Element as Number, MAX_DIMENSIONS};
use rect::core::payload::ToPayload;

use crate::{
    argument::{items, there},
    boundary::{call, give, wanted, ErrorOut},
    failure::Code,
    handle::{self, Object},
    payload::PayloadView,
    picture::{give_encoding, CodecLimits, ENCODING_BYTES},
    text::{choice, number},
};

/// The type of an array's numbers.
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

const ELEMENTS: [(u32, Number); 9] = [
    (Element::U8 as u32, Number::U8),
    (Element::I8 as u32, Number::I8),
    (Element::U16 as u32, Number::U16),
    (Element::I16 as u32, Number::I16),
    (Element::U32 as u32, Number::U32),
    (Element::I32 as u32, Number::I32),
    (Element::I64 as u32, Number::I64),
    (Element::F32 as u32, Number::F32),
    (Element::F64 as u32, Number::F64),
];

/// The most dimensions of an array.
pub const DIMENSIONS: usize = 8;

const _: () = assert!(DIMENSIONS == MAX_DIMENSIONS);

/// Numbers of one type, little endian, the last index running fastest. They are there until `rect_drop(&array.id, ..)`.
#[repr(C)]
pub struct Array {
    /// Its handle.
    pub id: u64,
    /// The type of its numbers: a `rect_element`.
    pub element: u32,
    /// How many dimensions.
    pub dimensions: u32,
    /// Its dimensions, the one that runs slowest first.
    pub shape: [usize; DIMENSIONS],
    /// The numbers, at an address that is a multiple of 8.
    pub numbers: *const u8,
    /// How many bytes of them.
    pub len: usize,
}

/// Kept as 64-bit numbers, so that any number of it may be read where it is.
struct Held(Vec<u64>);

impl Object for Held {
    const KIND: &'static str = "array";
}

/// The bytes, where any number may begin.
fn aligned(bytes: &[u8]) -> Vec<u64> {
    let mut numbers = vec![0u64; bytes.len().div_ceil(8)];
    for (to, from) in numbers.iter_mut().zip(bytes.chunks(8)) {
        let mut eight = [0; 8];
        eight[..from.len()].copy_from_slice(from);
        *to = u64::from_ne_bytes(eight);
    }
    numbers
}

fn hold(array: &Numbers) -> Array {
    let mut shape = [0; DIMENSIONS];
    // At most 8.
    let dimensions = array.shape().len() as u32;
    for (to, &from) in shape.iter_mut().zip(array.shape()) {
        *to = from;
    }
    let held = Arc::new(Held(aligned(array.bytes())));
    let numbers = held.0.as_ptr().cast();
    Array {
        element: number(&ELEMENTS, &array.element()),
        dimensions,
        shape,
        numbers,
        len: array.bytes().len(),
        id: handle::insert_shared(held),
    }
}

/// The encoding of an array, which goes with its numbers, little endian, into a payload. `element`: a `rect_element`;
/// `len`: of the numbers, in bytes, which have to be as many as its shape says.
///
/// Thread: any.
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
        // SAFETY: as rect.h asks.
        let (shape, numbers) = unsafe {
            (
                items("shape", shape, dimensions)?,
                items("numbers", numbers.cast::<u8>(), len)?,
            )
        };
        // Only looked at, and not kept: the length is what is checked.
        let array = Numbers::new(element, shape, numbers.to_vec())?;
        give_encoding(array.to_payload()?.encoding.as_str(), encoding)
    })
}

/// The array in a payload, raw or quantised. `limits`: NULL for the default.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_array_read(
    payload: Option<&PayloadView>,
    limits: Option<&CodecLimits>,
    array: Option<&mut MaybeUninit<Array>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("array", &array)?;
        // SAFETY: as rect.h asks.
        let payload = unsafe { there("payload", payload)?.read() }?;
        let read = payload.array(&CodecLimits::read(limits))?;
        give("array", array, hold(&read))
    })
}

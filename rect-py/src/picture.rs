//! Encodes and decodes pictures and arrays of numbers.
use bytes::Bytes;
use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyBytes};
use rect_core::{
    cause::Cause,
    codec::{
        array::{Array, Element},
        picture::{Format, Picture},
        CodecError,
    },
    message::payload::ToPayload,
};

use crate::{
    codec::{limits, payload},
    detached::detached,
    errors::OrRaise,
};

/// Width, height, format and pixels.
type PictureFields<'py> = (u32, u32, &'static str, Bound<'py, PyBytes>);
/// Element type, shape and numbers.
type ArrayFields<'py> = (&'static str, Vec<usize>, Bound<'py, PyBytes>);

/// Makes a picture from pixels. Raises `CodecError` unless the number of bytes matches the size and format.
pub fn picture_of(
    width: u32,
    height: u32,
    format: &str,
    pixels: PyBackedBytes,
) -> PyResult<Picture> {
    let all = [Format::Grey8, Format::Rgb8, Format::Rgba8];
    let found = all.into_iter().find(|known| known.as_str() == format);
    let picture = match found {
        Some(format) => Picture::new(width, height, format, Bytes::from_owner(pixels)),
        None => Err(CodecError::Damaged {
            format: "picture",
            reason: Cause::new(format!(
                "there is no pixel format {format:?}; possible formats: grey8, rgb8, rgba8"
            )),
        }),
    };
    picture.or_raise()
}

/// Raises `CodecError` unless the number of bytes matches the size and format.
#[pyfunction]
pub fn picture(width: u32, height: u32, format: &str, pixels: PyBackedBytes) -> PyResult<()> {
    picture_of(width, height, format, pixels).map(drop)
}

/// Returns the encoding of a picture that is sent uncompressed: its pixels are the payload.
#[pyfunction]
pub fn picture_encoding(
    width: u32,
    height: u32,
    format: &str,
    pixels: PyBackedBytes,
) -> PyResult<String> {
    let picture = picture_of(width, height, format, pixels)?;
    Ok(picture.to_payload().or_raise()?.encoding.to_string())
}

/// Decodes the picture in a payload. Raises `PayloadError`.
#[pyfunction]
#[pyo3(signature = (bytes, encoding, max_bytes=None, max_pixels=None))]
pub fn read_picture<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
    max_bytes: Option<usize>,
    max_pixels: Option<usize>,
) -> PyResult<PictureFields<'py>> {
    let payload = payload(bytes, encoding);
    let limits = limits(max_bytes, max_pixels);
    let picture = detached(py, || payload.picture(&limits)).or_raise()?;
    Ok(picture_fields(py, &picture))
}

/// Scales a picture to another size. `size` is its width, height and format; `target` is the new width and height.
#[pyfunction]
pub fn scaled<'py>(
    py: Python<'py>,
    size: (u32, u32, String),
    pixels: PyBackedBytes,
    target: (u32, u32),
) -> PyResult<PictureFields<'py>> {
    let (width, height, format) = size;
    let picture = picture_of(width, height, &format, pixels)?;
    let scaled = detached(py, || picture.scaled(target.0, target.1)).or_raise()?;
    Ok(picture_fields(py, &scaled))
}

fn picture_fields<'py>(py: Python<'py>, picture: &Picture) -> PictureFields<'py> {
    let pixels = PyBytes::new(py, picture.pixels());
    let format = picture.format().as_str();
    (picture.width(), picture.height(), format, pixels)
}

/// Returns the encoding of an array that is sent uncompressed: little endian, the last index varying fastest.
#[pyfunction]
pub fn array_encoding(element: &str, shape: Vec<usize>, bytes: PyBackedBytes) -> PyResult<String> {
    let mut all = Element::ALL.iter().copied();
    let found = all.find(|known| known.as_str() == element);
    let array = match found {
        Some(element) => Array::new(element, &shape, Bytes::from_owner(bytes)),
        None => {
            let all: Vec<_> = Element::ALL
                .iter()
                .map(|element| element.as_str())
                .collect();
            let reason = format!(
                "there is no element type {element}; possible types: {}",
                all.join(", ")
            );
            Err(CodecError::Damaged {
                format: "array",
                reason: Cause::new(reason),
            })
        }
    };
    let array = array.or_raise()?;
    Ok(array.to_payload().or_raise()?.encoding.to_string())
}

/// Decodes the array in a payload, raw or quantised. Raises `PayloadError`.
#[pyfunction]
#[pyo3(signature = (bytes, encoding, max_bytes=None))]
pub fn read_array<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
    max_bytes: Option<usize>,
) -> PyResult<ArrayFields<'py>> {
    let payload = payload(bytes, encoding);
    let limits = limits(max_bytes, None);
    let array = detached(py, || payload.array(&limits)).or_raise()?;
    let numbers = PyBytes::new(py, array.bytes());
    Ok((array.element().as_str(), array.shape().to_vec(), numbers))
}

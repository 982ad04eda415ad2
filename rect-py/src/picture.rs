//! Owns pictures and arrays of numbers: how they lie in bytes, and reading what others sent.
use bytes::Bytes;
use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyBytes};
use rect::core::{
    array::{Array, Element},
    codec::CodecError,
    payload::ToPayload,
    picture::{Format, Picture},
};

use crate::{
    codec::{limits, payload},
    detached::detached,
    errors::OrRaise,
};

/// Width, height, format and pixels.
type Seen<'py> = (u32, u32, &'static str, Bound<'py, PyBytes>);
/// Element, shape and numbers.
type Counted<'py> = (&'static str, Vec<usize>, Bound<'py, PyBytes>);

/// A picture of pixels.
pub fn picture_of(
    width: u32,
    height: u32,
    format: &str,
    pixels: PyBackedBytes,
) -> PyResult<Picture> {
    let all = [Format::Grey8, Format::Rgb8, Format::Rgba8];
    let known = all.into_iter().find(|known| known.as_str() == format);
    let picture = match known {
        Some(format) => Picture::new(width, height, format, Bytes::from_owner(pixels)),
        None => Err(CodecError::Damaged {
            format: "picture",
            reason: format!("there is no pixel format {format:?}: grey8, rgb8 and rgba8 are"),
        }),
    };
    picture.or_raise()
}

/// Raises unless so many bytes are such a picture.
#[pyfunction]
pub fn picture(width: u32, height: u32, format: &str, pixels: PyBackedBytes) -> PyResult<()> {
    picture_of(width, height, format, pixels).map(drop)
}

/// The encoding of a picture that is sent raw: its pixels are the payload.
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

/// The picture in a payload.
#[pyfunction]
#[pyo3(signature = (bytes, encoding, max_bytes=None, max_pixels=None))]
pub fn read_picture<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
    max_bytes: Option<usize>,
    max_pixels: Option<usize>,
) -> PyResult<Seen<'py>> {
    let payload = payload(bytes, encoding);
    let limits = limits(max_bytes, max_pixels);
    let picture = detached(py, || payload.picture(&limits)).or_raise()?;
    Ok(seen(py, &picture))
}

/// A picture in another size.
#[pyfunction]
pub fn scaled<'py>(
    py: Python<'py>,
    size: (u32, u32, String),
    pixels: PyBackedBytes,
    wanted: (u32, u32),
) -> PyResult<Seen<'py>> {
    let (width, height, format) = size;
    let picture = picture_of(width, height, &format, pixels)?;
    let scaled = detached(py, || picture.scaled(wanted.0, wanted.1)).or_raise()?;
    Ok(seen(py, &scaled))
}

fn seen<'py>(py: Python<'py>, picture: &Picture) -> Seen<'py> {
    let pixels = PyBytes::new(py, picture.pixels());
    let format = picture.format().as_str();
    (picture.width(), picture.height(), format, pixels)
}

/// The encoding of numbers that are sent raw: little endian, the last index running fastest.
#[pyfunction]
pub fn array_encoding(element: &str, shape: Vec<usize>, bytes: PyBackedBytes) -> PyResult<String> {
    let mut all = Element::ALL.iter().copied();
    let known = all.find(|known| known.as_str() == element);
    let array = match known {
        Some(element) => Array::new(element, &shape, Bytes::from_owner(bytes)),
        None => {
            let all: Vec<_> = Element::ALL.iter().map(|known| known.as_str()).collect();
            let reason = format!("no numbers of {element}: {} are", all.join(", "));
            Err(CodecError::Damaged {
                format: "array",
                reason,
            })
        }
    };
    let array = array.or_raise()?;
    Ok(array.to_payload().or_raise()?.encoding.to_string())
}

/// The numbers in a payload, raw or quantised.
#[pyfunction]
#[pyo3(signature = (bytes, encoding, max_bytes=None))]
pub fn read_array<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
    max_bytes: Option<usize>,
) -> PyResult<Counted<'py>> {
    let payload = payload(bytes, encoding);
    let limits = limits(max_bytes, None);
    let array = detached(py, || payload.array(&limits)).or_raise()?;
    let numbers = PyBytes::new(py, array.bytes());
    Ok((array.element().as_str(), array.shape().to_vec(), numbers))
}

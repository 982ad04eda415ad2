//! Encodes and decodes the attachments of messages.

use pyo3::{prelude::*, types::PyBytes};
use rect_core::message::attachment::{Attachment, Sent};

/// Source, sequence number, and the time of sending: in milliseconds since 1970, only the low 16 bits of that number, or that of the
/// recorded message that is replayed.
type Fields = (u16, u32, Option<u64>, Option<u16>, Option<u64>);

/// Encodes the attachment of a message. `at_ms` is the time of sending in milliseconds since 1970; `low` holds the low
/// 16 bits of that number, and `recorded_ms` is the time of the recorded message that is replayed. One of them is given.
#[pyfunction]
#[pyo3(signature = (source, sequence, at_ms=None, low=None, recorded_ms=None))]
pub fn write_attachment(
    py: Python<'_>,
    source: u16,
    sequence: u32,
    at_ms: Option<u64>,
    low: Option<u16>,
    recorded_ms: Option<u64>,
) -> Bound<'_, PyBytes> {
    let sent = match (at_ms, low, recorded_ms) {
        (Some(at_ms), ..) => Sent::At(at_ms),
        (None, Some(low), _) => Sent::Low(low),
        (None, None, Some(recorded_ms)) => Sent::Replayed(recorded_ms),
        (None, None, None) => Sent::Unknown,
    };
    let attachment = Attachment {
        source,
        sequence,
        sent,
        lifetime_ms: None,
    };
    PyBytes::new(py, &attachment.encode())
}

/// Decodes an attachment. Returns `None` if the bytes are not an attachment of RECT.
#[pyfunction]
pub fn read_attachment(bytes: &[u8]) -> Option<Fields> {
    let attachment = Attachment::decode(bytes)?;
    let (at_ms, low, recorded_ms) = match attachment.sent {
        Sent::Unknown => (None, None, None),
        Sent::At(at_ms) => (Some(at_ms), None, None),
        Sent::Low(low) => (None, Some(low), None),
        Sent::Replayed(recorded_ms) => (None, None, Some(recorded_ms)),
    };
    let Attachment {
        source, sequence, ..
    } = attachment;
    Some((source, sequence, at_ms, low, recorded_ms))
}

//! Encodes and decodes the attachments of messages.
use std::time::{SystemTime, UNIX_EPOCH};

use pyo3::{prelude::*, types::PyBytes};
use rect::core::attachment::{Attachment, Sent};

/// Source, sequence number, and the time of sending: either in milliseconds since 1970, or only the low 16 bits of that
/// number.
type Fields = (u16, u32, Option<u64>, Option<u16>);

/// Encodes the attachment of a message. `at_ms` is the time of sending in milliseconds since 1970; `low` holds the low
/// 16 bits of that number, and is used if `at_ms` is `None`.
#[pyfunction]
#[pyo3(signature = (source, sequence, at_ms=None, low=None))]
pub fn write_attachment(
    py: Python<'_>,
    source: u16,
    sequence: u32,
    at_ms: Option<u64>,
    low: Option<u16>,
) -> Bound<'_, PyBytes> {
    let sent = match (at_ms, low) {
        (Some(at_ms), _) => Sent::At(at_ms),
        (None, Some(low)) => Sent::Low(low),
        (None, None) => Sent::Unknown,
    };
    let attachment = Attachment {
        source,
        sequence,
        sent,
        lifetime_ms: None,
    };
    PyBytes::new(py, &attachment.encode())
}

/// Returns the time by this computer's clock, in milliseconds since 1970.
pub fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_millis() as u64)
}

/// Decodes an attachment. Returns `None` if the bytes are not an attachment of RECT.
#[pyfunction]
pub fn read_attachment(bytes: &[u8]) -> Option<Fields> {
    let attachment = Attachment::decode(bytes)?;
    let (at_ms, low) = match attachment.sent {
        Sent::Unknown => (None, None),
        Sent::At(at_ms) | Sent::Replayed(at_ms) => (Some(at_ms), None),
        Sent::Low(low) => (None, Some(low)),
    };
    Some((attachment.source, attachment.sequence, at_ms, low))
}

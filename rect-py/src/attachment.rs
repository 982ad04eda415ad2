//! Owns the attachments of messages, as bytes.
use std::time::{SystemTime, UNIX_EPOCH};

use pyo3::{prelude::*, types::PyBytes};
use rect::core::attachment::{Attachment, Sent};

/// What an attachment says: source, number, milliseconds since 1970, and the low 16 bits of them instead.
type Told = (u16, u32, Option<u64>, Option<u16>);

/// The attachment of a message.
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
    };
    PyBytes::new(py, &attachment.encode())
}

/// The attachment of a message that is sent now.
#[pyfunction]
pub fn write_attachment_now(py: Python<'_>, source: u16, sequence: u32) -> Bound<'_, PyBytes> {
    write_attachment(py, source, sequence, Some(now_ms()), None)
}

/// Milliseconds since 1970, by this computer's clock.
#[pyfunction]
pub fn now_ms() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |since| since.as_millis() as u64)
}

/// What an attachment says; `None`: it is another program's own.
#[pyfunction]
pub fn read_attachment(bytes: &[u8]) -> Option<Told> {
    let attachment = Attachment::decode(bytes)?;
    let (at_ms, low) = match attachment.sent {
        Sent::Unknown => (None, None),
        Sent::At(at_ms) => (Some(at_ms), None),
        Sent::Low(low) => (None, Some(low)),
    };
    Some((attachment.source, attachment.sequence, at_ms, low))
}

//! Converts between Zenoh's types and those of the core.
use std::any::Any;

use bytes::Bytes;
use rect_core::{
    driver::Sample,
    message::{attachment::Encoded, encoding::Encoding, payload::Payload, urgency::Qos},
};
use zenoh::{
    bytes::{Encoding as ZenohEncoding, ZBytes},
    qos::{CongestionControl, Priority},
    sample::SampleKind,
};
use zenoh_buffers::{ZBuf, ZSliceBuffer};

/// An encoded attachment as a buffer of Zenoh's. A vector would be allocated in addition to Zenoh's own allocation.
#[derive(Debug)]
struct AttachmentBuffer(Encoded);

impl ZSliceBuffer for AttachmentBuffer {
    fn as_slice(&self) -> &[u8] {
        &self.0
    }

    fn as_any(&self) -> &dyn Any {
        self
    }

    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}

pub(super) fn attachment(encoded: Encoded) -> ZBytes {
    ZBuf::from(AttachmentBuffer(encoded)).into()
}

pub(super) fn priority(qos: Qos) -> Priority {
    Priority::try_from(qos.priority).unwrap_or_default()
}

pub(super) fn congestion_control(qos: Qos) -> CongestionControl {
    if qos.droppable {
        CongestionControl::Drop
    } else {
        CongestionControl::Block
    }
}

pub(super) fn payload(bytes: &ZBytes, encoding: &ZenohEncoding) -> Payload {
    Payload::new(owned(bytes), self::encoding(encoding))
}

/// Returns Zenoh's encoding as RECT's. Zenoh looks the text up in a table, so the encodings of most messages are compared first.
fn encoding(encoding: &ZenohEncoding) -> Encoding {
    const COMMON: [(ZenohEncoding, Encoding); 4] = [
        (ZenohEncoding::ZENOH_BYTES, Encoding::BYTES),
        (ZenohEncoding::APPLICATION_JSON, Encoding::JSON),
        (ZenohEncoding::TEXT_PLAIN, Encoding::TEXT),
        (ZenohEncoding::APPLICATION_CBOR, Encoding::CBOR),
    ];
    let known = COMMON.iter().find(|(common, _)| common == encoding);
    known.map_or_else(|| Encoding::new(encoding), |(_, known)| known.clone())
}

pub(super) fn sample(sample: &zenoh::sample::Sample) -> Sample {
    Sample {
        key: sample.key_expr().as_str().to_owned(),
        payload: payload(sample.payload(), sample.encoding()),
        attachment: sample.attachment().map(owned),
        is_deleted: sample.kind() == SampleKind::Delete,
        priority: sample.priority() as u8,
    }
}

pub(super) fn reply(reply: zenoh::query::Reply) -> Result<Sample, Payload> {
    match reply.result() {
        Ok(received) => Ok(sample(received)),
        Err(error) => Err(payload(error.payload(), error.encoding())),
    }
}

pub(super) fn owned(bytes: &ZBytes) -> Bytes {
    Bytes::from(bytes.to_bytes().into_owned())
}

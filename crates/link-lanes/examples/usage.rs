//! Measures the time for which a router counts a message that a link sends while somebody asks what the link carries, and how long
//! it looks at one while nobody does.
//!
//! `cargo run --release --example usage -p link-lanes`
use std::{
    hint::black_box,
    time::{Duration, Instant},
};

use link_lanes::{
    lanes::Lane,
    usage::{keys::KeyTable, Size, Usage},
};
use zenoh_buffers::ZBuf;
use zenoh_codec::{WCodec, Zenoh080};
use zenoh_protocol::{
    core::{CongestionControl, Encoding, Priority, Reliability, WireExpr},
    network::{push, Push},
    transport::{frame, FrameHeader},
    zenoh::{ext::AttachmentType, PushBody, Put},
};

const MESSAGES: u32 = 100_000;

fn main() {
    for (bytes, messages) in [(18, 1), (64, 1), (64, 8), (500, 1)] {
        let batch = batch(bytes, messages);
        let counting = measure(&batch, true) / messages;
        let idle = measure(&batch, false);
        println!(
            "{messages} message(s) of {bytes} B in a batch: {} ns for a message while it counts, {} ns for a batch otherwise",
            counting.as_nanos(),
            idle.as_nanos(),
        );
    }
}

/// Returns the time for a batch.
fn measure(batch: &[u8], is_counting: bool) -> Duration {
    let (keys, mut usage, now) = (KeyTable::default(), Usage::default(), Instant::now());
    if is_counting {
        usage.ask(now, Duration::from_secs(5));
    }
    let bytes = batch.len() as u64;
    let size = Size { bytes, cost: bytes };
    let start = Instant::now();
    for _ in 0..MESSAGES {
        let lane = Lane::of(Priority::Data);
        usage.on_batch(&keys, lane, black_box(batch), size, now);
    }
    start.elapsed() / MESSAGES
}

/// Returns a batch as a router forwards it, with a named key.
fn batch(payload_bytes: usize, messages: u32) -> Vec<u8> {
    let header = FrameHeader {
        reliability: Reliability::Reliable,
        sn: 300,
        ext_qos: frame::ext::QoSType::new(Priority::Data),
    };
    let message = Push {
        wire_expr: WireExpr::from("rect/wombat-1/arm/angle"),
        ext_qos: push::ext::QoSType::new(Priority::Data, CongestionControl::Drop, false),
        ext_tstamp: None,
        ext_nodeid: push::ext::NodeIdType { node_id: 3 },
        ext_ts_stack: None,
        payload: PushBody::Put(Put {
            timestamp: None,
            encoding: Encoding::empty(),
            ext_sinfo: None,
            ext_attachment: Some(AttachmentType {
                buffer: vec![7; 14].into(),
            }),
            ext_unknown: Vec::new(),
            payload: ZBuf::from(vec![7; payload_bytes]),
        }),
    };
    let mut bytes = Vec::new();
    let codec = Zenoh080::new();
    let mut is_written = codec.write(&mut bytes, &header).is_ok();
    for _ in 0..messages {
        is_written &= codec.write(&mut bytes, &message).is_ok();
    }
    assert!(is_written, "a vector has room");
    bytes
}

//! Decodes untrusted attachments, headers of requests and keys. A decoded value must encode to the same value; a message key must equal
//! the key that its sender builds from the decoded address. A request that is carried out at most once is not carried out again. Tokens
//! of throttled subscriptions, and their messages, are handled.
use std::time::Instant;

use rect_core::{
    catalogue::Instance,
    driver::{Answer, Driver, Event, Id, Sample, Step},
    message::{
        attachment::{Attachment, MAX_BYTES},
        encoding::Encoding,
        payload::Payload,
        request::RequestHeader,
        throttled::{header::Header, Wish},
        Delivery, Inbound,
    },
    name::{key::KeySpace, Name, topic::Pattern},
    retry::once::{Admission, Once},
    throttle::Throttle,
};

fn name(text: &str) -> Name {
    Name::new(text).expect("a name")
}

/// Runs the target on one input.
pub fn run(bytes: &[u8]) {
    if let Some(attachment) = Attachment::decode(bytes) {
        let again = attachment.encode();
        assert!(again.len() <= MAX_BYTES);
        assert_eq!(Attachment::decode(&again), Some(attachment));
    }
    if let Some(header) = RequestHeader::decode(bytes) {
        assert_eq!(RequestHeader::decode(&header.encode()).as_ref(), Some(&header));
        let (once, now) = (Once::new(name("w"), header.once_by.unwrap_or(Instance(0))), Instant::now());
        if let Admission::Execute((), execution) = once.on_request(now, Some(&header), ()) {
            assert_eq!(execution.is_some(), header.once_by.is_some());
            let waiting = execution.and_then(|execution| execution.on_result(&Answer::None));
            assert_eq!(waiting, None);
        }
        let again = once.on_request(now, Some(&header), ());
        assert_eq!(matches!(again, Admission::Execute(..)), header.once_by.is_none());
    }
    let here = KeySpace {
        fleet: name("rect"),
        robot: name("w"),
    };
    throttled(&here, bytes);
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    if let Some(address) = here.address(text) {
        let there = KeySpace {
            fleet: here.fleet.clone(),
            robot: address.sender.clone(),
        };
        let key = match &address.recipient {
            Some(to) => there.message(to, &address.topic),
            None => there.publication(&address.topic),
        };
        assert_eq!(key, text);
    }
    if let Ok(pattern) = Pattern::new(text) {
        assert_eq!(Pattern::new(&pattern.to_string()), Ok(pattern));
    }
}

/// A subscriber receives the bytes as the attachment of a throttled message, and a throttle as the rest of a token and as a message.
fn throttled(here: &KeySpace, bytes: &[u8]) {
    if let Some((header, attachment)) = Header::decode(bytes) {
        let again = header.encode(Some(attachment));
        assert_eq!(Header::decode(&again).map(|(header, _)| header), Some(header));
    }
    let (Ok(pattern), Ok(wish)) = (Pattern::new("*/x"), Wish::new(Some(2.0), true)) else {
        return;
    };
    let mut inbound = Inbound::of_pattern(here.clone(), &pattern, wish, Instant::now());
    for number in 0..2 {
        let delivery = Delivery {
            key: "rect/v/@rect/throttled/w/x",
            payload: Payload::new(vec![number], Encoding::BYTES),
            attachment: Some(bytes),
            priority: 5,
            is_deleted: false,
            subscription: 0,
        };
        let _ = inbound.on_delivery(delivery, Instant::now);
    }
    let mut throttle = Throttle::new(here.clone());
    for (id, key) in [(0, "rect/v/@rect/throttle"), (1, "rect/w")] {
        let sample = Sample {
            key: format!("{key}/{}", String::from_utf8_lossy(bytes)),
            payload: Payload::new(bytes.to_vec(), Encoding::BYTES),
            attachment: Some(bytes.to_vec().into()),
            is_deleted: false,
            priority: Sample::PRIORITY,
        };
        let _ = throttle.on_event(Instant::now(), Event::Sample { id: Id(id), sample });
        while !matches!(throttle.poll(Instant::now()), Step::Wait(_)) {}
    }
}

//! Decodes untrusted attachments, headers of requests and keys. A decoded value must encode to the same value; a message key must equal
//! the key that its sender builds from the decoded address. A request that is carried out at most once is not carried out again.
use std::time::Instant;

use rect_core::{
    catalogue::Instance,
    driver::Answer,
    message::{attachment::{Attachment, MAX_BYTES}, request::RequestHeader},
    name::{key::KeySpace, Name, topic::Pattern},
    retry::once::{Admission, Once},
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
    let Ok(text) = std::str::from_utf8(bytes) else {
        return;
    };
    let here = KeySpace {
        fleet: name("rect"),
        robot: name("w"),
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

//! Decodes untrusted attachments and keys. A decoded attachment must encode to the same value; a message key must equal
//! the key that its sender builds from the decoded address.
use rect_core::{message::attachment::{Attachment, MAX_BYTES}, name::{key::KeySpace, Name, topic::Pattern}};

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

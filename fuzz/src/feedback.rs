//! Decodes untrusted notices and feedback of streams. A decoded message must encode to the same value, and feedback
//! must not move the sender's rates beyond its limits.
use std::time::{Duration, Instant};

use rect_core::{message::{encoding::Encoding, payload::Payload}, name::Name, stream::{feedback::{Feedback, MAX_BYTES}, notice::Notice, sender::{Options, Sender}, Group}};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    if let Ok(notice) = Notice::decode(input) {
        assert_eq!(Notice::decode(&notice.encode()).ok(), Some(notice));
    }
    let mut now = Instant::now();
    let robot = Name::new("wombat-2").expect("a name");
    let mut sender = Sender::new(Options::default(), 1, 0, now);
    let frame = Payload::new(vec![0; 3000], Encoding::JPEG);
    for message in input.chunks(MAX_BYTES) {
        let Ok(feedback) = Feedback::decode(message) else {
            continue;
        };
        let bytes = feedback.encode();
        assert!(bytes.len() <= MAX_BYTES);
        assert_eq!(Feedback::decode(&bytes), Ok(feedback));
        now += Duration::from_millis(500);
        sender.on_feedback(&robot, &feedback, now);
        sender.on_subscribers(Group::Main, true);
        for job in sender.offer(320 * 240, now) {
            sender.on_encoded(job, &frame, now);
        }
        let limits = Options::default().rates;
        for group in sender.status().groups {
            assert!((limits.min_bytes_per_s..=limits.max_bytes_per_s).contains(&group.bytes_per_s));
        }
    }
}

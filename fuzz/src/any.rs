//! Feeds a link over several paths with frames of any content, on two paths: its memory stays bounded, and everything that it
//! sends can be decoded.
use std::time::{Duration, Instant};

use zenoh_link_any::{
    frame::{self, Frame},
    multipath::{Bounds, Multipath, Options, Violation},
    offer::{self, MAX_ADDRESSES},
    path::Medium,
};
use link_lanes::lanes::Lane;

const OPTIONS: Options = Options {
    is_encrypted: true,
    max_batch: 300,
    bounds: Bounds {
        bytes: 100_000,
        backlog: Duration::from_millis(500),
        droppable: Duration::from_millis(100),
    },
    lease: Duration::from_secs(10),
};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let mut now = Instant::now();
    let mut link = Multipath::new(OPTIONS, now);
    let mut paths = vec![
        link.add_path(Medium::Bluetooth, 100, true, now),
        link.add_path(Medium::Network, 1000, false, now),
    ];
    let (mut rest, mut frame) = (input, Vec::new());
    // Each step has a byte that selects the path and the time that passes, a length and a frame.
    while let [step, length, tail @ ..] = rest {
        let (received, tail) = tail.split_at(usize::from(*length).min(tail.len()));
        rest = tail;
        now += Duration::from_millis(u64::from(step >> 2) * 5);
        let index = usize::from(step & 1);
        let id = paths[index];
        let lane = Lane::new(step >> 5).expect("below 8");
        if step & 2 == 0 {
            link.push(lane, received, now);
        } else {
            if let Ok(Frame::Offer(body)) = frame::decode(received) {
                if let Ok(addresses) = offer::decode(body) {
                    assert!(addresses.len() <= MAX_ADDRESSES);
                }
            }
            match link.on_frame(id, received, now) {
                Ok(_) => {}
                // Ends the link.
                Err(Violation::Lane { .. }) => return,
                Err(Violation::Frame(_) | Violation::Ack(_)) => {
                    link.remove_path(id, now);
                    let medium = [Medium::Bluetooth, Medium::Network][index];
                    paths[index] = link.add_path(medium, 1000, false, now);
                }
            }
        }
        for id in &paths {
            while link
                .next_frame(*id, Lane::last(), &mut frame, now)
                .is_some()
            {
                assert!(frame::decode(&frame).is_ok(), "{frame:?}");
            }
        }
        if length % 3 == 0 {
            if let Some(batch) = link.take(lane, now) {
                assert!((1..=OPTIONS.max_batch).contains(&batch.len()));
            }
        }
    }
}

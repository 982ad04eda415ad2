//! Reads what routers and programs send about retained topics. A value that was read must be written to bytes that are read as the same
//! value, and a keeper that gets any orders and questions must neither panic nor keep more than its limit.
use std::time::{Duration, Instant};

use rect_core::{
    driver::{Driver, Event, Id, QueryId, Step},
    message::{encoding::Encoding, payload::Payload, retained::live::Live},
    name::{key::KeySpace, Name},
    state::{
        keeper::{Disk, StateKeeper},
        page::{read, Page},
    },
};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    if let Some(live) = Live::decode(input) {
        assert_eq!(Live::decode(&live.encode()), Some(live));
    }
    let _ = read::<Page>(input);
    let name = |text| Name::new(text).expect("a name");
    let place = KeySpace { fleet: name("rect"), robot: name("wombat-1") };
    let mut now = Instant::now();
    let disk = Disk::Saved(Some(input.to_vec()));
    let time_of_day = Box::new(|| 1_795_000_000_000);
    let mut keeper = StateKeeper::new(place, 1, disk, Box::new(|_| false), time_of_day, now);
    // The first byte of each part selects the queryable.
    for (number, part) in input.split(|byte| *byte == 0xFF).enumerate() {
        let Some((id, payload)) = part.split_first() else {
            continue;
        };
        let query = Event::Query {
            id: Id(u64::from(id % 4)),
            query: QueryId(number as u64),
            key: "rect/wombat-1/**".to_owned(),
            payload: Payload::new(payload.to_vec(), Encoding::CBOR),
            attachment: None,
        };
        let _ = keeper.on_event(now, query);
        now += Duration::from_millis(700);
        for _ in 0..1000 {
            match keeper.poll(now) {
                Step::Act(_) | Step::Deliver(_) => {}
                Step::Wait(_) | Step::Finished(()) => break,
            }
        }
    }
}

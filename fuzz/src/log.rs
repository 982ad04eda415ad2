//! Reads what others send about logs, and gives it to a router and to a reader. Lines that are kept and delivered have no
//! control characters, and stay within the limits.
use std::time::Instant;

use rect_core::{
    driver::{Driver, Event, Id, Sample, Step},
    log::{
        keeper::LogKeeper,
        page::{Page, Question},
        reader::{Item, LogReader, Reading},
    },
    message::{encoding::Encoding, payload::Payload},
    name::{key::KeySpace, Name},
};

pub fn run(bytes: &[u8]) {
    let (Ok(fleet), Ok(robot)) = (Name::new("rect"), Name::new("wombat-1")) else {
        return;
    };
    let place = KeySpace { fleet, robot };
    let now = Instant::now();
    let sample = |key: &str| Sample {
        key: key.to_owned(),
        payload: Payload::new(bytes.to_vec(), Encoding::JSON),
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    };
    let mut keeper = LogKeeper::new(place.clone(), 1);
    let given = sample("rect/wombat-1/@rect/@set/log/arm");
    let event = Event::Sample {
        id: Id(0),
        sample: given,
    };
    let _ = keeper.on_event(now, event);
    while let Step::Act(_) = keeper.poll(now) {}
    if let Ok(question) = Question::read(bytes) {
        assert_eq!(Question::read(&question.write().bytes), Ok(question));
    }
    let reading = Reading {
        follow: true,
        ..Reading::default()
    };
    let mut reader = LogReader::new(place, reading);
    while let Step::Act(_) = reader.poll(now) {}
    let key = "rect/wombat-1/@rect/@log/debug/arm";
    let reply = Ok(sample(key));
    let mut items = reader
        .on_event(now, Event::Reply { id: Id(2), reply })
        .items;
    let _ = reader.on_event(now, Event::Ended { id: Id(2) });
    let new = Event::Sample {
        id: Id(0),
        sample: sample(key),
    };
    items.extend(reader.on_event(now, new).items);
    for item in items {
        if let Item::Lines { lines, .. } = item {
            let texts = lines.iter().map(|kept| &kept.line.text);
            for text in texts {
                assert!(text.len() < 9000);
                assert!(!text
                    .chars()
                    .any(|c| c.is_control() && c != '\n' && c != '\t'));
            }
        }
    }
    if let Ok(page) = Page::read(bytes) {
        assert_eq!(Page::read(&page.write().bytes), Ok(page));
    }
}

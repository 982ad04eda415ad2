//! The router's answers about its robot's topics: `cargo test -p rect-router --test topics`
mod support;

use std::{
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;
use support::{answers, ask, ble, client, file, Air, Wombat, DEADLINE};
use zenoh::{bytes::Encoding, Session, Wait};

const ASKED: &str = "rect/wombat-1/@rect/topics";

/// The row of a topic in an answer.
fn row<'a>(answer: &'a Value, topic: &str) -> Option<&'a Value> {
    let mut topics = answer["topics"].as_array()?.iter();
    topics.find(|row| row[0] == topic)
}

/// Whether somebody subscribes to what the publisher publishes.
fn is_heard(publisher: &zenoh::pubsub::Publisher<'_>) -> bool {
    publisher
        .matching_status()
        .wait()
        .expect("known")
        .matching()
}

fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + DEADLINE;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// All bytes that a robot's router has sent over its links by radio.
fn sent_by_radio(session: &Session) -> u64 {
    let answer = ask(session, "rect/wombat-1/@rect/connections?method=ble").expect("an answer");
    let links = answer.as_array().into_iter().flatten();
    links
        .filter_map(|link| link["sent"]["bytes"].as_u64())
        .sum()
}

#[test]
fn topics_are_listed_and_measured_by_the_robots_own_router() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = Wombat::start(&air, &folder, 1, &file(&[]));
    let two = Wombat::start(&air, &folder, 2, &file(&[ble("first", "wombat-1")]));
    let (here, there) = (client(&one.endpoint), client(&two.endpoint));
    let linked = "rect/wombat-2/@rect/connections?name=first";
    answers(&there, linked, |answer| answer[0]["state"] == "connected");

    let publisher = here
        .declare_publisher("rect/wombat-1/arm/angle")
        .wait()
        .expect("declared");
    let listed = answers(&there, ASKED, |answer| row(answer, "arm/angle").is_some());
    let angle = row(&listed, "arm/angle").expect("listed");
    assert_eq!(
        (&listed["window_s"], &angle[1]),
        (&0.0.into(), &1.into()),
        "{listed}"
    );
    assert!(!is_heard(&publisher), "a list alone makes nobody publish");

    // 50 messages of 1 kB a second; a subscriber far away would take 50 kB a second over the air.
    let payload = vec![b'1'; 1000];
    let asked = format!("{ASKED}?measure");
    ask(&there, &asked).expect("an answer");
    wait_until("nobody counts", || is_heard(&publisher));
    let before = sent_by_radio(&here);
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        let put = publisher
            .put(payload.clone())
            .encoding(Encoding::APPLICATION_JSON);
        put.wait().expect("published");
        thread::sleep(Duration::from_millis(20));
    }
    let measured = ask(&there, &asked).expect("an answer");
    let sent = sent_by_radio(&here) - before;
    let angle = row(&measured, "arm/angle").expect("listed");
    assert!(angle[3].as_f64() > Some(5.0), "{measured}");
    assert_eq!(
        (&angle[2], &angle[5]),
        (&"application/json".into(), &1000.into()),
        "{measured}"
    );
    assert!(sent < 10_000, "{sent} bytes went over the air");

    wait_until("it counts without end", || !is_heard(&publisher));
    let wrong = ask(&there, &format!("{ASKED}?mesure")).expect_err("unknown");
    assert!(wrong.contains("`mesure`"), "{wrong}");
}

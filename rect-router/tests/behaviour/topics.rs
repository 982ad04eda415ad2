//! Tests of queries about the topics of a robot: `cargo test -p rect-router --test behaviour topics`
use std::{
    thread,
    time::{Duration, Instant},
};

use crate::support::{answers, ask, ble, client, file, Air, Wombat, DEADLINE};
use serde_json::Value;
use zenoh::{bytes::Encoding, Session, Wait};

const TOPICS_KEY: &str = "rect/wombat-1/@rect/topics";

/// Returns the row of a topic in a reply.
fn row<'a>(answer: &'a Value, topic: &str) -> Option<&'a Value> {
    let mut topics = answer["topics"].as_array()?.iter();
    topics.find(|row| row[0] == topic)
}

/// Returns whether the publisher has a subscriber.
fn has_subscriber(publisher: &zenoh::pubsub::Publisher<'_>) -> bool {
    publisher
        .matching_status()
        .wait()
        .expect("known")
        .matching()
}

fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + DEADLINE;
    while !condition() {
        assert!(Instant::now() < deadline, "{what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// Returns the number of bytes that wombat-1 has sent over its Bluetooth links.
fn sent_by_radio(session: &Session) -> u64 {
    let answer = ask(session, "rect/wombat-1/@rect/connections?method=ble").expect("an answer");
    let links = answer.as_array().into_iter().flatten();
    links
        .filter_map(|link| link["sent"]["bytes"].as_u64())
        .sum()
}

#[test]
fn the_robots_own_router_lists_and_measures_its_topics() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = Wombat::start(&air, &folder, 1, &file(&[]));
    let two = Wombat::start(&air, &folder, 2, &file(&[ble("first", "wombat-1")]));
    let (local, remote) = (client(&one.endpoint), client(&two.endpoint));
    let linked = "rect/wombat-2/@rect/connections?name=first";
    answers(&remote, linked, |answer| answer[0]["state"] == "connected");

    let publisher = local
        .declare_publisher("rect/wombat-1/arm/angle")
        .wait()
        .expect("declared");
    assert!(!has_subscriber(&publisher), "nobody has asked yet");

    // 50 messages of 1 kB per second. A remote subscriber would cause 50 kB/s over the air.
    let payload = vec![b'1'; 1000];
    let first = ask(&remote, TOPICS_KEY).expect("an answer");
    assert_eq!(first["window_s"], 0.0, "{first}");
    wait_until("no messages are counted", || has_subscriber(&publisher));
    let before = sent_by_radio(&local);
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(2) {
        let put = publisher
            .put(payload.clone())
            .encoding(Encoding::APPLICATION_JSON);
        put.wait().expect("published");
        thread::sleep(Duration::from_millis(20));
    }
    let measured = ask(&remote, TOPICS_KEY).expect("an answer");
    let sent = sent_by_radio(&local) - before;
    let angle = row(&measured, "arm/angle").expect("listed");
    assert!(angle[2].as_f64() > Some(5.0), "{measured}");
    assert_eq!(
        (&angle[1], &angle[4]),
        (&"application/json".into(), &1000.into()),
        "{measured}"
    );
    assert!(sent < 10_000, "{sent} bytes went over the air");

    wait_until("the counting does not end", || !has_subscriber(&publisher));
    let wrong = ask(&remote, &format!("{TOPICS_KEY}?topics=1")).expect_err("unknown");
    assert!(wrong.contains("`topics`"), "{wrong}");
}

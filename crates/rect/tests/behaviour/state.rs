//! Tests events, counters and the blocking API between two robots, linked directly over TCP in one process:
//! `cargo test -p rect-robot --test behaviour state`
use std::{sync::mpsc, thread, time::Duration};

use rect::{blocking, Event, Events, Json, Options, Payload};

use crate::pair::{dialling, free_endpoint, listening, pair, TIMEOUT};
use tokio::time::timeout;

/// Waits for an event that is expected, and skips all others.
async fn until(events: &Events, mut is_expected: impl FnMut(&Event) -> bool) {
    let found = async { while !is_expected(&events.next().await.expect("open")) {} };
    timeout(TIMEOUT, found).await.expect("event in time");
}

#[tokio::test(flavor = "multi_thread")]
async fn events_report_peers_and_links_that_come_up_and_go_down() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let events = a.events().await.expect("subscribed");
    let b = dialling("b", &endpoint).await;
    let (mut link, mut peer) = (false, false);
    until(&events, |event| {
        link |= matches!(event, Event::LinkUp(link) if link.method == "tcp");
        peer |= matches!(event, Event::PeerUp { robot } if *robot == "b");
        link && peer
    })
    .await;
    b.close().await.expect("closed");
    let (mut link, mut peer) = (false, false);
    until(&events, |event| {
        link |= matches!(event, Event::LinkDown(_));
        peer |= matches!(event, Event::PeerDown { robot } if *robot == "b");
        link && peer
    })
    .await;
    assert_eq!(a.peers().await.expect("asked"), [] as [rect::Name; 0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn event_callback_first_reports_robots_that_are_already_reachable() {
    let (a, _b) = pair("a", "b").await;
    let (sender, received) = mpsc::channel();
    let subscription = a.on_event(move |event| {
        let _ = sender.send(event);
    });
    let _subscription = subscription.await.expect("subscribed");
    let first = received.recv_timeout(TIMEOUT).expect("in time");
    assert!(matches!(first, Event::PeerUp { robot } if robot == "b"));
}

#[tokio::test(flavor = "multi_thread")]
async fn counters_count_sent_and_received_messages() {
    let (a, b) = pair("a", "b").await;
    let messages = b.subscribe::<Payload>("a/x").await.expect("subscribed");
    while messages.try_next().is_none() {
        a.publish("x", "12345").await.expect("published");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let (sent, received) = (a.counters(), b.counters());
    assert_eq!(sent.sent_bytes, 5 * sent.sent);
    assert!((1..=sent.sent).contains(&received.received), "{received:?}");
    assert_eq!(received.received_bytes, 5 * received.received);
    assert_eq!(received.missed, 0);
}

#[test]
fn blocking_api_publishes_requests_and_reports_events() {
    let endpoint = free_endpoint();
    let connect = |options: Options| blocking::Robot::connect(options.login_file("/none"));
    let a = connect(Options::new("a").expect("a name").listen(&endpoint)).expect("connected");
    let b = connect(Options::new("b").expect("a name").endpoint(&endpoint)).expect("connected");
    let events = b.events().expect("subscribed");
    let is_reported = events
        .into_iter()
        .any(|event| matches!(event, Event::PeerUp { robot } if robot == "a"));
    assert!(is_reported);
    assert_eq!(b.peers().expect("asked")[0], "a");

    let service = a.serve("double", |request| match request.payload.value::<f64>() {
        Ok(number) if number < 0.0 => panic!("on purpose"),
        Ok(number) => Ok(Json(number * 2.0)),
        Err(error) => Err(error.to_string()),
    });
    let _service = service.expect("served");
    let ask = |value: f64| loop {
        match b.request::<Payload>("a", "double", Json(value)) {
            Err(rect::Error::NoService { .. }) => thread::sleep(Duration::from_millis(5)),
            answer => break answer,
        }
    };
    assert_eq!(
        ask(4.0)
            .expect("a reply")
            .payload
            .value::<f64>()
            .expect("a number"),
        8.0
    );
    let panicked = ask(-1.0).expect_err("a panic is an error").to_string();
    assert!(panicked.contains("panicked"), "{panicked}");
    assert!(ask(1.0).is_ok(), "the service continues");

    let mut messages = b.subscribe::<Payload>("a/beat").expect("subscribed");
    let (stop, stopped) = mpsc::channel::<()>();
    let publishing = thread::spawn({
        let a = a.clone();
        move || {
            while stopped.recv_timeout(Duration::from_millis(5)).is_err() {
                a.publish("beat", Json(1)).expect("published");
            }
        }
    });
    assert_eq!(messages.next().expect("open").topic.as_str(), "beat");
    assert!(b.wait_for_message::<Payload>("a/beat", TIMEOUT).is_ok());
    stop.send(()).expect("the thread runs");
    publishing.join().expect("no panic");
    b.close().expect("closed");
    assert!(b.publish("x", "").is_err(), "closed");
}

//! Who can be reached, counters, and the blocking form; directly linked over TCP in one process.
//! `cargo test -p rect --test state`
mod pair;

use std::{sync::mpsc, thread, time::Duration};

use pair::{dialling, free_endpoint, listening, pair, PATIENCE};
use rect::{blocking, Event, Events, Json, Options};
use tokio::time::timeout;

async fn until(events: &Events, mut wanted: impl FnMut(&Event) -> bool) {
    let found = async { while !wanted(&events.next().await.expect("open")) {} };
    timeout(PATIENCE, found).await.expect("told in time");
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_and_links_that_come_and_go_are_told() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let events = a.events().await.expect("told");
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
async fn who_is_there_already_is_told_first_and_callbacks_are_called() {
    let (a, _b) = pair("a", "b").await;
    let (told, heard) = mpsc::channel();
    let subscription = a.on_state(move |event| {
        let _ = told.send(event);
    });
    let _subscription = subscription.await.expect("told");
    let first = heard.recv_timeout(PATIENCE).expect("in time");
    assert!(matches!(first, Event::PeerUp { robot } if robot == "b"));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_said_and_heard_is_counted() {
    let (a, b) = pair("a", "b").await;
    let heard = b.subscribe("a/x").await.expect("subscribed");
    while heard.try_recv().is_none() {
        a.publish("x", "12345").await.expect("said");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let (sent, received) = (a.counters(), b.counters());
    assert_eq!(sent.sent_bytes, 5 * sent.sent);
    assert!((1..=sent.sent).contains(&received.received), "{received:?}");
    assert_eq!(received.received_bytes, 5 * received.received);
    assert_eq!(received.missed, 0);
}

#[test]
fn the_blocking_form_does_the_same_without_async() {
    let endpoint = free_endpoint();
    let joined = |options: Options| blocking::Robot::join(options.login_file("/none"));
    let a = joined(Options::new("a").expect("a name").listen(&endpoint)).expect("joined");
    let b = joined(Options::new("b").expect("a name").endpoint(&endpoint)).expect("joined");
    let events = b.events().expect("told");
    let there = events
        .into_iter()
        .any(|event| matches!(event, Event::PeerUp { robot } if robot == "a"));
    assert!(there);
    assert_eq!(b.peers().expect("asked")[0], "a");

    let service = a.serve("double", |request| match request.payload.value::<f64>() {
        Ok(number) if number < 0.0 => panic!("on purpose"),
        Ok(number) => Ok(Json(number * 2.0)),
        Err(error) => Err(error.to_string()),
    });
    let _service = service.expect("served");
    let ask = |value: f64| loop {
        match b.request("a", "double", Json(value), PATIENCE) {
            Err(rect::Error::NoService { .. }) => thread::sleep(Duration::from_millis(5)),
            answer => break answer,
        }
    };
    assert_eq!(
        ask(4.0)
            .expect("answered")
            .payload
            .value::<f64>()
            .expect("a number"),
        8.0
    );
    let panicked = ask(-1.0).expect_err("a panic is an error").to_string();
    assert!(panicked.contains("panicked"), "{panicked}");
    assert!(ask(1.0).is_ok(), "it goes on");

    let mut messages = b.subscribe("a/beat").expect("subscribed");
    let (stop, stopped) = mpsc::channel::<()>();
    let saying = thread::spawn({
        let a = a.clone();
        move || {
            while stopped.recv_timeout(Duration::from_millis(5)).is_err() {
                a.publish("beat", Json(1)).expect("said");
            }
        }
    });
    assert_eq!(messages.next().expect("open").topic.as_str(), "beat");
    assert!(b.listen("a", "beat", PATIENCE).is_ok());
    stop.send(()).expect("it waits");
    saying.join().expect("no panic");
    b.close().expect("closed");
    assert!(b.publish("x", "").is_err(), "closed");
}

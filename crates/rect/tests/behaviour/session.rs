//! Tests publishing, sending and subscribing between two robots, linked directly over TCP in one process:
//! `cargo test -p rect-robot --test behaviour session`
use std::{
    sync::{
        atomic::{AtomicU32, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use rect::{Cbor, Error, Json, Payload, QueueOptions, Robot, SubscribeOptions, Urgency, WhenFull};

use crate::pair::{dialling, free_endpoint, listening, pair, TIMEOUT};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::time::timeout;

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Reading {
    angle_deg: f64,
    sensor: String,
}

fn reading() -> Reading {
    let sensor = "elbow".to_owned();
    Reading {
        angle_deg: 12.5,
        sensor,
    }
}

/// Publishes on `topic` until `is_received` returns true, since a new subscription takes a moment to reach the
/// publisher.
async fn until_received(
    robot: &Robot,
    topic: &'static str,
    mut is_received: impl FnMut() -> bool + Send,
) {
    let publishing = async {
        while !is_received() {
            robot.publish(topic, "first").await.expect("published");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(TIMEOUT, publishing)
        .await
        .expect("received in time");
}

#[tokio::test(flavor = "multi_thread")]
async fn published_values_keep_their_types_and_metadata() {
    let (a, b) = pair("a", "b").await;
    let values = b
        .subscribe::<Payload>("a/values/*")
        .await
        .expect("subscribed");
    until_received(&a, "values/first", || values.try_next().is_some()).await;
    a.publish("values/json", Json(reading()))
        .await
        .expect("published");
    a.publish("values/cbor", Cbor(reading()))
        .await
        .expect("published");
    a.publish("values/text", "hä?").await.expect("published");
    a.publish("values/bytes", [0u8, 255])
        .await
        .expect("published");
    a.publish("values/loose", json!({"a": null}))
        .await
        .expect("published");
    let next = async || loop {
        let message = timeout(TIMEOUT, values.next()).await.expect("in time");
        let message = message.expect("open");
        if message.topic.as_str() != "values/first" {
            break message;
        }
    };
    for topic in ["values/json", "values/cbor"] {
        let message = next().await;
        assert_eq!(message.topic.as_str(), topic);
        assert_eq!(
            message.payload.value::<Reading>().expect("a reading"),
            reading()
        );
        assert_eq!((message.sender.as_str(), message.recipient), ("a", None));
        assert_eq!((message.sequence, message.missed), (Some(0), 0));
        let age = message.sent_at.expect("known").elapsed();
        assert!(age.expect("in the past") < TIMEOUT);
    }
    assert_eq!(next().await.payload.text().expect("text"), "hä?");
    assert_eq!(&next().await.payload.bytes[..], [0, 255]);
    let loose: serde_json::Value = next().await.payload.value().expect("JSON");
    assert_eq!(loose, json!({"a": null}));
}

#[tokio::test(flavor = "multi_thread")]
async fn sent_message_is_delivered_once_and_to_the_recipient_only() {
    let (a, b) = pair("a", "b").await;
    let to_b = b.subscribe("a/**").await.expect("subscribed");
    let own = a.subscribe("a/**").await.expect("subscribed");
    until_received(&a, "ready", || to_b.try_next().is_some()).await;
    a.send("b", "grab", "now").await.expect("sent");
    a.publish("end", "").await.expect("published");
    let until_end = async |subscriber: &rect::Subscriber| {
        let mut received = Vec::new();
        loop {
            let message = timeout(TIMEOUT, subscriber.next()).await.expect("in time");
            let message = message.expect("open");
            match message.topic.as_str() {
                "end" => break received,
                "ready" => {}
                topic => {
                    received.push((topic.to_owned(), message.recipient.map(|to| to.to_string())))
                }
            }
        }
    };
    let once = [("grab".to_owned(), Some("b".to_owned()))];
    // Messages arrive in order, and once, although two subscriptions of Zenoh match the message.
    assert_eq!(until_end(&to_b).await, once);
    assert_eq!(until_end(&own).await, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn message_to_a_robot_that_is_not_reachable_is_an_error_until_it_is() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    a.send("a", "note", "to itself").await.expect("sent");
    let text = async || {
        let sent = a.send("bob", "note", "").await;
        sent.expect_err("not reachable").to_string()
    };
    assert_eq!(text().await, "bob is not reachable; reachable robots: none");
    let bobby = dialling("bobby", &endpoint).await;
    a.wait_for_peer("bobby", TIMEOUT).await.expect("linked");
    // The wait has a subscription of its own, which may have been served first.
    let expected = "bob is not reachable; did you mean bobby? (reachable robots: bobby)";
    while text().await != expected {
        tokio::task::yield_now().await;
    }
    a.send("bobby", "note", "").await.expect("sent");
    bobby.close().await.expect("closed");
    let deadline = Instant::now() + TIMEOUT;
    loop {
        match a.send("bobby", "note", "").await {
            Ok(()) if Instant::now() < deadline => {}
            Err(Error::NotReachable { robot, available }) => {
                assert_eq!((robot.as_str(), available), ("bobby", vec![]));
                break;
            }
            sent => panic!("{sent:?}"),
        }
    }
    let bobby = dialling("bobby", &endpoint).await;
    let notes = bobby.subscribe::<Payload>("a/note").await;
    let notes = notes.expect("subscribed");
    let arrived = timeout(TIMEOUT, async {
        while notes.try_next().is_none() {
            match a.urgent().send("bobby", "note", "").await {
                Ok(()) | Err(Error::NotReachable { .. }) => tokio::task::yield_now().await,
                Err(error) => panic!("{error}"),
            }
        }
    });
    arrived.await.expect("it arrives again");
    a.close().await.expect("closed");
    let closed = a.send("bobby", "note", "").await;
    assert!(matches!(closed, Err(Error::Closed)), "{closed:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn wait_for_message_returns_the_next_message_or_times_out() {
    let (a, b) = pair("a", "b").await;
    let none = b
        .wait_for_message::<Payload>("a/never", Duration::from_millis(50))
        .await;
    let none = none.expect_err("no message");
    assert!(matches!(none, Error::TimedOut { .. }), "{none}");
    let received = Arc::new(AtomicU32::new(0));
    let waiting = tokio::spawn({
        let received = received.clone();
        async move {
            let message = b.wait_for_message::<Payload>("a/arm/angle", TIMEOUT).await;
            received.store(1, Ordering::Release);
            (message, b)
        }
    });
    until_received(&a, "arm/angle", || received.load(Ordering::Acquire) == 1).await;
    let (message, _b) = waiting.await.expect("no panic");
    assert_eq!(message.expect("received").topic.as_str(), "arm/angle");
}

#[tokio::test(flavor = "multi_thread")]
async fn callback_is_called_again_after_a_panic() {
    let (a, b) = pair("a", "b").await;
    let calls = Arc::new(AtomicU32::new(0));
    let counted = calls.clone();
    let subscription = b
        .on_message::<Payload>("a/beat", move |_| {
            if counted.fetch_add(1, Ordering::AcqRel) == 0 {
                panic!("on purpose");
            }
        })
        .await
        .expect("subscribed");
    until_received(&a, "beat", || calls.load(Ordering::Acquire) >= 3).await;
    drop(subscription);
}

#[tokio::test(flavor = "multi_thread")]
async fn subscription_for_fewer_messages_skips_the_others_and_receives_the_last() {
    let (a, b) = pair("a", "b").await;
    let options = SubscribeOptions {
        max_hz: Some(20.0),
        ..SubscribeOptions::default()
    };
    let throttled = b.subscribe_with::<Payload>("a/n", options).await;
    let throttled = throttled.expect("subscribed");
    until_received(&a, "n", || throttled.try_next().is_some()).await;
    for n in 1..=200 {
        a.publish("n", Json(n)).await.expect("published");
    }
    let (mut received, mut skipped) = (0, 0);
    loop {
        let next = timeout(TIMEOUT, throttled.next()).await.expect("in time");
        let message = next.expect("open");
        (received, skipped) = (received + 1, skipped + message.skipped);
        assert_eq!(message.missed, 0);
        if message.payload.bytes == b"200"[..] {
            break;
        }
    }
    assert!(received < 100, "{received}");
    assert!(skipped > 100, "{skipped}");
    let options = SubscribeOptions {
        max_hz: Some(0.0),
        ..SubscribeOptions::default()
    };
    let refused = b.subscribe_with::<Payload>("a/n", options).await;
    let text = refused.err().map(|error| error.to_string());
    assert!(text.is_some_and(|text| text.contains("max_hz")));
}

#[tokio::test(flavor = "multi_thread")]
async fn full_queue_drops_by_its_rule_and_counts_drops() {
    let (a, b) = pair("a", "b").await;
    let queue = |when_full| QueueOptions {
        capacity: 4,
        when_full,
    };
    let newest = b
        .subscribe_with("a/n", queue(WhenFull::DropOldest))
        .await
        .expect("subscribed");
    let oldest = b
        .subscribe_with("a/n", queue(WhenFull::DropNewest))
        .await
        .expect("subscribed");
    let end = b.subscribe::<Payload>("a/end").await.expect("subscribed");
    until_received(&a, "end", || end.try_next().is_some()).await;
    while end.try_next().is_some() {}
    for n in 0..10 {
        a.publish("n", Json(n)).await.expect("published");
    }
    a.publish("end", "now").await.expect("published");
    loop {
        let message = timeout(TIMEOUT, end.next())
            .await
            .expect("in time")
            .expect("open");
        if message.payload.bytes == b"now"[..] {
            break;
        }
    }
    let all = |subscriber: &rect::Subscriber| {
        let left = std::iter::from_fn(|| subscriber.try_next());
        left.map(|message| message.payload.value().expect("a number"))
            .collect::<Vec<u32>>()
    };
    assert_eq!((all(&newest), newest.dropped()), (vec![6, 7, 8, 9], 6));
    assert_eq!((all(&oldest), oldest.dropped()), (vec![0, 1, 2, 3], 6));
    let (robot, counts) = &newest.counts_by_sender()[0];
    assert_eq!(
        (robot.as_str(), counts.received, counts.missed),
        ("a", 10, 0),
        "no message was lost in transit"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_keep_their_urgency() {
    let (a, b) = pair("a", "b").await;
    let messages = b.subscribe::<Payload>("a/u").await.expect("subscribed");
    until_received(&a, "u", || messages.try_next().is_some()).await;
    for urgency in [Urgency::Urgent, Urgency::Bulk] {
        a.with_urgency(urgency)
            .publish("u", "x")
            .await
            .expect("published");
        loop {
            let message = timeout(TIMEOUT, messages.next())
                .await
                .expect("in time")
                .expect("open");
            if message.payload.bytes == b"x"[..] {
                assert_eq!(message.urgency, urgency);
                break;
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn invalid_names_and_topics_are_rejected_with_the_reason() {
    let (a, _b) = pair("a", "b").await;
    for (topic, reason) in [
        ("", "1 to"),
        ("a/*", "wildcard"),
        ("to/b", "\"to\""),
        ("@rect/x", "@rect"),
    ] {
        let error = a.publish(topic, "").await.expect_err(topic).to_string();
        assert!(error.contains(reason), "{error}");
    }
    let error = a.send("no robot", "x", "").await.expect_err("a space");
    assert!(matches!(error, Error::Name(_)), "{error}");
    let error = a
        .subscribe::<Payload>("x")
        .await
        .expect_err("no robot in it");
    assert!(error.to_string().contains("<robot>/<topic>"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_router_error_explains_how_to_start_one() {
    let options = rect::Options::new("a").expect("a name");
    let options = options
        .router("tcp/127.0.0.1:1")
        .timeout(Duration::from_millis(100));
    let error = options.connect().await.expect_err("no router");
    let text = error.to_string();
    assert!(matches!(error, Error::NoRouter { .. }), "{text}");
    assert!(
        text.contains("tcp/127.0.0.1:1") && text.contains("rect-router"),
        "{text}"
    );
    let wrong = rect::Options::new("a").expect("a name").router("nonsense");
    let error = wrong.connect().await.expect_err("no locator").to_string();
    assert!(error.contains("nonsense"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn close_ends_pending_reads() {
    let (a, b) = pair("a", "b").await;
    let messages = a.subscribe::<Payload>("b/**").await.expect("subscribed");
    let requests = a.requests("echo").await.expect("served");
    let events = a.events().await.expect("subscribed");
    let frames = a.watch("b/camera").await.expect("watched");
    let waiting = async {
        while events.next().await.is_some() {}
        (
            messages.next().await.is_none(),
            requests.next().await.is_none(),
            frames.next().await.is_none(),
        )
    };
    let (ended, closed) = tokio::join!(timeout(TIMEOUT, waiting), a.close());
    closed.expect("closed");
    assert_eq!(ended.expect("in time"), (true, true, true));
    b.close().await.expect("closed");
}

#[tokio::test(flavor = "multi_thread")]
async fn too_long_encoding_is_rejected_before_sending() {
    let (a, b) = pair("a", "b").await;
    let too_long = || rect::Payload::new("1", rect::Encoding::new("x".repeat(201)));
    let longest = rect::Payload::new("1", rect::Encoding::new("x".repeat(200)));
    let messages = b.subscribe::<Payload>("a/x").await.expect("subscribed");
    let _service = b.serve("long", move |_| async move { Ok::<_, String>(too_long()) });
    let _service = _service.await.expect("served");
    until_received(&a, "x", || messages.try_next().is_some()).await;
    let published = a.publish("x", too_long()).await;
    let sent = a.send("b", "x", too_long()).await;
    let asked = a
        .request::<Payload>("b", "long", too_long())
        .await
        .map(drop);
    let transferred = a
        .transfer("b", "x", too_long())
        .expect("valid arguments")
        .await;
    for refused in [published, sent, asked, transferred] {
        let text = refused.expect_err("too long").to_string();
        assert!(
            text.contains("is 201 bytes long, but an encoding has at most 200"),
            "{text}"
        );
    }
    // The requester receives the reason why the reply was rejected, rather than `NoService`.
    let error = a
        .request::<Payload>("b", "long", "")
        .await
        .expect_err("an error");
    assert!(matches!(error, Error::Service { .. }), "{error}");
    a.publish("x", longest.clone()).await.expect("published");
    loop {
        let message = timeout(TIMEOUT, messages.next()).await.expect("in time");
        let message = message.expect("open");
        if message.payload == longest {
            break;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_with_invalid_topics_are_dropped_and_counted() {
    let (a, b) = pair("a", "b").await;
    let messages = b.subscribe::<Payload>("a/**").await.expect("subscribed");
    until_received(&a, "ready", || messages.try_next().is_some()).await;
    let key = "rect/a/a\u{1b}]0;pwned\u{7}\u{1b}[2Jb\nfake/c";
    a.zenoh().put(key, "12.5").await.expect("put");
    a.publish("end", "").await.expect("published");
    loop {
        let message = timeout(TIMEOUT, messages.next()).await.expect("in time");
        match message.expect("open").topic.as_str() {
            "ready" => {}
            topic => break assert_eq!(topic, "end"),
        }
    }
    assert_eq!(b.counters().rejected, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn panic_of_a_service_is_an_error_reply() {
    let (a, b) = pair("a", "b").await;
    let panics = |request: Arc<rect::Request>| async move {
        assert!(!request.payload.bytes.starts_with(b"panic"), "on purpose");
        Ok::<_, String>("well")
    };
    let _service = b.serve("panics", panics).await.expect("served");
    let discovered = async { while a.request::<Payload>("b", "panics", "").await.is_err() {} };
    timeout(TIMEOUT, discovered).await.expect("served in time");
    let error = a.request::<Payload>("b", "panics", "panic").await;
    let error = error.map(drop).expect_err("an error").to_string();
    assert!(error.contains("the service's function panicked"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_arrive_once_the_subscription_is_established() {
    let (a, b) = pair("a", "b").await;
    for number in 0..20 {
        let topic = format!("first/{number}");
        let messages = b.subscribe::<Payload>(format!("a/{topic}").as_str()).await;
        let messages = messages.expect("subscribed");
        b.wait_until_established(TIMEOUT).await.expect("in time");
        a.publish(topic.as_str(), "").await.expect("published");
        let first = timeout(TIMEOUT, messages.next()).await.expect("in time");
        assert_eq!(first.expect("open").topic.as_str(), topic);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn publisher_waits_for_the_first_subscriber() {
    let (a, b) = pair("a", "b").await;
    // A subscriber of the same program does not count.
    let _own = a.subscribe::<Payload>("*/first").await.expect("subscribed");
    let publisher = a.publisher::<Payload>("first").await.expect("declared");
    let early = publisher.wait_for_subscriber(Duration::ZERO).await;
    let error = early.expect_err("nobody subscribes").to_string();
    assert!(error.contains("no subscriber of first within"), "{error}");
    assert!(!publisher.has_subscribers());
    let messages = b.subscribe::<Payload>("a/first").await.expect("subscribed");
    let found = publisher.wait_for_subscriber(TIMEOUT).await;
    found.expect("a subscriber");
    publisher.publish("hello").await.expect("published");
    let message = timeout(TIMEOUT, messages.next()).await.expect("in time");
    let message = message.expect("open");
    assert_eq!(message.payload.text().expect("text"), "hello");
    a.close().await.expect("closed");
    let closed = publisher.wait_for_subscriber(TIMEOUT).await;
    assert!(a.is_closed() && (closed.is_ok() || matches!(closed, Err(rect::Error::Closed))));
}

#[tokio::test(flavor = "multi_thread")]
async fn wait_for_peer_ends_when_the_robot_is_reachable() {
    let endpoint = crate::pair::free_endpoint();
    let a = crate::pair::listening("a", &endpoint).await;
    let early = a.wait_for_peer("b", Duration::from_millis(10)).await;
    let error = early.expect_err("not there").to_string();
    assert!(
        error.contains("no connection with b (reachable robots: none) within"),
        "{error}"
    );
    let (waited, b) = tokio::join!(
        a.wait_for_peer("b", TIMEOUT),
        crate::pair::dialling("b", &endpoint)
    );
    waited.expect("reachable");
    b.wait_for_peer("a", TIMEOUT).await.expect("reachable");
}

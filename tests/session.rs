//! Two programs of two robots, directly linked over TCP in one process: what the library's words do.
//! `cargo test -p rect --test session`
mod pair;

use std::{
    sync::{
        atomic::{AtomicU32, Ordering},
        Arc,
    },
    time::Duration,
};

use pair::{pair, PATIENCE};
use rect::{Cbor, Error, Json, Receiving, Robot, Urgency, WhenFull};
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

/// Says it until `heard` has been heard: a subscription takes a moment to be known at the other side.
async fn until_heard(robot: &Robot, topic: &'static str, mut heard: impl FnMut() -> bool + Send) {
    let saying = async {
        while !heard() {
            robot.publish(topic, "are you there?").await.expect("said");
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(PATIENCE, saying).await.expect("heard in time");
}

#[tokio::test(flavor = "multi_thread")]
async fn values_of_every_kind_arrive_as_what_they_are() {
    let (a, b) = pair("a", "b").await;
    let values = b.subscribe("a/values/*").await.expect("subscribed");
    until_heard(&a, "values/first", || values.try_recv().is_some()).await;
    a.publish("values/json", Json(reading()))
        .await
        .expect("said");
    a.publish("values/cbor", Cbor(reading()))
        .await
        .expect("said");
    a.publish("values/text", "hä?").await.expect("said");
    a.publish("values/bytes", [0u8, 255]).await.expect("said");
    a.publish("values/loose", json!({"a": null}))
        .await
        .expect("said");
    let next = async || loop {
        let message = timeout(PATIENCE, values.recv()).await.expect("in time");
        let message = message.expect("open");
        if message.topic.as_str() != "values/first" {
            break message;
        }
    };
    for topic in ["values/json", "values/cbor"] {
        let message = next().await;
        assert_eq!(message.topic.as_str(), topic);
        assert_eq!(message.payload.value::<Reading>().expect("one"), reading());
        assert_eq!((message.from.as_str(), message.to), ("a", None));
        assert_eq!((message.sequence, message.missed), (Some(0), 0));
        let sent_ms = message.sent_ms.expect("known");
        assert!(sent_ms > 1_700_000_000_000, "{sent_ms}");
    }
    assert_eq!(next().await.payload.text().expect("text"), "hä?");
    assert_eq!(&next().await.payload.bytes[..], [0, 255]);
    let loose: serde_json::Value = next().await.payload.value().expect("JSON");
    assert_eq!(loose, json!({"a": null}));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_sent_to_one_is_heard_by_that_one_alone() {
    let (a, b) = pair("a", "b").await;
    let to_b = b.subscribe("a/**").await.expect("subscribed");
    let own = a.subscribe("a/**").await.expect("subscribed");
    until_heard(&a, "ready", || to_b.try_recv().is_some()).await;
    a.send("b", "grab", "now").await.expect("sent");
    a.publish("end", "").await.expect("said");
    let until_end = async |subscriber: &rect::Subscriber| {
        let mut heard = Vec::new();
        loop {
            let message = timeout(PATIENCE, subscriber.recv()).await.expect("in time");
            let message = message.expect("open");
            match message.topic.as_str() {
                "end" => break heard,
                "ready" => {}
                topic => heard.push((topic.to_owned(), message.to.map(|to| to.to_string()))),
            }
        }
    };
    let once = [("grab".to_owned(), Some("b".to_owned()))];
    // The order of two topics is kept; once, though two subscriptions of Zenoh's match it.
    assert_eq!(until_end(&to_b).await, once);
    assert_eq!(until_end(&own).await, []);
}

#[tokio::test(flavor = "multi_thread")]
async fn listen_gives_the_next_message_or_says_that_there_was_none() {
    let (a, b) = pair("a", "b").await;
    let none = b.listen("a", "never", Duration::from_millis(50)).await;
    let none = none.expect_err("nothing is said");
    assert!(matches!(none, Error::TimedOut { .. }), "{none}");
    let heard = Arc::new(AtomicU32::new(0));
    let listening = tokio::spawn({
        let heard = heard.clone();
        async move {
            let message = b.listen("a", "arm/angle", PATIENCE).await;
            heard.store(1, Ordering::Release);
            (message, b)
        }
    });
    until_heard(&a, "arm/angle", || heard.load(Ordering::Acquire) == 1).await;
    let (message, _b) = listening.await.expect("no panic");
    assert_eq!(message.expect("heard").topic.as_str(), "arm/angle");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_callback_that_panics_is_called_for_the_next_message() {
    let (a, b) = pair("a", "b").await;
    let calls = Arc::new(AtomicU32::new(0));
    let counted = calls.clone();
    let subscription = b
        .on_message("a/beat", move |_| {
            if counted.fetch_add(1, Ordering::AcqRel) == 0 {
                panic!("on purpose");
            }
        })
        .await
        .expect("subscribed");
    until_heard(&a, "beat", || calls.load(Ordering::Acquire) >= 3).await;
    drop(subscription);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_drops_what_it_was_told_to_and_counts_it() {
    let (a, b) = pair("a", "b").await;
    let receiving = |when_full| Receiving {
        capacity: 4,
        when_full,
    };
    let newest = b
        .subscribe_with("a/n", receiving(WhenFull::NewestWins))
        .await
        .expect("subscribed");
    let oldest = b
        .subscribe_with("a/n", receiving(WhenFull::OldestWins))
        .await
        .expect("subscribed");
    let end = b.subscribe("a/end").await.expect("subscribed");
    until_heard(&a, "end", || end.try_recv().is_some()).await;
    while end.try_recv().is_some() {}
    for n in 0..10 {
        a.publish("n", Json(n)).await.expect("said");
    }
    a.publish("end", "now").await.expect("said");
    loop {
        let message = timeout(PATIENCE, end.recv())
            .await
            .expect("in time")
            .expect("open");
        if message.payload.bytes == b"now"[..] {
            break;
        }
    }
    let all = |subscriber: &rect::Subscriber| {
        let left = std::iter::from_fn(|| subscriber.try_recv());
        left.map(|message| message.payload.value().expect("a number"))
            .collect::<Vec<u32>>()
    };
    assert_eq!((all(&newest), newest.dropped()), (vec![6, 7, 8, 9], 6));
    assert_eq!((all(&oldest), oldest.dropped()), (vec![0, 1, 2, 3], 6));
    let (robot, tally) = &newest.tallies()[0];
    assert_eq!(
        (robot.as_str(), tally.received, tally.missed),
        ("a", 10, 0),
        "none was lost on the way"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn urgency_arrives_as_it_was_meant() {
    let (a, b) = pair("a", "b").await;
    let heard = b.subscribe("a/u").await.expect("subscribed");
    until_heard(&a, "u", || heard.try_recv().is_some()).await;
    for urgency in [Urgency::Urgent, Urgency::Bulk] {
        a.with(urgency).publish("u", "x").await.expect("said");
        loop {
            let message = timeout(PATIENCE, heard.recv())
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
async fn bad_names_and_topics_are_refused_with_what_is_wrong() {
    let (a, _b) = pair("a", "b").await;
    for (topic, named) in [
        ("", "1 to"),
        ("a/*", "wildcard"),
        ("to/b", "\"to\""),
        ("@rect/x", "@rect"),
    ] {
        let error = a.publish(topic, "").await.expect_err(topic).to_string();
        assert!(error.contains(named), "{error}");
    }
    let error = a.send("no robot", "x", "").await.expect_err("a space");
    assert!(matches!(error, Error::Name(_)), "{error}");
    let error = a.subscribe("x").await.expect_err("no robot in it");
    assert!(error.to_string().contains("<robot>/<topic>"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_a_router_the_error_says_how_to_start_one() {
    let nobody = rect::Options::new("a").expect("a name");
    let nobody = nobody
        .router("tcp/127.0.0.1:1")
        .patience(Duration::from_millis(100));
    let error = nobody.connect().await.expect_err("nobody listens there");
    let said = error.to_string();
    assert!(matches!(error, Error::NoRouter { .. }), "{said}");
    assert!(
        said.contains("tcp/127.0.0.1:1") && said.contains("rect-router"),
        "{said}"
    );
    let wrong = rect::Options::new("a").expect("a name").router("nonsense");
    let error = wrong.connect().await.expect_err("no locator").to_string();
    assert!(error.contains("nonsense"), "{error}");
}

#[tokio::test(flavor = "multi_thread")]
async fn closing_ends_whatever_waits() {
    let (a, b) = pair("a", "b").await;
    let messages = a.subscribe("b/**").await.expect("subscribed");
    let requests = a.requests("echo").await.expect("served");
    let events = a.events().await.expect("told");
    let frames = a.watch("b", "camera").await.expect("watched");
    let waiting = async {
        while events.next().await.is_some() {}
        (
            messages.recv().await.is_none(),
            requests.next().await.is_none(),
            frames.recv().await.is_none(),
        )
    };
    let (ended, closed) = tokio::join!(timeout(PATIENCE, waiting), a.close());
    closed.expect("closed");
    assert_eq!(ended.expect("in time"), (true, true, true));
    b.close().await.expect("closed");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_encoding_that_is_too_long_is_rejected_before_it_is_sent() {
    let (a, b) = pair("a", "b").await;
    let too_long = || rect::Payload::new("1", rect::Encoding::new("x".repeat(201)));
    let longest = rect::Payload::new("1", rect::Encoding::new("x".repeat(200)));
    let heard = b.subscribe("a/x").await.expect("subscribed");
    let _service = b.serve("long", move |_| async move { Ok::<_, String>(too_long()) });
    let _service = _service.await.expect("served");
    until_heard(&a, "x", || heard.try_recv().is_some()).await;
    let published = a.publish("x", too_long()).await;
    let sent = a.send("b", "x", too_long()).await;
    let asked = a.request("b", "long", too_long(), PATIENCE).await.map(drop);
    let transferred = a.transfer("b", "x", too_long()).expect("named").await;
    for refused in [published, sent, asked, transferred] {
        let text = refused.expect_err("too long").to_string();
        assert!(
            text.contains("is 201 bytes long, and an encoding has at most 200"),
            "{text}"
        );
    }
    // The requester is told what is wrong with the answer, and not that nobody serves.
    let error = a
        .request("b", "long", "", PATIENCE)
        .await
        .expect_err("an error");
    assert!(matches!(error, Error::Service { .. }), "{error}");
    a.publish("x", longest.clone()).await.expect("published");
    loop {
        let message = timeout(PATIENCE, heard.recv()).await.expect("in time");
        let message = message.expect("open");
        if message.payload == longest {
            break;
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_of_another_program_with_an_invalid_topic_is_dropped_and_counted() {
    let (a, b) = pair("a", "b").await;
    let heard = b.subscribe("a/**").await.expect("subscribed");
    until_heard(&a, "ready", || heard.try_recv().is_some()).await;
    let key = "rect/a/a\u{1b}]0;pwned\u{7}\u{1b}[2Jb\nfake/c";
    a.zenoh().put(key, "12.5").await.expect("put");
    a.publish("end", "").await.expect("published");
    loop {
        let message = timeout(PATIENCE, heard.recv()).await.expect("in time");
        match message.expect("open").topic.as_str() {
            "ready" => {}
            topic => break assert_eq!(topic, "end"),
        }
    }
    assert_eq!(b.counters().rejected, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_panics_answers_with_an_error() {
    let (a, b) = pair("a", "b").await;
    let panics = |request: Arc<rect::Request>| async move {
        assert!(!request.payload.bytes.starts_with(b"panic"), "on purpose");
        Ok::<_, String>("well")
    };
    let _service = b.serve("panics", panics).await.expect("served");
    let known = async { while a.request("b", "panics", "", PATIENCE).await.is_err() {} };
    timeout(PATIENCE, known).await.expect("served in time");
    let error = a.request("b", "panics", "panic", PATIENCE).await;
    let error = error.map(drop).expect_err("an error").to_string();
    assert!(error.contains("the service's function panicked"), "{error}");
}

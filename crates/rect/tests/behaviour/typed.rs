//! Tests values that arrive as the type that a program states.
use futures_util::StreamExt;
use rect::{Error, Json, Mismatch, Payload, PayloadError};
use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::pair::{pair, TIMEOUT};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Battery {
    percent: f64,
    #[serde(default)]
    cells: Vec<f64>,
}

const BATTERY: Battery = Battery {
    percent: 83.0,
    cells: Vec::new(),
};

#[tokio::test(flavor = "multi_thread")]
async fn values_arrive_as_their_type_and_others_with_a_problem() {
    let (a, b) = pair("a", "b").await;
    let batteries = b
        .subscribe::<Battery>("a/battery")
        .await
        .expect("subscribed");
    let publisher = a.publisher::<Battery>("battery").await.expect("declared");
    publisher
        .wait_for_subscriber(TIMEOUT)
        .await
        .expect("subscribed");
    publisher.publish(&BATTERY).await.expect("published");
    publisher.publish(BATTERY).await.expect("published");
    // A sender that changes its type, fields that the type does not have, and those that it has by default.
    for value in [
        json!({"percent": "full"}),
        json!({"percent": 83, "note": "new"}),
        json!(true),
        json!({}),
    ] {
        a.publish("battery", value).await.expect("published");
    }
    a.publish("battery", vec![1, 2, 3])
        .await
        .expect("published");

    let next = async || batteries.next().await.expect("a message");
    assert_eq!(next().await.value, Ok(BATTERY));
    assert_eq!(next().await.value, Ok(BATTERY));
    let message = next().await;
    let expected = Mismatch {
        field: "percent".to_owned(),
        expected: "a number".to_owned(),
        found: "the text 'full'".to_owned(),
    };
    assert_eq!(message.problem(), Some(&PayloadError::Type(expected)));
    assert_eq!(message.payload.text(), Ok(r#"{"percent":"full"}"#));
    assert_eq!(next().await.value, Ok(BATTERY));
    let bool = next().await.value.expect_err("no object").to_string();
    assert_eq!(bool, "expected an object, found true");
    let nothing = next().await.value.expect_err("no fields").to_string();
    assert_eq!(
        nothing,
        "field percent: expected a value, found no such field"
    );
    let bytes = next().await.value.expect_err("bytes");
    assert!(matches!(bytes, PayloadError::Mismatch { .. }), "{bytes}");
    assert_eq!(b.counters().problems, 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn callbacks_and_waits_have_types_too() {
    let (a, b) = pair("a", "b").await;
    let (sender, mut received) = tokio::sync::mpsc::unbounded_channel();
    let _subscription = b
        .on_message::<Battery>("a/battery", move |message| {
            let _ = sender.send(message.value);
        })
        .await
        .expect("subscribed");
    let waiting = tokio::spawn({
        let b = b.clone();
        async move { b.wait_for_message::<String>("a/text", TIMEOUT).await }
    });
    let arrived = async {
        loop {
            a.publish("battery", Json(&BATTERY))
                .await
                .expect("published");
            a.publish("text", "hello").await.expect("published");
            if waiting.is_finished() && !received.is_empty() {
                return;
            }
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(TIMEOUT, arrived)
        .await
        .expect("they arrive");
    assert_eq!(received.recv().await, Some(Ok(BATTERY)));
    let message = waiting.await.expect("no panic").expect("a message");
    assert_eq!(message.value.as_deref(), Ok("hello"));
}

#[tokio::test(flavor = "multi_thread")]
async fn replies_have_the_requested_type_or_the_request_fails() {
    let (a, b) = pair("a", "b").await;
    let _service = a
        .serve("battery", |request| async move {
            let cell: usize = request.payload.value().map_err(|error| error.to_string())?;
            match cell {
                1 => Ok::<_, String>(json!(BATTERY)),
                _ => Ok(json!({"percent": null})),
            }
        })
        .await
        .expect("served");
    let asked = |cell: serde_json::Value| b.request::<Battery>("a", "battery", cell);
    let first = async {
        loop {
            match asked(json!(1)).await {
                Err(Error::NoService { .. }) => tokio::task::yield_now().await,
                reply => return reply.expect("a reply"),
            }
        }
    };
    let reply = tokio::time::timeout(TIMEOUT, first).await.expect("served");
    assert_eq!((reply.sender.as_str(), reply.value), ("a", BATTERY));
    let error = asked(json!(2)).await.expect_err("no battery").to_string();
    assert_eq!(
        error,
        "field percent: expected a number, found nothing (null)"
    );
    let error = asked(json!("two")).await.expect_err("no cell").to_string();
    let expected = "a replied with an error: expected an integer from 0, found the text 'two'";
    assert_eq!(error, expected);
    let replies = b
        .request_all::<Battery>("battery", json!(1))
        .await
        .expect("asked");
    let replies: Vec<_> = replies
        .map(|reply| reply.expect("a battery").value)
        .collect()
        .await;
    assert_eq!(replies, [BATTERY]);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_receiver_is_a_stream() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("double").await.expect("served");
    let answering = tokio::spawn(async move {
        while let Some(request) = requests.next().await {
            let number: f64 = request.payload.value().expect("a number");
            request.reply(Json(2.0 * number)).expect("replied");
        }
    });
    let mut frames = b.watch("a/angle").await.expect("watched");
    let stream = a
        .stream("angle", rect::StreamOptions::fixed(10.0))
        .await
        .expect("declared");
    let frame = async {
        loop {
            stream.send(Json(12.5)).expect("sent");
            tokio::select! {
                frame = StreamExt::next(&mut frames) => return frame.expect("a frame"),
                () = tokio::time::sleep(std::time::Duration::from_millis(20)) => {}
            }
        }
    };
    let frame = tokio::time::timeout(TIMEOUT, frame).await.expect("a frame");
    assert_eq!(frame.payload.value(), Ok(12.5));
    let mut events = b.events().await.expect("observed");
    assert!(StreamExt::next(&mut events).await.is_some());
    let mut transfers = b
        .receive_transfers("a/file", rect::ReceiveOptions::in_memory(1000))
        .await
        .expect("received");
    let sent = a.transfer("b", "file", Payload::new("content", rect::Encoding::TEXT));
    let (sent, received) = tokio::join!(sent.expect("valid"), StreamExt::next(&mut transfers));
    sent.expect("sent");
    let received = received.expect("a transfer").expect("complete");
    assert_eq!(received.topic.as_str(), "file");
    let doubled = b
        .request::<f64>("a", "double", Json(4))
        .await
        .expect("a reply");
    assert_eq!(doubled.value, 8.0);
    a.close().await.expect("closed");
    answering.await.expect("no panic");
}

//! Tests codecs and dictionaries between two robots, linked directly over TCP in one process:
//! `cargo test -p rect-robot --test behaviour codec`
use std::{
    future::{poll_fn, Future},
    pin::pin,
    sync::Arc,
    task::Poll,
    time::Duration,
};

use rect::{Encoding, Json, Message, Payload, PayloadError, Robot, Subscriber};
use rect_core::codec::{
    array::Array,
    dictionary::Dictionary,
    parse,
    picture::{Format, Picture},
    CodecError, Limits,
};

use crate::pair::{pair, TIMEOUT};
use serde_json::{json, Value};

fn reading(n: u32) -> Value {
    json!({
        "robot": "wombat-1", "sensor": "elbow", "time_ms": 1_795_000_000_000u64 + u64::from(n) * 50,
        "angle_deg": f64::from(n % 900) / 10.0, "current_ma": 120 + n % 37, "moving": n % 3 == 0,
    })
}

/// Publishes `payload` on `x` until `subscriber` receives a message.
async fn delivered(robot: &Robot, subscriber: &Subscriber, payload: &Payload) -> Message {
    let delivery = async {
        loop {
            robot.publish("x", payload).await.expect("published");
            let interval = Duration::from_millis(20);
            if let Ok(message) = tokio::time::timeout(interval, subscriber.next()).await {
                break message.expect("open");
            }
        }
    };
    tokio::time::timeout(TIMEOUT, delivery)
        .await
        .expect("received in time")
}

#[tokio::test(flavor = "multi_thread")]
async fn encoded_payloads_are_decoded_by_the_receiver() {
    let (a, b) = pair("a", "b").await;
    let subscriber = b.subscribe("a/x").await.expect("subscribed");
    let all = Payload::new(
        json!((0..50).map(reading).collect::<Vec<_>>()).to_string(),
        Encoding::JSON,
    );
    let encoded = a.with_codec(parse("zstd:9").expect("a codec"));
    let message = delivered(&encoded, &subscriber, &all).await;
    assert_eq!((&message.payload, message.problem()), (&all, None));
    let (sent, received) = (a.counters(), b.counters());
    let message_bytes = sent.sent_bytes / sent.sent;
    assert!(
        message_bytes * 3 < all.bytes.len() as u64,
        "{message_bytes} bytes on the wire"
    );
    assert_eq!(received.received_bytes, message_bytes * received.received);
}

#[tokio::test(flavor = "multi_thread")]
async fn receiver_fetches_an_unknown_dictionary_from_the_sender() {
    let (a, b) = pair("a", "b").await;
    let samples: Vec<String> = (0..2000).map(|n| reading(n).to_string()).collect();
    let dictionary = Arc::new(Dictionary::train(&samples, 4096).expect("trained"));
    let encoded = a.with_dictionary(dictionary).expect("shared");
    let subscriber = b
        .subscribe::<rect::Payload>("a/x")
        .await
        .expect("subscribed");
    let new = reading(5000);
    let payload = Payload::new(new.to_string(), Encoding::JSON);
    let delivery = async {
        loop {
            encoded.publish("x", &payload).await.expect("published");
            let interval = Duration::from_millis(200);
            if let Ok(message) = tokio::time::timeout(interval, subscriber.next()).await {
                break message.expect("open");
            }
        }
    };
    let message = tokio::time::timeout(TIMEOUT, delivery)
        .await
        .expect("received");
    assert_eq!(message.problem(), None);
    assert_eq!(message.payload.value::<Value>().expect("JSON"), new);
    let sent = a.counters();
    assert!(
        sent.sent_bytes < sent.sent * payload.bytes.len() as u64 / 2,
        "{sent:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn pictures_and_arrays_can_be_read_by_the_receiver() {
    let (a, b) = pair("a", "b").await;
    let subscriber = b.subscribe("a/x").await.expect("subscribed");
    let pixels: Vec<u8> = (0..64 * 48 * 3u32).map(|n| (n / 64) as u8).collect();
    let picture = Picture::new(64, 48, Format::Rgb8, pixels).expect("a picture");
    let raw = rect::ToPayload::to_payload(&picture).expect("a payload");
    let jpeg = parse("jpeg:70")
        .expect("a codec")
        .encode(&raw)
        .expect("encoded");
    let message = delivered(&a, &subscriber, &jpeg).await;
    assert_eq!(
        message.payload.encoding,
        Encoding::JPEG,
        "readable by any tool"
    );
    let shown = message
        .payload
        .picture(&Limits::default())
        .expect("a picture");
    assert_eq!((shown.width(), shown.height()), (64, 48));
    let array = Array::of(&[2, 3], &[1.0f32, 2.0, 3.0, 4.0, 5.0, 6.0]).expect("an array");
    let raw = rect::ToPayload::to_payload(&array).expect("a payload");
    let message = delivered(&a, &subscriber, &raw).await;
    let array = message.payload.array(&Limits::default()).expect("an array");
    assert_eq!(array.shape(), [2, 3]);
    assert_eq!(array.numbers::<f32>().expect("of type f32")[5], 6.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn undecodable_payload_is_delivered_unchanged_with_the_error() {
    let (a, b) = pair("a", "b").await;
    let subscriber = b.subscribe("a/x").await.expect("subscribed");
    let damaged = Payload::new("no zstd", Encoding::JSON.with_suffix("zstd"));
    let message = delivered(&a, &subscriber, &damaged).await;
    assert_eq!(message.payload, damaged);
    assert!(
        matches!(
            message.problem(),
            Some(PayloadError::Codec(CodecError::Damaged { .. }))
        ),
        "{:?}",
        message.problem()
    );
    let unknown = Payload::new(
        "\u{1}",
        Encoding::new("application/x-unknown;unknown-suffix"),
    );
    let message = delivered(&a, &subscriber, &unknown).await;
    assert_eq!(
        (&message.payload, message.problem()),
        (&unknown, None),
        "unknown encodings are left to the program"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_and_replies_are_decoded() {
    let (a, b) = pair("a", "b").await;
    let _service = a
        .serve("echo", |request| async move {
            let value: Value = request.payload.value().map_err(|error| error.to_string())?;
            Ok::<_, String>(Json(value))
        })
        .await
        .expect("served");
    let encoded = b.with_codec(parse("zstd").expect("a codec"));
    let asked = async {
        loop {
            match encoded.request::<Payload>("a", "echo", reading(1)).await {
                Err(rect::Error::NoService { .. }) => {}
                answer => break answer,
            }
        }
    };
    let reply = asked.await.expect("a reply");
    assert_eq!(reply.payload.value::<Value>().expect("JSON"), reading(1));
    let damaged = Payload::new("no zstd", Encoding::JSON.with_suffix("zstd"));
    let error = b
        .request::<Payload>("a", "echo", damaged)
        .await
        .expect_err("damaged");
    assert!(error.to_string().contains("zstd"), "{error}");
}

/// Returns another dictionary with the same id: the same bytes and a suffix, which takes 32768 attempts on average to
/// find.
fn with_the_same_id(dictionary: &Dictionary) -> Dictionary {
    // The checksum does not include the magic number and the id.
    let mut prefix_hash = crc32fast::Hasher::new();
    prefix_hash.update(&dictionary.as_bytes()[8..]);
    let is_same = |suffix: &u32| {
        let mut hash = prefix_hash.clone();
        hash.update(&suffix.to_le_bytes());
        32768 + hash.finalize() % 32768 == dictionary.id()
    };
    let suffix = (0..).find(is_same).expect("one of 32768 on average");
    let bytes = [dictionary.as_bytes(), &suffix.to_le_bytes()].concat();
    Dictionary::new(bytes).expect("a dictionary")
}

#[tokio::test(flavor = "multi_thread")]
async fn dictionary_of_one_robot_does_not_decode_messages_of_another() {
    let endpoint = crate::pair::free_endpoint();
    let b = crate::pair::listening("b", &endpoint).await;
    let honest = crate::pair::dialling("honest", &endpoint).await;
    let other = crate::pair::dialling("other", &endpoint).await;
    let samples: Vec<String> = (0..2000).map(|n| reading(n).to_string()).collect();
    let dictionary = Dictionary::train(&samples, 4096).expect("trained");
    let same_id = with_the_same_id(&dictionary);
    assert_eq!(same_id.id(), dictionary.id());
    let subscriber = b.subscribe("*/x").await.expect("subscribed");
    let payload = Payload::new(reading(5000).to_string(), Encoding::JSON);
    for (robot, dictionary) in [(other, same_id), (honest, dictionary)] {
        let encoded = robot.with_dictionary(Arc::new(dictionary)).expect("shared");
        let mut message = delivered(&encoded, &subscriber, &payload).await;
        while message.sender != *robot.name() || message.problem().is_some() {
            assert_eq!(message.problem(), None, "{}", message.sender);
            message = delivered(&encoded, &subscriber, &payload).await;
        }
        assert_eq!(message.payload, payload, "{}", message.sender);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn message_is_kept_if_the_future_is_dropped_while_its_dictionary_is_fetched() {
    let (a, b) = pair("a", "b").await;
    let samples: Vec<String> = (0..2000).map(|n| reading(n).to_string()).collect();
    let dictionary = Arc::new(Dictionary::train(&samples, 4096).expect("trained"));
    let encoded = a.with_dictionary(dictionary).expect("shared");
    let subscriber = b
        .subscribe::<rect::Payload>("a/x")
        .await
        .expect("subscribed");
    let publisher = encoded
        .publisher::<rect::Payload>("x")
        .await
        .expect("declared");
    let subscribed = publisher.wait_for_subscriber(TIMEOUT).await;
    subscribed.expect("established");
    for n in 0..2u32 {
        publisher.publish(reading(n)).await.expect("published");
    }
    while b.counters().received < 2 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    // The future takes the message, asks for the dictionary, and is dropped. The dictionary may be there already at the
    // second or third poll, which then returns the message.
    let mut messages = Vec::new();
    for _ in 0..3 {
        let polled = poll_fn(|context| Poll::Ready(pin!(subscriber.next()).poll(context))).await;
        if let Poll::Ready(message) = polled {
            messages.push(message.expect("open"));
        }
    }
    while messages.len() < 2 {
        let message = tokio::time::timeout(TIMEOUT, subscriber.next()).await;
        messages.push(message.expect("not lost").expect("open"));
    }
    for (n, message) in messages.into_iter().enumerate() {
        assert_eq!(message.problem(), None);
        assert_eq!(
            message.payload.value::<Value>().expect("JSON"),
            reading(n as u32)
        );
    }
}

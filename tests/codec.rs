//! What a sender packs arrives as it was; directly linked over TCP in one process.
//! `cargo test -p rect --test codec`
mod pair;

use std::{sync::Arc, time::Duration};

use pair::{pair, PATIENCE};
use rect::{
    core::{
        array::Array,
        codec::{parse, CodecError, Limits},
        dictionary::Dictionary,
        picture::{Format, Picture},
    },
    Encoding, Json, Message, Payload, Robot, Subscriber,
};
use serde_json::{json, Value};

fn reading(n: u32) -> Value {
    json!({
        "robot": "wombat-1", "sensor": "elbow", "time_ms": 1_795_000_000_000u64 + u64::from(n) * 50,
        "angle_deg": f64::from(n % 900) / 10.0, "current_ma": 120 + n % 37, "moving": n % 3 == 0,
    })
}

/// Says it until the other has heard it.
async fn heard(robot: &Robot, subscriber: &Subscriber, payload: &Payload) -> Message {
    let said = async {
        loop {
            robot.publish("x", payload).await.expect("said");
            let soon = Duration::from_millis(20);
            if let Ok(message) = tokio::time::timeout(soon, subscriber.recv()).await {
                break message.expect("open");
            }
        }
    };
    tokio::time::timeout(PATIENCE, said)
        .await
        .expect("heard in time")
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_packed_arrives_as_it_was() {
    let (a, b) = pair("a", "b").await;
    let heard_at_b = b.subscribe("a/x").await.expect("subscribed");
    let all = Payload::new(
        json!((0..50).map(reading).collect::<Vec<_>>()).to_string(),
        Encoding::JSON,
    );
    let packed = a.encoded(parse("zstd:9").expect("a codec"));
    let message = heard(&packed, &heard_at_b, &all).await;
    assert_eq!((message.payload, message.flaw), (all.clone(), None));
    let (sent, received) = (a.counters(), b.counters());
    let each = sent.sent_bytes / sent.sent;
    assert!(
        each * 3 < all.bytes.len() as u64,
        "{each} bytes on the wire"
    );
    assert_eq!(received.received_bytes, each * received.received);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dictionary_is_fetched_from_who_made_it() {
    let (a, b) = pair("a", "b").await;
    let samples: Vec<String> = (0..2000).map(|n| reading(n).to_string()).collect();
    let dictionary = Arc::new(Dictionary::train(&samples, 4096).expect("trained"));
    let packed = a.packed_with(dictionary).expect("shared");
    let heard_at_b = b.subscribe("a/x").await.expect("subscribed");
    let new = reading(5000);
    let payload = Payload::new(new.to_string(), Encoding::JSON);
    let said = async {
        loop {
            packed.publish("x", &payload).await.expect("said");
            let soon = Duration::from_millis(200);
            if let Ok(message) = tokio::time::timeout(soon, heard_at_b.recv()).await {
                break message.expect("open");
            }
        }
    };
    let message = tokio::time::timeout(PATIENCE, said).await.expect("heard");
    assert_eq!(message.flaw, None);
    assert_eq!(message.payload.value::<Value>().expect("JSON"), new);
    let sent = a.counters();
    assert!(
        sent.sent_bytes < sent.sent * payload.bytes.len() as u64 / 2,
        "{sent:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn pictures_and_arrays_arrive_as_such() {
    let (a, b) = pair("a", "b").await;
    let heard_at_b = b.subscribe("a/x").await.expect("subscribed");
    let pixels: Vec<u8> = (0..64 * 48 * 3u32).map(|n| (n / 64) as u8).collect();
    let picture = Picture::new(64, 48, Format::Rgb8, pixels).expect("a picture");
    let raw = rect::ToPayload::to_payload(&picture).expect("a payload");
    let jpeg = parse("jpeg:70")
        .expect("a codec")
        .encode(&raw)
        .expect("encoded");
    let message = heard(&a, &heard_at_b, &jpeg).await;
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
    let message = heard(&a, &heard_at_b, &raw).await;
    let array = message.payload.array(&Limits::default()).expect("an array");
    assert_eq!(array.shape(), [2, 3]);
    assert_eq!(array.numbers::<f32>().expect("of that kind")[5], 6.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_unpacked_arrives_as_it_came_with_the_reason() {
    let (a, b) = pair("a", "b").await;
    let heard_at_b = b.subscribe("a/x").await.expect("subscribed");
    let damaged = Payload::new("no zstd", Encoding::JSON.packed("zstd"));
    let message = heard(&a, &heard_at_b, &damaged).await;
    assert_eq!(message.payload, damaged);
    assert!(
        matches!(message.flaw, Some(CodecError::Damaged { .. })),
        "{:?}",
        message.flaw
    );
    let unknown = Payload::new(
        "\u{1}",
        Encoding::new("application/x-of-tomorrow;packed-somehow"),
    );
    let message = heard(&a, &heard_at_b, &unknown).await;
    assert_eq!(
        (message.payload, message.flaw),
        (unknown, None),
        "unknown ones are the program's"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_and_answers_are_unpacked_too() {
    let (a, b) = pair("a", "b").await;
    let _service = a
        .serve("echo", |request| async move {
            let value: Value = request.payload.value().map_err(|error| error.to_string())?;
            Ok::<_, String>(Json(value))
        })
        .await
        .expect("served");
    let packed = b.encoded(parse("zstd").expect("a codec"));
    let asked = async {
        loop {
            match packed.request("a", "echo", reading(1), PATIENCE).await {
                Err(rect::Error::NoService { .. }) => {}
                answer => break answer,
            }
        }
    };
    let reply = asked.await.expect("answered");
    assert_eq!(reply.payload.value::<Value>().expect("JSON"), reading(1));
    let damaged = Payload::new("no zstd", Encoding::JSON.packed("zstd"));
    let error = b
        .request("a", "echo", damaged, PATIENCE)
        .await
        .expect_err("damaged");
    assert!(error.to_string().contains("zstd"), "{error}");
}

/// Another dictionary with the same id, which takes some ten thousand tries.
fn with_the_same_id(dictionary: &Dictionary) -> Dictionary {
    // The magic number and the id are not part of it.
    let mut begun = crc32fast::Hasher::new();
    begun.update(&dictionary.as_bytes()[8..]);
    let is_same = |suffix: &u32| {
        let mut hash = begun.clone();
        hash.update(&suffix.to_le_bytes());
        32768 + hash.finalize() % 32768 == dictionary.id()
    };
    let suffix = (0..).find(is_same).expect("one of 32768 on average");
    let bytes = [dictionary.as_bytes(), &suffix.to_le_bytes()].concat();
    Dictionary::new(bytes).expect("a dictionary")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dictionary_of_one_robot_is_not_used_for_anothers_messages() {
    let endpoint = pair::free_endpoint();
    let b = pair::listening("b", &endpoint).await;
    let honest = pair::dialling("honest", &endpoint).await;
    let other = pair::dialling("other", &endpoint).await;
    let samples: Vec<String> = (0..2000).map(|n| reading(n).to_string()).collect();
    let dictionary = Dictionary::train(&samples, 4096).expect("trained");
    let same_id = with_the_same_id(&dictionary);
    assert_eq!(same_id.id(), dictionary.id());
    let heard_at_b = b.subscribe("*/x").await.expect("subscribed");
    let payload = Payload::new(reading(5000).to_string(), Encoding::JSON);
    for (robot, dictionary) in [(other, same_id), (honest, dictionary)] {
        let packed = robot.packed_with(Arc::new(dictionary)).expect("shared");
        let mut message = heard(&packed, &heard_at_b, &payload).await;
        while message.from != *robot.name() || message.flaw.is_some() {
            assert_eq!(message.flaw, None, "{}", message.from);
            message = heard(&packed, &heard_at_b, &payload).await;
        }
        assert_eq!(message.payload, payload, "{}", message.from);
    }
}

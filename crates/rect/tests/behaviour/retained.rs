//! Tests state that stays, between robots that are linked directly: `cargo test -p rect-robot --test behaviour retained`
use std::{collections::BTreeMap, time::Duration};

use rect::{Error, Json, Message, Payload, Subscriber};
use tokio::time::timeout;
use zenoh::Wait;

use crate::pair::{dialling, free_endpoint, listening, pair, stock_client, TIMEOUT};

async fn next(messages: &Subscriber<String>) -> Message<String> {
    let next = timeout(TIMEOUT, messages.next()).await;
    next.expect("a message in time").expect("open")
}

fn value(message: &Message<String>) -> &str {
    message.value.as_ref().expect("a value")
}

#[tokio::test(flavor = "multi_thread")]
async fn subscription_that_begins_late_receives_the_last_value_and_each_change_once() {
    let (a, b) = pair("a", "b").await;
    let modes = a.retained();
    modes.publish("mode", Json("auto")).await.expect("kept");
    modes.publish("mode", Json("manual")).await.expect("kept");
    tokio::time::sleep(Duration::from_millis(100)).await;
    let messages = b.subscribe::<String>("a/mode").await.expect("subscribed");
    let first = next(&messages).await;
    assert_eq!(value(&first), "manual");
    let retained = first.retained.expect("it is retained");
    assert!(retained.age >= Duration::from_millis(100) && retained.age < TIMEOUT);
    assert!(!retained.is_forgotten && !retained.has_ended);
    for value in ["auto", "stop", "auto"] {
        modes.publish("mode", Json(value)).await.expect("kept");
        let message = next(&messages).await;
        assert_eq!(self::value(&message), value);
        assert!(message.retained.is_some() && message.sent_at.is_some());
    }
    a.forget("mode").await.expect("forgotten");
    let last = next(&messages).await;
    assert!(last.retained.expect("it is retained").is_forgotten);
    assert_eq!(
        last.problem().expect("no value").to_string(),
        "the topic was forgotten: there is no value any more"
    );
    a.forget("mode").await.expect("nothing to forget");
    modes.publish("mode", Json("again")).await.expect("kept");
    assert_eq!(value(&next(&messages).await), "again");
    assert!(messages.try_next().is_none(), "nothing twice");
}

#[tokio::test(flavor = "multi_thread")]
async fn all_subscriptions_of_a_robot_receive_all_topics_that_they_select() {
    let (a, b) = pair("a", "b").await;
    for n in 0..50 {
        let topic = format!("arm/{n}");
        a.retained()
            .publish(topic.as_str(), Json(n))
            .await
            .expect("kept");
    }
    b.retained()
        .publish("arm/own", Json(50))
        .await
        .expect("kept");
    for _ in 0..2 {
        let messages = b.subscribe::<u32>("*/arm/*").await.expect("subscribed");
        let mut values = BTreeMap::new();
        while values.len() < 51 {
            let message = timeout(TIMEOUT, messages.next()).await.expect("in time");
            let message = message.expect("open");
            let topic = (message.sender.to_string(), message.topic.to_string());
            let before = values.insert(topic, message.value.expect("a value"));
            assert_eq!(before, None, "once");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn last_value_is_known_without_a_subscription() {
    let (a, b) = pair("a", "b").await;
    assert!(b
        .latest::<String>("a", "mode")
        .await
        .expect("asked")
        .is_none());
    a.retained()
        .publish("mode", Json("auto"))
        .await
        .expect("kept");
    for robot in [&a, &b] {
        let latest = robot.latest::<String>("a", "mode").await.expect("asked");
        assert_eq!(value(&latest.expect("a value")), "auto");
    }
    assert!(b
        .latest::<String>("c", "mode")
        .await
        .expect("asked")
        .is_none());
    let wrong = b.latest::<u32>("a", "mode").await.expect("asked");
    assert!(wrong.expect("a value").value.is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn values_beyond_the_limits_are_published_and_not_kept() {
    let (a, b) = pair("a", "b").await;
    let messages = b.subscribe::<Payload>("a/map").await.expect("subscribed");
    let limit = 64 << 10;
    let maps = a.retained();
    maps.publish("map", vec![1; limit]).await.expect("kept");
    let received = || async {
        timeout(TIMEOUT, messages.next())
            .await
            .expect("in time")
            .expect("open")
    };
    assert_eq!(received().await.payload.bytes.len(), limit);
    let refused = maps.publish("map", vec![1; limit + 1]).await;
    let Err(Error::NotRetained { topic, reason }) = refused else {
        panic!("{refused:?}");
    };
    assert_eq!(topic, "map");
    assert!(
        reason.starts_with("the value has 65537 bytes, and at most 65536 are kept"),
        "{reason}"
    );
    let message = received().await;
    assert_eq!(
        (message.payload.bytes.len(), message.retained),
        (limit + 1, None)
    );
    let mut refusals = 0;
    for n in 0..10 {
        let topic = format!("map/{n}");
        refusals += usize::from(
            maps.publish(topic.as_str(), vec![1; limit / 2])
                .await
                .is_err(),
        );
    }
    assert!((2..=7).contains(&refusals), "{refusals}");
}

#[tokio::test(flavor = "multi_thread")]
async fn stock_zenoh_gets_the_last_value_and_sees_that_it_is_forgotten() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let stock = stock_client(&endpoint);
    let samples = stock
        .declare_subscriber("rect/a/mode")
        .wait()
        .expect("subscribed");
    tokio::time::sleep(Duration::from_millis(300)).await;
    let get = || {
        let replies = stock.get("rect/a/mode").wait().expect("asked");
        let replies = replies
            .into_iter()
            .filter_map(|reply| reply.into_result().ok());
        let replies: Vec<_> = replies.collect();
        replies
    };
    assert!(get().is_empty());
    a.retained()
        .publish("mode", Json("auto"))
        .await
        .expect("kept");
    tokio::time::sleep(Duration::from_millis(300)).await;
    let replies = get();
    assert_eq!(replies.len(), 1);
    assert_eq!(replies[0].payload().to_bytes(), &b"\"auto\""[..]);
    let live = samples
        .recv_timeout(TIMEOUT)
        .expect("no error")
        .expect("a sample");
    // zenoh-ext tells old values from new ones by it.
    let source = |sample: &zenoh::sample::Sample| {
        let source = sample.source_info().expect("source information");
        (*source.source_id(), source.source_sn())
    };
    assert_eq!(source(&live), source(&replies[0]));
    a.forget("mode").await.expect("forgotten");
    let gone = samples
        .recv_timeout(TIMEOUT)
        .expect("no error")
        .expect("a sample");
    assert_eq!(gone.kind(), zenoh::sample::SampleKind::Delete);
    assert!(get().is_empty());
    // A request is not answered with state.
    let b = dialling("b", &endpoint).await;
    a.retained()
        .publish("mode", Json("auto"))
        .await
        .expect("kept");
    b.wait_for_peer("a", TIMEOUT).await.expect("linked");
    let refused = b.request::<Payload>("a", "mode", "").await;
    assert!(
        matches!(refused, Err(Error::NoService { .. })),
        "{refused:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn change_during_a_cut_arrives_after_it() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let b = dialling("b", &endpoint).await;
    a.retained()
        .publish("mode", Json("auto"))
        .await
        .expect("kept");
    let messages = b.subscribe::<String>("a/mode").await.expect("subscribed");
    assert_eq!(value(&next(&messages).await), "auto");
    a.close().await.expect("closed");
    let a = listening("a", &endpoint).await;
    a.retained()
        .publish("mode", Json("stop"))
        .await
        .expect("kept");
    assert_eq!(value(&next(&messages).await), "stop");
}

//! Tests requests that are repeated, between two robots in one process whose link is cut:
//! `cargo test -p rect-robot --test behaviour retry`
use std::{
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
    time::Duration,
};

use rect::{Error, Json, Payload, Robot};
use tokio::sync::Notify;
use zenoh::Wait;

use crate::{
    pair::{dialling, free_endpoint, listening, pair, stock_client, TIMEOUT},
    wire::Wire,
};

/// The rate of the link, in bytes per second: no limit.
const RATE: f64 = 1e9;
const CUT: Duration = Duration::from_millis(500);

/// Waits until one robot has discovered the service of another.
async fn until_served(robot: &Robot, server: &str, topic: &str) {
    let served = async {
        loop {
            let programs = robot.programs(server).await.unwrap_or_default();
            let mut services = programs.iter().flat_map(|program| &program.services);
            if services.any(|service| service.topic.as_str() == topic) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(TIMEOUT, served)
        .await
        .expect("served in time");
}

/// Sends a request that is repeated, on a task.
fn asking(
    robot: &Robot,
    topic: &'static str,
) -> tokio::task::JoinHandle<Result<rect::Reply, Error>> {
    let robot = robot.retrying().with_timeout(TIMEOUT);
    tokio::spawn(async move { robot.request::<Payload>("a", topic, "").await })
}

#[tokio::test(flavor = "multi_thread")]
async fn retried_request_is_carried_out_once_although_the_link_is_cut() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let wire = Wire::to(&endpoint, RATE);
    let b = dialling("b", &wire.endpoint).await;
    let (count, began, go) = (
        Arc::new(AtomicUsize::new(0)),
        Arc::new(Notify::new()),
        Arc::new(Notify::new()),
    );
    let handler = (count.clone(), began.clone(), go.clone());
    let _service = a
        .serve("grab", move |_| {
            let (count, began, go) = handler.clone();
            async move {
                let number = count.fetch_add(1, Ordering::SeqCst) + 1;
                began.notify_one();
                go.notified().await;
                Ok::<_, String>(Json(number))
            }
        })
        .await
        .expect("served");
    until_served(&b, "a", "grab").await;
    // The reply is lost, because it is sent while the link is cut; or a repetition waits for it.
    for (expected, replies_during_cut) in [(1, true), (2, false)] {
        let asked = asking(&b, "grab");
        began.notified().await;
        let reply = || go.notify_one();
        if replies_during_cut {
            tokio::join!(wire.cut(CUT), async { reply() });
        } else {
            wire.cut(CUT).await;
            until_served(&b, "a", "grab").await;
            reply();
        }
        let reply = asked.await.expect("no panic").expect("a reply");
        assert_eq!(reply.payload.value::<usize>().expect("a number"), expected);
    }
    assert_eq!(count.load(Ordering::SeqCst), 2);
}

#[tokio::test(flavor = "multi_thread")]
async fn retried_request_is_not_carried_out_by_a_program_that_was_restarted() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let b = dialling("b", &endpoint).await;
    let requests = a.requests("grab").await.expect("served");
    until_served(&b, "a", "grab").await;
    let asked = asking(&b, "grab");
    let received = requests.next().await.expect("asked");
    a.close().await.expect("closed");
    drop((received, requests, a));
    let again = listening("a", &endpoint).await;
    let requests = again.requests("grab").await.expect("served");
    let error = asked.await.expect("no panic").expect_err("no reply");
    assert!(matches!(error, Error::Interrupted { .. }), "{error}");
    // A new one is.
    let asked = asking(&b, "grab");
    let received = requests.next().await.expect("asked");
    received.reply("done").expect("replied");
    assert_eq!(asked.await.expect("no panic").expect("a reply").sender, "a");
}

#[tokio::test(flavor = "multi_thread")]
async fn retried_request_that_ends_without_a_reply_is_interrupted_and_an_error_is_repeated() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("grab").await.expect("served");
    until_served(&b, "a", "grab").await;
    let asked = asking(&b, "grab");
    drop(requests.next().await.expect("asked"));
    let error = asked.await.expect("no panic").expect_err("no reply");
    assert!(matches!(error, Error::Interrupted { .. }), "{error}");
    let asked = asking(&b, "grab");
    let received = requests.next().await.expect("asked");
    received.refuse("it is stuck").expect("refused");
    let error = asked.await.expect("no panic").expect_err("an error");
    assert!(
        matches!(&error, Error::Service { robot: Some(_), .. }),
        "{error}"
    );
    assert!(error.to_string().contains("it is stuck"), "{error}");
    let too_long = b.retrying().with_timeout(Duration::from_secs(601));
    let error = too_long.request::<Payload>("a", "grab", "").await;
    assert!(matches!(
        error,
        Err(Error::Option {
            option: "timeout",
            ..
        })
    ));
}

#[tokio::test(flavor = "multi_thread")]
async fn service_of_stock_zenoh_is_asked_once() {
    let endpoint = free_endpoint();
    let b = listening("b", &endpoint).await;
    let stock = stock_client(&endpoint);
    let _declared = stock
        .declare_queryable("rect/s/grab")
        .complete(true)
        .callback(|query| {
            // The test finds out if this fails.
            let _ = query.reply("rect/s/grab", "done").wait();
        })
        .wait()
        .expect("declared");
    let asked = async {
        loop {
            match b.retrying().request::<Payload>("s", "grab", "").await {
                Err(Error::NoService { .. }) => {}
                reply => return reply,
            }
        }
    };
    let reply = tokio::time::timeout(TIMEOUT, asked).await.expect("in time");
    assert_eq!(reply.expect("a reply").payload.bytes, "done");
}

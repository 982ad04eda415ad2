//! Requests and services between two robots' programs, directly linked over TCP in one process.
//! `cargo test -p rect --test request`
mod pair;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use pair::{dialling, pair, PATIENCE};
use rect::{Error, Json, Robot, Service};
use zenoh::Wait;

async fn doubling(robot: &Robot) -> Service {
    let served = robot.serve("double", |request| async move {
        let number: f64 = request.payload.value().map_err(|error| error.to_string())?;
        Ok::<_, String>(Json(number * 2.0))
    });
    served.await.expect("served")
}

/// Asks until the service is known here.
async fn asked(robot: &Robot, of: &str, topic: &str, value: f64) -> Result<rect::Reply, Error> {
    let deadline = Instant::now() + PATIENCE;
    loop {
        match robot.request(of, topic, Json(value), PATIENCE).await {
            Err(Error::NoService { .. }) if Instant::now() < deadline => {}
            answer => return answer,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_answers_who_asks_and_says_who_it_is() {
    let (a, b) = pair("a", "b").await;
    let _service = doubling(&a).await;
    let reply = asked(&b, "a", "double", 21.0).await.expect("answered");
    assert_eq!(reply.from, "a");
    assert_eq!(reply.payload.value::<f64>().expect("a number"), 42.0);
    // Its own robot's programs can ask, too.
    let own = asked(&a, "a", "double", 1.0).await.expect("answered");
    assert_eq!(own.payload.value::<f64>().expect("a number"), 2.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_arrives_as_an_error() {
    let (a, b) = pair("a", "b").await;
    let _service = doubling(&a).await;
    asked(&b, "a", "double", 1.0).await.expect("known by now");
    let error = b.request("a", "double", "no number", PATIENCE).await;
    let error = error.expect_err("text is no number");
    let Error::Service { robot, payload } = &error else {
        panic!("{error}");
    };
    assert_eq!(robot.as_ref().expect("named"), &"a");
    assert!(
        payload.text().expect("text").contains("text/plain"),
        "{error}"
    );
    assert!(
        error.to_string().starts_with("a answers with an error"),
        "{error}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_nobody_serves_is_said_with_who_is_there() {
    let (a, b) = pair("a", "b").await;
    let error = b
        .request("a", "nothing", "", PATIENCE)
        .await
        .expect_err("nobody");
    assert!(matches!(error, Error::NoService { .. }), "{error}");
    assert!(error.to_string().contains("robots there: a"), "{error}");
    drop(a);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_knows_who_asks_and_how_long_an_answer_is_of_use() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("slow").await.expect("served");
    let asking = tokio::spawn({
        let b = b.clone();
        async move {
            let _known = asked(&b, "a", "slow", 0.0).await;
            let timeout = Duration::from_millis(300);
            b.request("a", "slow", "", timeout).await
        }
    });
    let first = requests.next().await.expect("asked");
    assert_eq!(first.from.as_ref().expect("known"), &"b");
    assert!(first.remaining() > PATIENCE / 2, "{:?}", first.remaining());
    first.reply("yes").expect("answered");
    drop(first);
    let second = requests.next().await.expect("asked");
    assert!(second.remaining() <= Duration::from_millis(300));
    let error = asking.await.expect("no panic").expect_err("no answer");
    assert!(matches!(error, Error::TimedOut { .. }), "{error}");
    drop(second);
}

#[tokio::test(flavor = "multi_thread")]
async fn all_that_serve_answer_and_each_may_answer_more_than_once() {
    let endpoint = pair::free_endpoint();
    let a = pair::listening("a", &endpoint).await;
    let b = dialling("b", &endpoint).await;
    let c = dialling("c", &endpoint).await;
    let mut services = Vec::new();
    for robot in [&a, &b] {
        let served = robot.serve("count", |request| async move {
            request.reply("one").map_err(|error| error.to_string())?;
            Ok::<_, String>("two")
        });
        services.push(served.await.expect("served"));
    }
    let deadline = Instant::now() + PATIENCE;
    loop {
        let mut replies = a.request_all("count", "", PATIENCE).await.expect("asked");
        let mut heard = Vec::new();
        while let Some(reply) = replies.next().await {
            let reply = reply.expect("no error");
            heard.push(format!(
                "{} {}",
                reply.from,
                reply.payload.text().expect("text")
            ));
        }
        heard.sort();
        if heard == ["a one", "a two", "b one", "b two"] {
            break;
        }
        assert!(Instant::now() < deadline, "{heard:?}");
    }
    drop(c);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_is_dropped_is_over_at_once() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("never").await.expect("served");
    let taken = Arc::new(AtomicBool::new(false));
    let serving = tokio::spawn({
        let taken = taken.clone();
        async move {
            let mut kept = Vec::new();
            while let Some(request) = requests.next().await {
                taken.store(true, Ordering::Release);
                kept.push(request);
            }
        }
    });
    let began = Instant::now();
    while !taken.load(Ordering::Acquire) {
        let patience = Duration::from_millis(100);
        let asked = b.request("a", "never", "", Duration::from_secs(3600));
        let _ = tokio::time::timeout(patience, asked).await;
        assert!(began.elapsed() < PATIENCE);
    }
    let closing = Instant::now();
    b.close().await.expect("closed");
    assert!(closing.elapsed() < PATIENCE, "nothing waits for an hour");
    serving.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn an_error_is_of_the_robot_that_was_asked_whatever_name_it_has() {
    let (a, b) = pair("a", "b").await;
    let service = a.zenoh().declare_queryable("rect/a/arm");
    let service = service.callback(|query| {
        let error = query
            .reply_err("stuck")
            .encoding("text/plain;from=wombat-9");
        error.wait().expect("replied");
    });
    let _service = service.wait().expect("declared");
    let error = asked(&b, "a", "arm", 1.0).await.expect_err("an error");
    match error {
        Error::Service { robot, .. } => assert_eq!(robot.expect("a name"), "a"),
        other => panic!("{other}"),
    }
}

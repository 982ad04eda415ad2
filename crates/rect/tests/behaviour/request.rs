//! Tests requests and services between two robots, linked directly over TCP in one process:
//! `cargo test -p rect-robot --test behaviour request`
use std::{
    sync::{
        atomic::{AtomicBool, AtomicUsize, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use rect::{Error, Json, Payload, Robot, Service};

use crate::pair::{dialling, pair, TIMEOUT};
use zenoh::Wait;

/// Serves `double`, which returns twice the number of the request.
async fn doubling(robot: &Robot) -> Service {
    let served = robot.serve("double", |request| async move {
        let number: f64 = request.payload.value().map_err(|error| error.to_string())?;
        Ok::<_, String>(Json(number * 2.0))
    });
    served.await.expect("served")
}

/// Repeats a request to `server` until the service is discovered, and returns its result.
async fn asked(robot: &Robot, server: &str, topic: &str, value: f64) -> Result<rect::Reply, Error> {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        match robot.request::<Payload>(server, topic, Json(value)).await {
            Err(Error::NoService { .. }) if Instant::now() < deadline => {}
            answer => return answer,
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn request_returns_the_reply_and_its_sender() {
    let (a, b) = pair("a", "b").await;
    let _service = doubling(&a).await;
    let reply = asked(&b, "a", "double", 21.0).await.expect("a reply");
    assert_eq!(reply.sender, "a");
    assert_eq!(reply.payload.value::<f64>().expect("a number"), 42.0);
    // Programs of the same robot can use the service, too.
    let own = asked(&a, "a", "double", 1.0).await.expect("a reply");
    assert_eq!(own.payload.value::<f64>().expect("a number"), 2.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn error_of_a_service_is_returned_to_the_requester() {
    let (a, b) = pair("a", "b").await;
    let _service = doubling(&a).await;
    asked(&b, "a", "double", 1.0).await.expect("discovered");
    let error = b.request::<Payload>("a", "double", "no number").await;
    let error = error.expect_err("text is not a number");
    let Error::Service { robot, payload } = &error else {
        panic!("{error}");
    };
    assert_eq!(robot.as_ref().expect("a name"), &"a");
    assert!(
        payload.text().expect("text").contains("expected a number"),
        "{error}"
    );
    assert!(
        error.to_string().starts_with("a replied with an error"),
        "{error}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn missing_service_error_lists_reachable_robots() {
    let (a, b) = pair("a", "b").await;
    let error = b
        .request::<Payload>("a", "nothing", "")
        .await
        .expect_err("no service");
    assert!(matches!(error, Error::NoService { .. }), "{error}");
    assert!(error.to_string().contains("reachable robots: a"), "{error}");
    drop(a);
}

#[tokio::test(flavor = "multi_thread")]
async fn request_whose_service_ends_may_have_been_carried_out() {
    let (a, b) = pair("a", "b").await;
    for ends in ["request", "service", "program"] {
        let requests = a.requests(ends).await.expect("served");
        let asking = tokio::spawn({
            let b = b.clone();
            async move {
                asked(&b, "a", ends, 1.0).await.expect("discovered");
                b.request::<Payload>("a", ends, "").await
            }
        });
        let first = requests.next().await.expect("asked");
        first.reply("").expect("replied");
        drop(first);
        let received = requests.next().await.expect("asked");
        match ends {
            "request" => drop(received),
            "service" => {
                drop(requests);
                drop(received);
            }
            _ => a.close().await.expect("closed"),
        }
        let error = asking.await.expect("no panic").expect_err("no reply");
        assert!(
            matches!(error, Error::Interrupted { .. }),
            "{ends}: {error}"
        );
        assert!(
            error.to_string().contains("may have been carried out"),
            "{error}"
        );
    }
    // Zenoh reports the end of a service a moment later.
    let deadline = Instant::now() + TIMEOUT;
    loop {
        match b.request::<Payload>("a", "program", "").await {
            Err(Error::NoService { .. }) => break,
            Err(Error::Interrupted { .. }) if Instant::now() < deadline => {}
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn request_that_nobody_has_received_is_not_interrupted_by_a_service_that_appears() {
    let (a, b) = pair("a", "b").await;
    for n in 0..20 {
        let topic = format!("topic-{n}");
        let asking = tokio::spawn({
            let (b, topic) = (b.clone(), topic.clone());
            async move {
                // The service appears at some moment of one of these requests.
                asked(&b, "a", &topic, 1.0).await
            }
        });
        tokio::task::yield_now().await;
        let _service = a
            .serve(topic.as_str(), |_| async { Ok::<_, String>("done") })
            .await
            .expect("served");
        let reply = asking.await.expect("no panic").expect("a reply");
        assert_eq!(reply.payload.text().expect("text"), "done");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn request_carries_sender_and_deadline() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("slow").await.expect("served");
    let asking = tokio::spawn({
        let b = b.clone();
        async move {
            let _discovered = asked(&b, "a", "slow", 0.0).await;
            let timeout = Duration::from_millis(300);
            b.with_timeout(timeout)
                .request::<Payload>("a", "slow", "")
                .await
        }
    });
    let first = requests.next().await.expect("asked");
    assert_eq!(first.sender.as_ref().expect("known"), &"b");
    assert!(
        first.remaining() > Duration::from_secs(5),
        "{:?}",
        first.remaining()
    );
    first.reply("yes").expect("a reply");
    drop(first);
    let second = requests.next().await.expect("asked");
    assert!(second.remaining() <= Duration::from_millis(300));
    let error = asking.await.expect("no panic").expect_err("no answer");
    assert!(matches!(error, Error::TimedOut { .. }), "{error}");
    drop(second);
}

#[tokio::test(flavor = "multi_thread")]
async fn query_with_wildcards_of_a_stock_program_runs_no_service() {
    let (a, b) = pair("a", "b").await;
    let requests = Arc::new(AtomicUsize::new(0));
    let counted = requests.clone();
    let service = a.serve("home", move |_| {
        counted.fetch_add(1, Ordering::AcqRel);
        async { Ok::<_, String>("at home") }
    });
    let _service = service.await.expect("served");
    let asked = asked(&b, "a", "home", 0.0).await;
    asked.expect("a reply");
    requests.store(0, Ordering::Release);
    for key in ["rect/**", "rect/*/home"] {
        let replies = b.zenoh().get(key).timeout(TIMEOUT).wait();
        let replies = replies.expect("asked");
        // Ends when every queryable has dropped the query.
        assert!(replies.iter().all(|reply| reply.result().is_err()), "{key}");
    }
    assert_eq!(requests.load(Ordering::Acquire), 0);
    let stock = b.zenoh().get("rect/a/home").timeout(TIMEOUT).wait();
    let replies = stock.expect("asked");
    assert_eq!(
        replies
            .iter()
            .filter(|reply| reply.result().is_ok())
            .count(),
        1
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn request_all_collects_several_replies_of_every_service() {
    let endpoint = crate::pair::free_endpoint();
    let a = crate::pair::listening("a", &endpoint).await;
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
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let replies = a.request_all::<Payload>("count", "").await.expect("asked");
        let mut received = Vec::new();
        while let Some(reply) = replies.next().await {
            let reply = reply.expect("no error");
            received.push(format!(
                "{} {}",
                reply.sender,
                reply.payload.text().expect("text")
            ));
        }
        received.sort();
        if received == ["a one", "a two", "b one", "b two"] {
            break;
        }
        assert!(Instant::now() < deadline, "{received:?}");
    }
    drop(c);
}

#[tokio::test(flavor = "multi_thread")]
async fn dropped_request_is_cancelled_at_once() {
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
        let duration = Duration::from_millis(100);
        let patient = b.with_timeout(Duration::from_secs(3600));
        let asked = patient.request::<Payload>("a", "never", "");
        let _ = tokio::time::timeout(duration, asked).await;
        assert!(began.elapsed() < TIMEOUT);
    }
    let closing = Instant::now();
    b.close().await.expect("closed");
    assert!(
        closing.elapsed() < TIMEOUT,
        "close does not wait for the request"
    );
    serving.abort();
}

#[tokio::test(flavor = "multi_thread")]
async fn error_reply_is_attributed_to_the_robot_that_was_asked() {
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

#[tokio::test(flavor = "multi_thread")]
async fn expired_query_of_the_registry_is_a_timeout() {
    let (a, b) = pair("a", "b").await;
    let registry = a.zenoh().declare_queryable("rect/a/@rect/connections");
    let registry = registry.callback(|query| {
        // The error reply that Zenoh creates itself when a query expires.
        query.reply_err("Timeout").wait().expect("replied");
    });
    let _registry = registry.wait().expect("declared");
    let began = Instant::now();
    let error = loop {
        match b.connections_of("a", "").await {
            // The queryable is not discovered yet.
            Err(Error::NoService { .. }) if began.elapsed() < TIMEOUT => {}
            answer => break answer.expect_err("no reply"),
        }
    };
    assert!(matches!(error, Error::TimedOut { .. }), "{error:?}");
    let text = error.to_string();
    assert!(
        text.contains("the router of a about connections within 5 s"),
        "{text}"
    );
}

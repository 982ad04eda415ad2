//! Tests the ends of requests: the outcomes of all robots, streams of replies, and services that learn that nobody waits:
//! `cargo test -p rect-robot --test behaviour replies`
use std::{
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use rect::{Error, Gathered, Json, Payload, Robot};

use crate::pair::{dialling, free_endpoint, listening, pair, stock_client, TIMEOUT};
use zenoh::Wait;

/// How long a service may take to learn that nobody waits, on a computer that is busy with other tests: 0.5 s otherwise.
const LEARNS_WITHIN: Duration = Duration::from_secs(3);

/// Asks all robots for `grab` until as many are expected and reply.
async fn gathered(robot: &Robot, expected: usize) -> Gathered<f64> {
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let asked = robot.request_all::<f64>("grab", "").await.expect("asked");
        match asked.gather().await {
            Ok(gathered) if gathered.expected.len() == expected && gathered.missing.is_empty() => {
                return gathered;
            }
            // A program that begins meanwhile makes it unknown whether somebody has received the request.
            Ok(_) | Err(Error::NoService { .. } | Error::Interrupted { .. })
                if Instant::now() < deadline => {}
            other => panic!("{other:?}"),
        }
    }
}

fn names<'a>(names: impl IntoIterator<Item = &'a rect::Name>) -> Vec<&'a str> {
    names.into_iter().map(rect::Name::as_str).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn each_robot_that_serves_a_topic_has_an_outcome() {
    let endpoint = free_endpoint();
    let asker = listening("asker", &endpoint).await;
    let patient = asker.with_timeout(TIMEOUT);
    let (one, other, lost) = (
        dialling("one", &endpoint).await,
        dialling("other", &endpoint).await,
        dialling("lost", &endpoint).await,
    );
    let nobody = asker.request_all::<f64>("grab", "").await.expect("asked");
    let error = nobody.gather().await.expect_err("nobody serves it");
    assert!(
        error
            .to_string()
            .starts_with("no program of the fleet serves grab; reachable robots:"),
        "{error}"
    );
    let _replies = one
        .serve("grab", |_| async { Ok::<_, String>(Json(1.5)) })
        .await;
    let _refuses = other
        .serve("grab", |_| async { Err::<&str, _>("the arm is stuck") })
        .await;
    let silent = lost.requests("grab").await.expect("served");
    let answering = tokio::spawn(async move {
        // The first requests discover the service.
        while let Some(request) = silent.next().await {
            match request.payload.text() {
                Ok("last") => return (silent, request),
                _ => request.reply(Json(2)).expect("replied"),
            }
        }
        panic!("closed")
    });
    let all = gathered(&patient, 3).await;
    assert_eq!(names(&all.expected), ["lost", "one", "other"]);

    let last = patient
        .request_all::<f64>("grab", "last")
        .await
        .expect("asked");
    let gathering = tokio::spawn(last.gather());
    let (requests, request) = answering.await.expect("no panic");
    // Its robot ends midway.
    lost.close().await.expect("closed");
    drop((requests, request));
    let all = gathering.await.expect("no panic").expect("outcomes");
    let mut outcomes: Vec<_> = (all.outcomes.iter())
        .map(|outcome| {
            let robot = outcome.robot.as_ref().expect("a name").as_str();
            let text = outcome.result.as_ref().map(|reply| reply.value);
            (robot, text.map_err(ToString::to_string))
        })
        .collect();
    outcomes.sort_by_key(|(robot, _)| *robot);
    assert_eq!(outcomes[1], ("one", Ok(1.5)));
    let refused = "other replied with an error: the arm is stuck".to_owned();
    assert_eq!(outcomes[2], ("other", Err(refused)));
    let (robot, interrupted) = &outcomes[0];
    let text = interrupted.as_ref().expect_err("no reply");
    assert_eq!(*robot, "lost");
    assert!(text.contains("may have been carried out"), "{text}");
    assert_eq!(names(&all.missing), ["lost"]);
}

/// Repeats a request until its service is discovered, and returns the replies to the first one that was received.
async fn stream(robot: &Robot, requests: &rect::Requests) -> (rect::Replies<f64>, rect::Request) {
    loop {
        let replies = robot
            .request_stream::<f64>("a", "scan", "")
            .await
            .expect("asked");
        if let Ok(Some(request)) =
            tokio::time::timeout(Duration::from_millis(200), requests.next()).await
        {
            return (replies, request);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn stream_ends_if_all_replies_have_arrived_and_is_interrupted_otherwise() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("scan").await.expect("served");
    for is_finished in [true, false] {
        let (replies, request) = stream(&b, &requests).await;
        for n in 0..3 {
            request.reply(Json(n)).expect("replied");
        }
        if is_finished {
            request.finish().expect("finished");
        }
        drop(request);
        let mut values = Vec::new();
        let end = loop {
            match replies.next().await {
                Some(Ok(reply)) => values.push(reply.value),
                end => break end,
            }
        };
        assert_eq!(values, [0.0, 1.0, 2.0]);
        match (is_finished, end) {
            (true, None) | (false, Some(Err(Error::Interrupted { .. }))) => {}
            (_, other) => panic!("{other:?}"),
        }
        assert!(replies.next().await.is_none());
    }
    // A service with a function ends the stream, and a plain request gets the first reply.
    let _service = a
        .serve("one", |_| async { Ok::<_, String>(Json(7)) })
        .await
        .expect("served");
    let deadline = Instant::now() + TIMEOUT;
    loop {
        let replies = b
            .request_stream::<f64>("a", "one", "")
            .await
            .expect("asked");
        match replies.next().await {
            Some(Ok(reply)) => assert_eq!(reply.value, 7.0),
            Some(Err(Error::NoService { .. })) if Instant::now() < deadline => continue,
            other => panic!("{other:?}"),
        }
        assert!(replies.next().await.is_none());
        break;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn service_learns_that_nobody_waits() {
    let (a, b) = pair("a", "b").await;
    let requests = a.requests("scan").await.expect("served");
    for leaves in ["closes", "deadline", "program"] {
        let limit = match leaves {
            "deadline" => Duration::from_millis(300),
            _ => TIMEOUT,
        };
        let (replies, request) = stream(&b.with_timeout(limit), &requests).await;
        assert!(request.is_wanted(), "{leaves}");
        assert!(request.is_wanted(), "{leaves}");
        match leaves {
            "closes" => drop(replies),
            "deadline" => {}
            _ => b.close().await.expect("closed"),
        }
        let learning = tokio::time::timeout(TIMEOUT, request.unwanted());
        let began = Instant::now();
        learning.await.expect("in time");
        assert!(!request.is_wanted());
        assert!(
            began.elapsed() < LEARNS_WITHIN,
            "{leaves}: {:?}",
            began.elapsed()
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn stock_service_does_not_receive_the_announcement_of_a_closed_request() {
    let endpoint = free_endpoint();
    let a = listening("a", &endpoint).await;
    let b = dialling("b", &endpoint).await;
    // A stock service would take the announcement for a request.
    let stock = stock_client(&endpoint);
    let received = Arc::new(AtomicUsize::new(0));
    let counting = received.clone();
    let _queryable = stock
        .declare_queryable("rect/a/move")
        .complete(true)
        .callback(move |query| {
            counting.fetch_add(1, Ordering::Relaxed);
            // It keeps the query, so that it does not end.
            std::mem::forget(query);
        })
        .wait()
        .expect("declared");
    let deadline = Instant::now() + TIMEOUT;
    let mut asked = 0;
    while received.load(Ordering::Relaxed) == 0 {
        assert!(Instant::now() < deadline);
        let asking = b.request::<Payload>("a", "move", "");
        let _ = tokio::time::timeout(Duration::from_millis(100), asking).await;
        asked += 1;
    }
    // Whatever was sent to the service has arrived when another request is answered.
    let _service = a
        .serve("after", |_| async { Ok::<_, String>("") })
        .await
        .expect("served");
    while b.request::<Payload>("a", "after", "").await.is_err() {
        assert!(Instant::now() < deadline);
    }
    assert!(received.load(Ordering::Relaxed) <= asked);
}

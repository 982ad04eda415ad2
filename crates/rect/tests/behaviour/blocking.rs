//! Tests the iterators and callbacks of the blocking API, with streams, transfers and actions between two programs:
//! `cargo test -p rect-robot --test behaviour blocking`
use std::{
    sync::mpsc,
    time::{Duration, Instant},
};

use rect::{
    blocking::{Goal, Robot},
    Error, Json, Options, Payload, Phase, ReceiveOptions, StartOptions, StreamOptions,
};
use rect_core::storage::Content;

use crate::pair::{free_endpoint, TIMEOUT};

/// Interval between two attempts.
const RETRY_INTERVAL: Duration = Duration::from_millis(50);

/// Returns two robots; the second one dials the first.
fn two_robots() -> [Robot; 2] {
    let endpoint = free_endpoint();
    let options = |name| Options::new(name).expect("a name").login_file("/none");
    let a = Robot::connect(options("a").listen(&endpoint)).expect("connected");
    let b = Robot::connect(options("b").endpoint(&endpoint)).expect("connected");
    [a, b]
}

#[test]
fn frames_iterator_yields_frames_until_close() {
    let [a, b] = two_robots();
    let mut frames = b.watch("a/distance").expect("watched");
    let stream = a
        .stream("distance", StreamOptions::sensor())
        .expect("declared");
    let sending = std::thread::spawn(move || {
        // Sends until the session is closed.
        for value in (0u8..=255).cycle() {
            if stream.send([value]).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    });
    let first = frames.next_timeout(TIMEOUT).expect("in time");
    let next = frames.next().expect("open");
    assert!(next.number > first.number, "{first:?} {next:?}");
    a.close().expect("closed");
    sending.join().expect("no panic");
    b.close().expect("closed");
    assert_eq!(
        frames.by_ref().take(2).count() / 2,
        0,
        "the iterator ends with the session"
    );
}

#[test]
fn transfers_iterator_yields_received_transfers_until_close() {
    let [a, b] = two_robots();
    let options = ReceiveOptions::in_memory(1 << 20);
    let mut received = b.receive_transfers("a/**", options).expect("declared");
    let sent = a
        .transfer("b", "map", vec![7; 100_000])
        .expect("valid arguments");
    sent.timeout(TIMEOUT).wait().expect("sent");
    let got = received.next().expect("open").expect("complete");
    assert_eq!(got.content, Content::Bytes(vec![7; 100_000].into()));
    let refused = a
        .transfer("b", "map", vec![7; 2 << 20])
        .expect("valid arguments");
    let error = refused.timeout(TIMEOUT).wait().expect_err("too large");
    assert!(error.to_string().contains("1048576"), "{error}");
    b.close().expect("closed");
    assert!(received.next_timeout(TIMEOUT).is_none());
}

#[test]
fn callback_may_use_and_drop_the_last_robot_handle() {
    let [a, b] = two_robots();
    let (mut last, (dropped, was_dropped)) = (Some(b.clone()), mpsc::channel());
    let (go, proceed) = mpsc::channel::<()>();
    let subscription = b.on_message::<Payload>("a/goodbye", move |_| {
        let _ = proceed.recv();
        if let Some(last) = last.take() {
            last.publish("goodbye", "").expect("published");
            drop(last);
            let _ = dropped.send(());
        }
    });
    let subscription = subscription.expect("subscribed");
    let deadline = Instant::now() + TIMEOUT;
    drop(b);
    drop(go);
    while was_dropped.recv_timeout(RETRY_INTERVAL).is_err() {
        assert!(Instant::now() < deadline, "the callback did not finish");
        a.publish("goodbye", "").expect("published");
    }
    drop(subscription);
}

/// Digs to a depth. Depth 0 fails, and depth 13 panics.
fn dig(goal: &Goal) -> Result<String, String> {
    let depth: u32 = goal.payload.value().map_err(|error| error.to_string())?;
    assert_ne!(depth, 13, "unlucky");
    if depth == 0 {
        return Err("there is rock".to_owned());
    }
    for done in 1..=depth {
        let progress = f64::from(done) / f64::from(depth);
        let sent = goal.feedback(Json(done), Some(progress));
        sent.map_err(|error| error.to_string())?;
        let slept = goal.sleep(RETRY_INTERVAL);
        slept.map_err(|cancelled| cancelled.to_string())?;
    }
    assert!(!goal.is_cancelled());
    Ok(format!("{depth} cm deep"))
}

#[test]
fn action_is_carried_out_on_a_thread_and_its_result_is_waited_for() {
    let [a, b] = two_robots();
    let action = b.action("dig", |goal| dig(&goal)).expect("declared");
    let run = a.start("b", "dig", Json(2)).expect("started");
    let mut changes = run.changes();
    while run.phase() != Phase::Done {
        changes.next().expect("open");
    }
    assert_eq!(run.result::<String>(None).expect("done"), "2 cm deep");
    for (depth, expected) in [(0, "there is rock"), (13, "panicked")] {
        let run = a.start("b", "dig", Json(depth)).expect("started");
        match run.end(Some(TIMEOUT)).expect_err("failed") {
            Error::Goal { phase, reason } => {
                assert_eq!(phase, Phase::Failed);
                assert!(reason.contains(expected), "{reason}");
            }
            other => panic!("{other}"),
        }
    }
    let unknown = a
        .start("b", "fly", "")
        .expect_err("there is no such action");
    assert!(matches!(unknown, Error::NoAction { .. }), "{unknown}");
    drop(action);
}

#[test]
fn goal_is_found_and_cancelled() {
    let [a, b] = two_robots();
    let _action = b.action("dig", |goal| dig(&goal)).expect("declared");
    let run = a
        .start_with("b", "dig", Json(100_000), StartOptions::new().id("hole"))
        .expect("started");
    while run.feedback().is_none() {
        run.changes().next().expect("open");
    }
    assert!(run.progress().is_some_and(|progress| progress < 0.1));
    let waiting = run.end(Some(RETRY_INTERVAL)).expect_err("it goes on");
    assert!(matches!(waiting, Error::TimedOut { .. }), "{waiting}");
    assert!(waiting.to_string().contains("running"), "{waiting}");
    let found = a.find("b", "dig", "hole").expect("known");
    assert_eq!((found.id(), found.action()), ("hole", "dig"));
    let goals = a.goals(None).expect("listed");
    assert!(
        goals.iter().any(|goal| goal.id == "hole"),
        "{goals:?} does not contain the goal"
    );
    found.cancel().expect("cancelled");
    for run in [run, found] {
        match run.end(Some(TIMEOUT)).expect_err("cancelled") {
            Error::Goal { phase, .. } => assert_eq!(phase, Phase::Cancelled),
            other => panic!("{other}"),
        }
    }
    let other = a.find("b", "dig", "other").expect_err("nobody started it");
    assert!(matches!(other, Error::NoGoal { .. }), "{other}");
}

#[test]
fn handler_ends_when_the_session_is_closed() {
    let [a, b] = two_robots();
    let (ended, has_ended) = mpsc::channel();
    let _action = b.action("dig", move |goal| {
        let result = dig(&goal);
        let _ = ended.send(result.clone());
        result
    });
    let run = a.start("b", "dig", Json(100_000)).expect("started");
    while run.feedback().is_none() {
        run.changes().next().expect("open");
    }
    b.close().expect("closed");
    let end = has_ended.recv_timeout(TIMEOUT).expect("in time");
    assert!(end.is_err(), "{end:?}");
}

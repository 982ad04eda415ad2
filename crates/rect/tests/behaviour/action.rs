//! Tests actions between robots that are linked directly: `cargo test -p rect-robot --test behaviour action`
use std::{
    future::Future,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
    time::Duration,
};

use rect::{ActionOptions, ActionRun, Error, Goal, Json, Phase, Robot, StartOptions, Value};
use tokio::{sync::Notify, time::timeout};

use crate::pair::{dialling, free_endpoint, listening, pair, TIMEOUT};

async fn soon<T>(future: impl Future<Output = T>) -> T {
    timeout(TIMEOUT, future).await.expect("in time")
}

/// Digs until it is cancelled.
async fn endless(robot: &Robot, options: ActionOptions) -> rect::Action {
    let handler = |goal: Goal| async move {
        goal.feedback(Json("digging"), Some(0.5)).expect("sent");
        Err::<&str, _>(goal.cancelled().await)
    };
    robot.action(options, handler).await.expect("declared")
}

async fn until(run: &ActionRun, phase: Phase) {
    let mut changes = run.changes();
    soon(async {
        while run.phase() != phase {
            changes.next().await.expect("it has not ended");
        }
    })
    .await;
}

async fn until_end(run: &ActionRun) {
    let mut changes = run.changes();
    while !run.phase().is_end() {
        soon(changes.next()).await;
    }
}

/// Waits for an end that is not the goal, and returns its reason.
async fn ended(run: &ActionRun, expected: Phase) -> String {
    match soon(run.result::<Value>()).await {
        Err(Error::Goal { phase, reason }) if phase == expected => reason,
        other => panic!("{other:?}"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_is_carried_out_and_others_find_it() {
    let (robot, laptop) = pair("wombat", "laptop").await;
    let begun = Arc::new(AtomicUsize::new(0));
    let counted = begun.clone();
    let options = ActionOptions::new("dig").about("digs a hole");
    let handler = move |goal: Goal| {
        counted.fetch_add(1, Ordering::Relaxed);
        async move {
            let depth: u32 = goal.payload.value().map_err(|error| error.to_string())?;
            goal.feedback(Json([1, 2]), Some(0.25)).expect("sent");
            Ok::<_, String>(Json(depth * 2))
        }
    };
    let _action = robot.action(options, handler).await.expect("declared");
    let programs = laptop.programs("wombat").await.expect("a catalogue");
    let actions: Vec<_> = programs.iter().flat_map(|one| one.actions()).collect();
    assert_eq!(actions, [("dig", "digs a hole")]);
    assert_eq!(laptop.services("wombat").await.expect("services"), []);
    let first = || StartOptions::new().id("first");

    let run = laptop.start_with("wombat", "dig", Json(21), first());
    let run = soon(run).await.expect("accepted");
    assert_eq!(soon(run.result::<u32>()).await.expect("a result"), 42);
    assert_eq!((run.id(), run.phase()), ("first", Phase::Done));
    // A start of the same goal runs it once, and has the same end.
    let again = laptop.start_with("wombat", "dig", Json(21), first());
    let again = soon(again).await.expect("accepted");
    assert_eq!(soon(again.result::<u32>()).await.expect("a result"), 42);
    assert_eq!(begun.load(Ordering::Relaxed), 1);

    let found = soon(laptop.find("wombat", "dig", "first")).await;
    let found = found.expect("found");
    // The answer is applied: nothing else has to arrive.
    assert_eq!(found.phase(), Phase::Done);
    let result = found.result::<u32>().await;
    assert_eq!(result.expect("a result"), 42);
    let unknown = soon(laptop.find("wombat", "dig", "other")).await;
    assert!(matches!(unknown, Err(Error::NoGoal { .. })), "{unknown:?}");
    let goals = soon(laptop.goals(None)).await.expect("asked");
    let [goal] = &goals[..] else {
        panic!("{goals:?}");
    };
    assert_eq!((goal.id.as_str(), goal.state.phase), ("first", Phase::Done));
    assert_eq!(goal.state.by, "laptop");
}

#[tokio::test(flavor = "multi_thread")]
async fn feedback_is_sent_as_often_as_the_client_asks_and_nothing_is_a_result() {
    let (robot, laptop) = pair("wombat", "laptop").await;
    let received = Arc::new(Notify::new());
    let continues = received.clone();
    let handler = move |goal: Goal| {
        let received = received.clone();
        async move {
            goal.feedback((), Some(0.1)).expect("sent");
            received.notified().await;
            goal.feedback((), Some(0.2)).expect("sent");
            // Long enough for the default rate, and short beside the pause of 10 s that the client asks for.
            goal.sleep(Duration::from_secs(1)).await
        }
    };
    let _action = robot.action("dig", handler).await.expect("declared");
    let rarely = StartOptions::new().feedback_per_s(0.1);
    let run = soon(laptop.start_with("wombat", "dig", (), rarely)).await;
    let run = run.expect("accepted");
    let mut changes = run.changes();
    soon(async {
        while run.progress() != Some(0.1) {
            changes.next().await.expect("it has not ended");
        }
    })
    .await;
    continues.notify_one();
    soon(run.result::<()>()).await.expect("done");
    assert_eq!(run.progress(), Some(0.1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handler_that_fails_is_the_failure_of_its_goal() {
    let (robot, laptop) = pair("wombat", "laptop").await;
    let handler = |goal: Goal| async move {
        if goal.payload.value::<bool>().expect("a bool") {
            panic!("the motor burns");
        }
        Err::<&str, _>("no shovel")
    };
    let _action = robot.action("dig", handler).await.expect("declared");
    for (panics, reason) in [(false, "no shovel"), (true, "the handler panicked")] {
        let run = soon(laptop.start("wombat", "dig", Json(panics))).await;
        let run = run.expect("accepted");
        assert_eq!(ended(&run, Phase::Failed).await, reason);
    }
    let missing = soon(laptop.start("wombat", "dgi", "")).await;
    let text = missing.expect_err("no such action").to_string();
    assert!(text.contains("dig"), "{text}");
    let wrong = soon(laptop.start("wombat", "a/b", "")).await;
    assert!(matches!(wrong, Err(Error::Action { .. })), "{wrong:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_is_cancelled_preempted_or_refused() {
    let (robot, laptop) = pair("wombat", "laptop").await;
    let _action = endless(&robot, ActionOptions::new("dig")).await;
    let busy = ActionOptions::new("scan").refuse_when_busy();
    let _scan = endless(&robot, busy).await;
    let run = soon(laptop.start("wombat", "dig", ""))
        .await
        .expect("accepted");
    let mut changes = run.changes();
    soon(async {
        while run.progress() != Some(0.5) {
            changes.next().await.expect("it has not ended");
        }
    })
    .await;
    let feedback: String = run.feedback().expect("feedback").value().expect("a text");
    assert_eq!(feedback, "digging");
    let newer = soon(laptop.start("wombat", "dig", ""))
        .await
        .expect("accepted");
    let reason = ended(&run, Phase::Preempted).await;
    assert_eq!(reason, "by a newer goal of laptop");
    until(&newer, Phase::Running).await;
    soon(newer.cancel()).await.expect("cancelled");
    assert_eq!(ended(&newer, Phase::Cancelled).await, "by laptop");

    let scan = soon(laptop.start("wombat", "scan", ""))
        .await
        .expect("accepted");
    until(&scan, Phase::Running).await;
    let refused = soon(laptop.start("wombat", "scan", ""))
        .await
        .expect("an end");
    let reason = ended(&refused, Phase::Refused).await;
    assert!(reason.starts_with("busy with a goal of laptop"), "{reason}");
    // A stop cancels the goals, and refuses new ones until it is released.
    let stop = soon(laptop.fleet_stop()).await.expect("takes part");
    soon(stop.press("smoke")).await.expect("pressed");
    let reason = ended(&scan, Phase::Cancelled).await;
    assert_eq!(reason, "stopped by laptop: smoke");
    let refused = soon(laptop.start("wombat", "scan", ""))
        .await
        .expect("an end");
    assert_eq!(
        ended(&refused, Phase::Refused).await,
        "stopped by laptop: smoke"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_handler_that_ignores_the_cancel_is_done() {
    let (robot, laptop) = pair("wombat", "laptop").await;
    let may_end = Arc::new(Notify::new());
    let waits = may_end.clone();
    let handler = move |_: Goal| {
        let waits = waits.clone();
        async move {
            waits.notified().await;
            Ok::<_, String>("dug")
        }
    };
    let _action = robot.action("dig", handler).await.expect("declared");
    let run = soon(laptop.start("wombat", "dig", ""))
        .await
        .expect("accepted");
    until(&run, Phase::Running).await;
    soon(run.cancel()).await.expect("cancelled");
    until(&run, Phase::Cancelling).await;
    assert!(run.phase_for() < TIMEOUT);
    may_end.notify_one();
    assert_eq!(soon(run.result::<String>()).await.expect("a result"), "dug");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_goal_whose_program_ends_is_lost_and_one_whose_client_ends_is_cancelled() {
    let endpoint = free_endpoint();
    let robot = listening("wombat", &endpoint).await;
    let base = dialling("base", &endpoint).await;
    let laptop = dialling("laptop", &endpoint).await;
    let lost_after = Some(Duration::from_millis(300));
    let options = ActionOptions::new("dig").lost_after(lost_after);
    let action = endless(&robot, options).await;
    for client in [&laptop, &base] {
        let wombat = robot.name().clone();
        let known = client.wait_for_peer(wombat, TIMEOUT).await;
        known.expect("reachable");
    }
    let run = soon(laptop.start("wombat", "dig", ""))
        .await
        .expect("accepted");
    until(&run, Phase::Running).await;
    let id = run.id().to_owned();
    let found = soon(base.find("wombat", "dig", &id)).await.expect("found");
    soon(laptop.close()).await.expect("closed");
    let reason = ended(&found, Phase::Cancelled).await;
    assert_eq!(reason, "laptop has been away for 300 ms");
    assert!(matches!(soon(run.end()).await, Err(Error::Closed)));

    let alone = ActionOptions::new("scan").lost_after(None);
    let scan = endless(&robot, alone).await;
    let run = soon(base.start("wombat", "scan", ""))
        .await
        .expect("accepted");
    until(&run, Phase::Running).await;
    drop(scan);
    assert_eq!(ended(&run, Phase::Cancelled).await, "the action has ended");
    drop(action);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_large_result_is_received_from_the_program_and_has_a_limit() {
    let endpoint = free_endpoint();
    let robot = listening("wombat", &endpoint).await;
    let [base, laptop] = [
        dialling("base", &endpoint).await,
        dialling("laptop", &endpoint).await,
    ];
    let handler = |goal: Goal| async move {
        let size: usize = goal.payload.value().map_err(|error| error.to_string())?;
        Ok::<_, String>("x".repeat(size))
    };
    let action = robot.action("map", handler).await.expect("declared");
    for client in [&laptop, &base] {
        let known = client.wait_for_peer(robot.name().clone(), TIMEOUT).await;
        known.expect("reachable");
    }
    let megabyte = "x".repeat(1 << 20);
    let map = |size: usize| laptop.start("wombat", "map", Json(size));
    let run = soon(map(1 << 20)).await.expect("accepted");
    // A wait that is given up does not interrupt the reception.
    let _ = timeout(Duration::from_millis(1), run.end()).await;
    assert_eq!(
        soon(run.result::<String>()).await.expect("a result"),
        megabyte
    );
    assert_eq!(run.result_progress(), None);
    // The end of the action is not that of its results.
    drop(action);
    let found = soon(base.find("wombat", "map", run.id()))
        .await
        .expect("found");
    assert_eq!(
        soon(found.result::<String>()).await.expect("a result"),
        megabyte
    );

    let _action = robot.action("map", handler).await.expect("declared");
    let refused = soon(map((16 << 20) + 1)).await.expect("accepted");
    let reason = ended(&refused, Phase::Failed).await;
    assert!(reason.contains("send it as a transfer"), "{reason}");

    let run = soon(map(1 << 20)).await.expect("accepted");
    until_end(&run).await;
    soon(robot.close()).await.expect("closed");
    match run.end_within(Duration::from_millis(300)).await {
        Err(Error::TimedOut { expected, .. }) => assert_eq!(
            expected,
            "result of map of wombat, of which 0 B of 1048 kB have arrived,"
        ),
        other => panic!("{other:?}"),
    }
    soon(laptop.close()).await.expect("closed");
    assert!(matches!(soon(run.end()).await, Err(Error::Closed)));
}

//! Tests logs and alerts: `cargo test -p rect-robot --test behaviour log`
use std::{path::Path, sync::mpsc, time::Duration};

use rect::{KeptLine, Level, LogItem, LogLayer, LogLine, LogOptions, Robot, RobotAlert};
use tokio::time::{sleep, timeout};
use tracing_subscriber::prelude::*;

use crate::pair::{pair, TIMEOUT};

/// Returns the lines that a robot reads of another one, oldest first.
async fn lines(reader: &Robot, robot: &str, options: LogOptions) -> Vec<KeptLine> {
    let logs = reader.logs(robot, options).await.expect("a reader");
    let mut found = Vec::new();
    while let Some(item) = timeout(TIMEOUT, logs.next()).await.expect("in time") {
        if let LogItem::Lines { lines, .. } = item {
            found.extend(lines);
        }
    }
    found.sort_by_key(|kept| kept.number);
    found
}

/// Waits until a robot has as many lines.
async fn until_lines(reader: &Robot, robot: &str, count: usize) -> Vec<KeptLine> {
    let waited = async {
        loop {
            let found = lines(reader, robot, LogOptions::new()).await;
            if found.len() >= count {
                return found;
            }
            sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(TIMEOUT, waited).await.expect("they arrive")
}

#[tokio::test(flavor = "multi_thread")]
async fn another_robot_reads_the_lines_of_a_program_and_follows_new_ones() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    one.log(Level::Info, "moving");
    one.log_line(LogLine {
        logger: "gripper".to_owned(),
        fields: [("angle".to_owned(), 12.5.into())].into(),
        source: "arm.rs:12".to_owned(),
        ..LogLine::new(5, Level::Warn, "slow")
    });
    one.log_private(LogLine::new(6, Level::Info, "the password is 1234"));
    let all = until_lines(&one, "wombat-1", 3).await;
    assert_eq!(all[2].line.text, "the password is 1234");
    let read = lines(&two, "wombat-1", LogOptions::new()).await;
    let texts: Vec<_> = read.iter().map(|kept| kept.line.text.as_str()).collect();
    assert_eq!(texts, ["moving", "slow"]);
    assert_eq!(read[1].line, all[1].line);
    let warnings = LogOptions::new().level(Level::Warn).follow();
    let follower = two.logs("*", warnings).await.expect("a reader");
    let next = || async { timeout(TIMEOUT, follower.next()).await.expect("in time") };
    while next().await != Some(LogItem::Complete) {}
    one.log(Level::Debug, "a detail");
    one.log(Level::Error, "it broke");
    let Some(LogItem::Lines { lines, is_new, .. }) = next().await else {
        panic!("no lines");
    };
    assert!(
        is_new && lines.len() == 1 && lines[0].line.text == "it broke",
        "{lines:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn events_of_tracing_are_lines_and_those_of_the_libraries_are_not() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let subscriber = tracing_subscriber::registry().with(LogLayer::new(&one));
    tracing::subscriber::with_default(subscriber, || {
        tracing::warn!(target: "gripper", angle = 12.5, is_closed = false, "the claw of {} is slow", "wombat-1");
        tracing::error!(target: "rect::session", "not a line");
        tracing::error!(target: "zenoh_transport", "not a line either");
        tracing::trace!(target: "rectangle", "a detail");
    });
    let read = until_lines(&two, "wombat-1", 2).await;
    let [slow, detail] = &read[..] else {
        panic!("{read:?}");
    };
    assert_eq!(slow.line.text, "the claw of wombat-1 is slow");
    assert_eq!(
        (slow.line.level, slow.line.logger.as_str()),
        (Level::Warn, "gripper")
    );
    assert_eq!(slow.line.fields["angle"], 12.5);
    assert_eq!(slow.line.fields["is_closed"], false);
    let (file, line) = slow.line.source.rsplit_once(':').expect("a place");
    assert!(Path::new(file).ends_with("log.rs") && line.parse::<u32>().is_ok());
    assert_eq!(detail.line.level, Level::Debug);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_last_lines_of_a_program_arrive_before_its_session_is_closed() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let logs = two
        .logs("wombat-1", LogOptions::new().follow())
        .await
        .expect("a reader");
    while timeout(TIMEOUT, logs.next()).await.expect("in time") != Some(LogItem::Complete) {}
    for number in 0..500 {
        one.log(Level::Info, format!("line {number}"));
    }
    one.close().await.expect("closed");
    // Nobody keeps them without the program, which has no router; they were published before.
    let mut last = 0;
    while last != 499 {
        let Some(LogItem::Lines { lines, .. }) =
            timeout(TIMEOUT, logs.next()).await.expect("in time")
        else {
            continue;
        };
        let text = &lines.last().expect("a line").line.text;
        last = text.trim_start_matches("line ").parse().expect("a number");
    }
    one.log(Level::Info, "after the end");
}

#[test]
fn logging_never_blocks_a_thread_without_a_runtime() {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let (one, _two) = runtime.block_on(pair("wombat-1", "wombat-2"));
    let (done, is_done) = mpsc::channel();
    std::thread::spawn(move || {
        for number in 0..100_000 {
            one.log(Level::Debug, format!("line {number}"));
        }
        done.send(()).expect("received");
    });
    is_done.recv_timeout(TIMEOUT).expect("it does not wait");
}

#[tokio::test(flavor = "multi_thread")]
async fn alerts_of_all_robots_are_listed_until_they_are_cleared() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    one.alert(Level::Warn, "battery low").await.expect("raised");
    one.alert_named("motor", Level::Error, "motor 2 at 80 °C")
        .await
        .expect("raised");
    one.alert_named("motor", Level::Error, "motor 2 at 90 °C")
        .await
        .expect("replaced");
    let alerts = || async {
        let found = two.alerts(None).await.expect("an answer");
        let text = |one: RobotAlert| format!("{}: {}", one.robot, one.alert.text);
        found.into_iter().map(text).collect::<Vec<_>>()
    };
    let expected = ["wombat-1: motor 2 at 90 °C", "wombat-1: battery low"];
    // The other program may not have learned yet that this one has values.
    let known = async {
        while alerts().await != expected {
            sleep(Duration::from_millis(10)).await;
        }
    };
    timeout(TIMEOUT, known).await.expect("they are listed");
    one.clear_alert("motor").await.expect("cleared");
    one.clear_alert("never raised")
        .await
        .expect("nothing happens");
    assert_eq!(alerts().await, ["wombat-1: battery low"]);
    assert!(one.alert(Level::Warn, "!").await.is_err());
}

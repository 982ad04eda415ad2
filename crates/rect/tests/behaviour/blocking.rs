//! Tests the iterators and callbacks of the blocking API, with streams and transfers between two programs:
//! `cargo test -p rect-robot --test behaviour blocking`
use std::{
    sync::mpsc,
    time::{Duration, Instant},
};

use rect::{blocking::Robot, Options, Payload, ReceiveOptions, StreamOptions};
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

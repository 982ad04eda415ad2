//! What the blocking form has of its own, and streams and transfers in it, between two programs: `cargo test -p rect --test blocking`
mod pair;

use std::{
    sync::mpsc,
    time::{Duration, Instant},
};

use pair::{free_endpoint, PATIENCE};
use rect::{blocking::Robot, storage::Content, Options, ReceiveTransfers, StreamOptions};

/// Between two tries.
const MOMENT: Duration = Duration::from_millis(50);

fn two() -> [Robot; 2] {
    let there = free_endpoint();
    let options = |name| Options::new(name).expect("a name").login_file("/none");
    let a = Robot::join(options("a").listen(&there)).expect("joined");
    let b = Robot::join(options("b").endpoint(&there)).expect("joined");
    [a, b]
}

#[test]
fn a_stream_is_sent_and_its_frames_are_an_iterator() {
    let [a, b] = two();
    let mut frames = b.watch("a", "distance").expect("watched");
    let stream = a
        .stream("distance", StreamOptions::sensor())
        .expect("declared");
    let sending = std::thread::spawn(move || {
        // Until the other side has left.
        for value in (0u8..=255).cycle() {
            if stream.send([value]).is_err() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
    });
    let first = frames.next_within(PATIENCE).expect("in time");
    let next = frames.next().expect("open");
    assert!(next.number > first.number, "{first:?} {next:?}");
    a.close().expect("closed");
    sending.join().expect("no panic");
    b.close().expect("closed");
    assert_eq!(
        frames.by_ref().take(2).count() / 2,
        0,
        "it ends with the session"
    );
}

#[test]
fn a_transfer_is_sent_and_what_comes_is_an_iterator() {
    let [a, b] = two();
    let options = ReceiveTransfers::in_memory(1 << 20);
    let mut received = b.receive_transfers("a/**", options).expect("declared");
    let sent = a.transfer("b", "map", vec![7; 100_000]).expect("named");
    sent.patience(PATIENCE).wait().expect("taken");
    let got = received.next().expect("open").expect("whole");
    assert_eq!(got.content, Content::Bytes(vec![7; 100_000].into()));
    let refused = a.transfer("b", "map", vec![7; 2 << 20]).expect("named");
    let error = refused.patience(PATIENCE).wait().expect_err("too large");
    assert!(error.to_string().contains("1048576"), "{error}");
    b.close().expect("closed");
    assert!(received.next_within(PATIENCE).is_none());
}

#[test]
fn a_callback_may_wait_for_the_robot_and_drop_the_last_of_it() {
    let [a, b] = two();
    let (mut last, (dropped, was_dropped)) = (Some(b.clone()), mpsc::channel());
    let (go, goes) = mpsc::channel::<()>();
    let subscription = b.on_message("a/bye", move |_| {
        let _ = goes.recv();
        if let Some(last) = last.take() {
            last.publish("bye", "").expect("said");
            drop(last);
            let _ = dropped.send(());
        }
    });
    let subscription = subscription.expect("subscribed");
    let deadline = Instant::now() + PATIENCE;
    drop(b);
    drop(go);
    while was_dropped.recv_timeout(MOMENT).is_err() {
        assert!(
            Instant::now() < deadline,
            "the callback did not get past it"
        );
        a.publish("bye", "").expect("said");
    }
    drop(subscription);
}

//! Tests of transfers between programs of two robots that are linked over the simulated air:
//! `cargo test -p rect-router --test transfer`

mod support;

use std::{
    future::{Future, IntoFuture},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        Arc, Mutex,
    },
    time::{Duration, Instant},
};

use rect::{ReceiveOptions, Robot, Transfers};
use support::{joined, simulated, Air, Router, DEADLINE};
use tokio::time::{sleep, timeout};

/// Two linked routers, and a program at each.
struct Pair {
    _routers: [Router; 2],
    one: Robot,
    other: Robot,
}

/// Starts two linked routers and connects a program to each.
async fn pair(air: &Air) -> Pair {
    let (first, local) = simulated(air, 1, &[]);
    let (second, remote) = simulated(air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    let (one, other) = (
        joined("wombat-1", &local).await,
        joined("wombat-2", &remote).await,
    );
    Pair {
        _routers: [first, second],
        one,
        other,
    }
}

/// Runs a test in a runtime that does not contain the runtime of the air: runtimes must not be nested.
fn run(test: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(test);
}

/// Returns pseudorandom bytes, which cannot be compressed.
fn noise(length: usize) -> Vec<u8> {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let next = |_| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 24) as u8
    };
    (0..length).map(next).collect()
}

/// Receives transfers in memory.
async fn receiving(robot: &Robot) -> Transfers {
    let options = ReceiveOptions::in_memory(1 << 30);
    robot
        .receive_transfers("*/**", options)
        .await
        .expect("declared")
}

#[test]
fn a_transfer_uses_the_whole_link_and_urgent_messages_overtake_it() {
    let air = Air::new();
    run(fill(&air));
}

async fn fill(air: &Air) {
    let pair = pair(air).await;
    let received = receiving(&pair.other).await;
    let stops = pair
        .other
        .subscribe("wombat-1/stop")
        .await
        .expect("subscribed");
    let puts = pair
        .other
        .subscribe("wombat-1/put")
        .await
        .expect("subscribed");

    // A small transfer first, after which all links and routes exist.
    let first = pair
        .one
        .transfer("wombat-2", "first", vec![1])
        .expect("named");
    timeout(DEADLINE, first.into_future())
        .await
        .expect("in time")
        .expect("sent");
    let bytes = noise(300_000);
    // The throughput of a single publication without other traffic.
    let bulk = pair.one.bulk();
    let start = Instant::now();
    bulk.publish("put", &bytes[..]).await.expect("published");
    timeout(DEADLINE * 2, puts.next())
        .await
        .expect("in time")
        .expect("open");
    let raw = start.elapsed();

    let start = Instant::now();
    let is_finished = Arc::new(AtomicBool::new(false));
    let (urgent, finished) = (pair.one.urgent(), is_finished.clone());
    let publishing = tokio::spawn(async move {
        let mut published = Vec::new();
        while !finished.load(Ordering::SeqCst) {
            published.push(Instant::now());
            urgent
                .publish("stop", [published.len() as u8; 16])
                .await
                .expect("published");
            sleep(Duration::from_millis(50)).await;
        }
        published
    });
    let arrivals = Arc::new(Mutex::new(Vec::new()));
    let recording = arrivals.clone();
    let listening = tokio::spawn(async move {
        while stops.next().await.is_some() {
            recording.lock().expect("unpoisoned").push(Instant::now());
        }
    });
    let sent = pair
        .one
        .transfer("wombat-2", "large", bytes.clone())
        .expect("named");
    timeout(DEADLINE * 2, sent.into_future())
        .await
        .expect("in time")
        .expect("sent");
    let took = start.elapsed();
    is_finished.store(true, Ordering::SeqCst);
    let published = publishing.await.expect("no panic");
    sleep(Duration::from_millis(500)).await;
    listening.abort();
    let arrivals = arrivals.lock().expect("unpoisoned").clone();
    assert_eq!(published.len(), arrivals.len(), "each message arrived");
    let mut ages: Vec<_> = published
        .iter()
        .zip(&arrivals)
        .map(|(published, arrived)| *arrived - *published)
        .collect();
    ages.sort();
    let (p50, p99) = (ages[ages.len() / 2], ages[ages.len() * 99 / 100]);
    let share = raw.as_secs_f64() / took.as_secs_f64();
    println!(
        "{} bytes: one put {raw:?}, transfer {took:?} with 20 urgent messages per second ({share:.2} of the put); urgent p50 \
         {p50:?} p99 {p99:?} of {}",
        bytes.len(),
        ages.len()
    );
    for _ in 0..2 {
        assert!(received.next().await.expect("open").is_ok());
    }
    // Without urgent messages and for one megabyte, the share is 0.93; the start of a transfer takes 0.2 s.
    assert!(share > 0.8, "{share}");
    assert!(p99 < Duration::from_millis(250), "{p99:?}");
}

#[test]
fn a_transfer_resumes_after_the_radio_is_cut() {
    let air = Air::new();
    run(cut(&air));
}

async fn cut(air: &Air) {
    let pair = pair(air).await;
    let received = receiving(&pair.other).await;
    let bytes = noise(200_000);
    let received_bytes = Arc::new(AtomicU64::new(0));
    let progress_bytes = received_bytes.clone();
    let sent = pair
        .one
        .transfer("wombat-2", "map", bytes.clone())
        .expect("named");
    let sent = sent.on_progress(move |progress| {
        progress_bytes.store(progress.received_bytes, Ordering::SeqCst)
    });
    let sent = tokio::spawn(sent.into_future());
    for part in 1..4 {
        let progress = async {
            while received_bytes.load(Ordering::SeqCst) < part * 50_000 {
                sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(DEADLINE, progress).await.expect("in time");
        air.air().cut();
        sleep(Duration::from_secs(1)).await;
        air.air().restore();
    }
    timeout(DEADLINE, sent)
        .await
        .expect("in time")
        .expect("no panic")
        .expect("sent");
    let got = received.next().await.expect("open").expect("whole");
    assert_eq!(got.content, rect::storage::Content::Bytes(bytes.into()));
}

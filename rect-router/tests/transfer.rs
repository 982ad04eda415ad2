//! Transfers between programs of two robots that are linked by Bluetooth, on the simulated air:
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

use rect::{ReceiveTransfers, Robot, Transfers};
use support::{joined, simulated, Air, Router, DEADLINE};
use tokio::time::{sleep, timeout};

struct Pair {
    _routers: [Router; 2],
    one: Robot,
    other: Robot,
}

/// Programs of two robots whose routers are linked over the air.
async fn pair(air: &Air) -> Pair {
    let (first, here) = simulated(air, 1, &[]);
    let (second, there) = simulated(air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    let (one, other) = (
        joined("wombat-1", &here).await,
        joined("wombat-2", &there).await,
    );
    Pair {
        _routers: [first, second],
        one,
        other,
    }
}

/// The air has a runtime of its own, which must not be inside another one.
fn run(test: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(test);
}

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

async fn receiving(robot: &Robot) -> Transfers {
    let options = ReceiveTransfers::in_memory(1 << 30);
    robot
        .receive_transfers("*/**", options)
        .await
        .expect("declared")
}

#[test]
fn a_transfer_fills_the_radio_and_what_is_urgent_overtakes_it() {
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

    // The links and routes are there once a small one has gone.
    let first = pair
        .one
        .transfer("wombat-2", "first", vec![1])
        .expect("named");
    timeout(DEADLINE, first.into_future())
        .await
        .expect("in time")
        .expect("sent");
    let bytes = noise(300_000);
    // What one put brings, which has the radio for itself.
    let bulk = pair.one.bulk();
    let start = Instant::now();
    bulk.publish("put", &bytes[..]).await.expect("said");
    timeout(DEADLINE * 2, puts.recv())
        .await
        .expect("in time")
        .expect("open");
    let raw = start.elapsed();

    let start = Instant::now();
    let is_over = Arc::new(AtomicBool::new(false));
    let (urgent, over) = (pair.one.urgent(), is_over.clone());
    let said = tokio::spawn(async move {
        let mut said = Vec::new();
        while !over.load(Ordering::SeqCst) {
            said.push(Instant::now());
            urgent
                .publish("stop", [said.len() as u8; 16])
                .await
                .expect("said");
            sleep(Duration::from_millis(50)).await;
        }
        said
    });
    let heard = Arc::new(Mutex::new(Vec::new()));
    let hearing = heard.clone();
    let listening = tokio::spawn(async move {
        while stops.recv().await.is_some() {
            hearing.lock().expect("whole").push(Instant::now());
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
    is_over.store(true, Ordering::SeqCst);
    let said = said.await.expect("no panic");
    sleep(Duration::from_millis(500)).await;
    listening.abort();
    let heard = heard.lock().expect("whole").clone();
    assert_eq!(said.len(), heard.len(), "each arrived");
    let mut late: Vec<_> = said
        .iter()
        .zip(&heard)
        .map(|(said, heard)| *heard - *said)
        .collect();
    late.sort();
    let (typical, most) = (late[late.len() / 2], late[late.len() * 99 / 100]);
    let part = raw.as_secs_f64() / took.as_secs_f64();
    println!(
        "{} bytes: one put {raw:?}, transfer {took:?} with 20 urgent messages a second ({part:.2} of the put); urgent p50 \
         {typical:?} p99 {most:?} of {}",
        bytes.len(),
        late.len()
    );
    for _ in 0..2 {
        assert!(received.next().await.expect("open").is_ok());
    }
    // Without the urgent messages, and of a megabyte, it is 0.93; the beginning takes 0.2 s.
    assert!(part > 0.8, "{part}");
    assert!(most < Duration::from_millis(250), "{most:?}");
}

#[test]
fn a_transfer_goes_on_after_the_radio_was_cut() {
    let air = Air::new();
    run(cut(&air));
}

async fn cut(air: &Air) {
    let pair = pair(air).await;
    let received = receiving(&pair.other).await;
    let bytes = noise(200_000);
    let held = Arc::new(AtomicU64::new(0));
    let told = held.clone();
    let sent = pair
        .one
        .transfer("wombat-2", "map", bytes.clone())
        .expect("named");
    let sent = sent.on_progress(move |progress| told.store(progress.held_bytes, Ordering::SeqCst));
    let sent = tokio::spawn(sent.into_future());
    for part in 1..4 {
        let there = async {
            while held.load(Ordering::SeqCst) < part * 50_000 {
                sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(DEADLINE, there).await.expect("in time");
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

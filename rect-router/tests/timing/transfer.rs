//! Tests of transfers between programs of two robots that are linked over the simulated air:
//! `cargo test -p rect-router --test timing transfer`

use std::{
    cell::{Cell, RefCell},
    future::{Future, IntoFuture},
    pin::pin,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use crate::support::{joined, simulated, Air, Router, DEADLINE};
use rect::{ReceiveOptions, Robot, Subscriber, Transfer, Transfers};
use tokio::time::{sleep, timeout};

/// The least throughput of a transfer, as a share of that of a publication of the same size. It is 0.93 for one megabyte without
/// urgent messages; the start of a transfer takes 0.2 s.
const LEAST_SHARE: f64 = 0.8;
/// How many times a transfer is measured at most.
const ROUNDS: usize = 3;

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
    let (stops, puts) = (
        pair.other.subscribe("wombat-1/stop"),
        pair.other.subscribe("wombat-1/put"),
    );
    let (stops, puts) = (
        stops.await.expect("subscribed"),
        puts.await.expect("subscribed"),
    );
    // A small transfer first, after which all links and routes exist.
    let first = pair.one.transfer("wombat-2", "first", vec![1]);
    sent(first.expect("named"), DEADLINE).await;
    assert!(received.next().await.expect("open").is_ok());
    // Other programs of this computer may slow a round, but not each of them.
    let mut shares = Vec::new();
    for _ in 0..ROUNDS {
        let (share, p99) = round(&pair, &stops, &puts).await;
        assert!(received.next().await.expect("open").is_ok());
        assert!(p99 < Duration::from_millis(250), "{p99:?}");
        shares.push(share);
        if share > LEAST_SHARE {
            return;
        }
    }
    panic!("{shares:?}");
}

async fn sent(transfer: Transfer, limit: Duration) {
    let sent = timeout(limit, transfer.into_future()).await;
    sent.expect("in time").expect("sent");
}

/// Transfers a file while urgent messages are sent. Returns the transfer's throughput as a share of that of a publication of the
/// same size, and the time within which 99 of 100 urgent messages arrived.
async fn round(pair: &Pair, stops: &Subscriber, puts: &Subscriber) -> (f64, Duration) {
    let bytes = noise(300_000);
    let bulk = pair.one.bulk();
    let start = Instant::now();
    bulk.publish("put", &bytes[..]).await.expect("published");
    let put = timeout(DEADLINE * 2, puts.next()).await.expect("in time");
    put.expect("open");
    let raw = start.elapsed();

    let (start, is_finished) = (Instant::now(), Cell::new(false));
    let transfer = pair.one.transfer("wombat-2", "large", bytes.clone());
    let transferring = async {
        sent(transfer.expect("named"), DEADLINE * 2).await;
        is_finished.set(true);
        start.elapsed()
    };
    let urgent = pair.one.urgent();
    let publishing = async {
        let mut published = Vec::new();
        while !is_finished.get() {
            published.push(Instant::now());
            let number = [published.len() as u8; 16];
            urgent.publish("stop", number).await.expect("published");
            sleep(Duration::from_millis(50)).await;
        }
        published
    };
    let arrived = RefCell::new(Vec::new());
    let receiving = async {
        while stops.next().await.is_some() {
            arrived.borrow_mut().push(Instant::now());
        }
    };
    let mut receiving = pin!(receiving);
    let (took, published) = tokio::select! {
        done = async { tokio::join!(transferring, publishing) } => done,
        () = &mut receiving => panic!("closed"),
    };
    // The last messages may still be on the way.
    let _ = timeout(Duration::from_millis(500), receiving).await;
    let arrived = arrived.take();
    assert_eq!(published.len(), arrived.len(), "each message arrived");
    let arrivals = published.iter().zip(&arrived);
    let mut ages: Vec<_> = arrivals.map(|(sent, arrived)| *arrived - *sent).collect();
    ages.sort();
    let (p50, p99) = (ages[ages.len() / 2], ages[ages.len() * 99 / 100]);
    let share = raw.as_secs_f64() / took.as_secs_f64();
    println!(
        "{} bytes: one put {raw:?}, transfer {took:?} with 20 urgent messages per second ({share:.2} of the put); urgent p50 \
         {p50:?} p99 {p99:?} of {}",
        bytes.len(),
        ages.len()
    );
    (share, p99)
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
    assert_eq!(
        got.content,
        rect_core::storage::Content::Bytes(bytes.into())
    );
}

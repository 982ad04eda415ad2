//! Tests publishing over a link that takes no more data: `cargo test -p rect-robot --test behaviour blocked_link`
use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    sync::{
        atomic::{AtomicBool, AtomicU32, Ordering},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use rect::{Payload, QueueOptions, WhenFull};
use tokio::runtime::Builder;

use crate::pair::{dialling, free_endpoint, listening, pair, TIMEOUT};

/// Relays one connection to `endpoint`, and reads nothing while `is_stopped`. Returns the endpoint to dial.
fn relay(endpoint: &str, is_stopped: &Arc<AtomicBool>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let dialled = format!("tcp/{}", listener.local_addr().expect("bound"));
    let target = endpoint.trim_start_matches("tcp/").to_owned();
    let is_stopped = is_stopped.clone();
    thread::spawn(move || {
        let (dialler, _) = listener.accept().expect("a connection");
        let target = TcpStream::connect(target).expect("connected");
        let ends = [&dialler, &target].map(|end| end.try_clone().expect("cloned"));
        let [from_dialler, from_target] = ends;
        let is_stopped_too = is_stopped.clone();
        thread::spawn(move || copy(from_dialler, target, &is_stopped_too));
        copy(from_target, dialler, &is_stopped);
    });
    dialled
}

fn copy(mut from: TcpStream, mut to: TcpStream, is_stopped: &AtomicBool) {
    let mut buffer = [0; 4096];
    while let Ok(length @ 1..) = from.read(&mut buffer) {
        while is_stopped.load(Ordering::Acquire) {
            thread::sleep(Duration::from_millis(5));
        }
        if to.write_all(&buffer[..length]).is_err() {
            return;
        }
    }
}

#[test]
fn publishing_on_a_blocked_link_does_not_block_other_tasks() {
    let runtime = Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .expect("a runtime");
    let is_stopped = Arc::new(AtomicBool::new(false));
    let (published, ticks) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let robots = runtime.block_on(async {
        let endpoint = free_endpoint();
        let a = listening("a", &endpoint).await;
        let b = dialling("b", &relay(&endpoint, &is_stopped)).await;
        let subscriber = b.subscribe::<Payload>("a/x").await.expect("subscribed");
        let publisher = a.publisher("x").await.expect("declared");
        let subscribed = publisher.wait_for_subscriber(TIMEOUT).await;
        subscribed.expect("established");
        is_stopped.store(true, Ordering::Release);
        (a, b, subscriber, publisher)
    });
    let publisher = robots.3;
    let count = published.clone();
    runtime.spawn(async move {
        while publisher.publish(&[7; 1000][..]).await.is_ok() {
            count.fetch_add(1, Ordering::AcqRel);
        }
    });
    let count = ticks.clone();
    runtime.spawn(async move {
        loop {
            tokio::time::sleep(Duration::from_millis(5)).await;
            count.fetch_add(1, Ordering::AcqRel);
        }
    });
    // Until the link takes no more.
    let deadline = Instant::now() + TIMEOUT;
    let mut before = u32::MAX;
    while before != published.load(Ordering::Acquire) && Instant::now() < deadline {
        before = published.load(Ordering::Acquire);
        thread::sleep(Duration::from_secs(1));
    }
    let ticks_before = ticks.load(Ordering::Acquire);
    thread::sleep(Duration::from_millis(500));
    let ticked = ticks.load(Ordering::Acquire) - ticks_before;
    // The runtime could not end while a thread waits.
    is_stopped.store(false, Ordering::Release);
    runtime.shutdown_background();
    assert!(before > 0, "nothing was published");
    assert!(ticked > 10, "another task ran only {ticked} times");
}

#[tokio::test(flavor = "multi_thread")]
async fn messages_of_several_tasks_arrive_in_the_order_of_their_numbers() {
    const EACH: u32 = 200;
    let (a, b) = pair("a", "b").await;
    let every_message = QueueOptions {
        capacity: 10_000,
        when_full: WhenFull::Block,
    };
    let subscriber = b.subscribe_with::<Payload>("a/x", every_message).await;
    let subscriber = subscriber.expect("subscribed");
    let publisher = Arc::new(a.publisher::<Payload>("x").await.expect("declared"));
    let subscribed = publisher.wait_for_subscriber(TIMEOUT).await;
    subscribed.expect("established");
    let publishing = |size: usize| {
        let publisher = publisher.clone();
        async move {
            for _ in 0..EACH {
                let payload = vec![7u8; size];
                publisher.publish(&payload).await.expect("published");
            }
        }
    };
    // Tasks on workers, one with large payloads, and this one, which is on a thread of its own.
    let tasks = [10, 100_000, 1000].map(|size| tokio::spawn(publishing(size)));
    publishing(10).await;
    for task in tasks {
        task.await.expect("no panic");
    }
    let mut last = None;
    for _ in 0..4 * EACH {
        let message = tokio::time::timeout(TIMEOUT, subscriber.next()).await;
        let message = message.expect("in time").expect("open");
        assert_eq!(message.missed, 0);
        assert!(
            last < message.sequence,
            "{last:?}, then {:?}",
            message.sequence
        );
        last = message.sequence;
    }
}

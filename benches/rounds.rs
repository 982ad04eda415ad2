//! Measures the latency from publishing to a callback, and the messages per second, of the Rust library, with two robots in one
//! process that are linked over TCP. `cpp/rounds.cpp` measures the same in C++, and `cpp.py` compares them. With the argument
//! `typed`, the values of the subscription have a type.
use std::{
    net::TcpListener,
    sync::{
        atomic::{AtomicU64, Ordering::SeqCst},
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
    },
    time::{Duration, Instant},
};

use rect::{
    blocking::Robot, Encoding, Error, FromPayload, Options, Payload, QueueOptions, WhenFull,
};
use serde::Deserialize;

const TEXT: &str = r#"{"angle_deg":12.5,"ok":true,"robot":"wombat-1","volt":7.2}"#;
/// The value of `TEXT`.
#[derive(Deserialize)]
#[allow(dead_code, reason = "only the conversion is measured")]
struct Reading {
    angle_deg: f64,
    ok: bool,
    robot: String,
    volt: f64,
}

const ROUNDS: usize = 1000;
const MESSAGES: u64 = 20_000;
const RETRY_INTERVAL: Duration = Duration::from_millis(50);
const DEADLINE: Duration = Duration::from_secs(60);

/// Counts, and wakes the waiting thread at the expected count. It does nothing else, because its time is in the figures.
#[derive(Default)]
struct Counter {
    count: AtomicU64,
    expected: AtomicU64,
    reached_at: Mutex<Option<Instant>>,
    reached: Condvar,
}

impl Counter {
    fn add(&self) {
        if self.count.fetch_add(1, SeqCst) + 1 == self.expected.load(SeqCst) {
            let now = Instant::now();
            *self.reached_at() = Some(now);
            self.reached.notify_one();
        }
    }

    /// Expects `more` counts from now on.
    fn expect_more(&self, more: u64) {
        let mut reached_at = self.reached_at();
        *reached_at = None;
        self.expected.store(self.count.load(SeqCst) + more, SeqCst);
    }

    /// Waits for the expected count, and returns the time at which it was reached, or `None` after `time`.
    fn wait(&self, time: Duration) -> Option<Instant> {
        let is_none = |reached_at: &mut Option<Instant>| reached_at.is_none();
        let waited = self
            .reached
            .wait_timeout_while(self.reached_at(), time, is_none);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }

    fn reached_at(&self) -> MutexGuard<'_, Option<Instant>> {
        self.reached_at
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

fn main() -> Result<(), Error> {
    match std::env::args().nth(1).as_deref() {
        Some("typed") => measure::<Reading>(),
        _ => measure::<Payload>(),
    }
}

fn measure<T: FromPayload>() -> Result<(), Error> {
    let value = Payload::new(TEXT, Encoding::JSON);
    let port = TcpListener::bind("127.0.0.1:0").and_then(|probe| probe.local_addr());
    let endpoint = format!("tcp/{}", port.expect("a free port"));
    let options = |name| Ok::<_, Error>(Options::new(name)?.login_file("/none"));
    let one = Robot::connect(options("wombat-1")?.listen(&endpoint))?;
    let two = Robot::connect(options("wombat-2")?.endpoint(&endpoint))?;
    // The C++ program waits in the same way: a query sets a timer in Zenoh, which makes each wake-up of its thread slower for
    // some time.
    while one.peers()?.is_empty() || two.peers()?.is_empty() {}

    let received = Arc::new(Counter::default());
    let queue = QueueOptions {
        capacity: 1 << 16,
        when_full: WhenFull::Block,
    };
    let called = received.clone();
    let _subscription = two.on_message_with::<T>("wombat-1/n", queue, move |message| {
        assert!(message.value.is_ok());
        called.add();
    })?;
    received.expect_more(1);
    one.publish("n", &value)?;
    while received.wait(RETRY_INTERVAL).is_none() {
        one.publish("n", &value)?;
    }

    let mut took = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        received.expect_more(1);
        let began = Instant::now();
        one.publish("n", &value)?;
        took.push(received.wait(DEADLINE).expect("a message did not arrive") - began);
    }
    took.sort_unstable();
    received.expect_more(MESSAGES);
    let began = Instant::now();
    for _ in 0..MESSAGES {
        one.publish("n", &value)?;
    }
    let took_all = received.wait(DEADLINE).expect("not all messages arrived") - began;
    let per_s = MESSAGES as f64 / took_all.as_secs_f64();
    let p50_us = took[ROUNDS / 2].as_secs_f64() * 1e6;
    println!("{{\"p50_us\": {p50_us}, \"messages_per_s\": {per_s}}}");
    Ok(())
}

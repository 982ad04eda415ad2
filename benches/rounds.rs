//! What the Rust library takes to call back with a message, and how many it carries; `cpp/rounds.cpp` is the same in C++, and
//! `cpp.py` compares them. Two robots in one process, linked over TCP.
use std::{
    net::TcpListener,
    sync::{
        atomic::{AtomicU64, Ordering::SeqCst},
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
    },
    time::{Duration, Instant},
};

use rect::{blocking::Robot, Error, Options, Receiving, WhenFull};

const TEXT: &str = r#"{"angle_deg":12.5,"ok":true,"robot":"wombat-1","volt":7.2}"#;
const ROUNDS: usize = 1000;
const MESSAGES: u64 = 20_000;
const PATIENCE: Duration = Duration::from_millis(50);
const DEADLINE: Duration = Duration::from_secs(60);

/// Counts, and wakes who waits once there are as many as wanted: what more it did would be in the library's figures.
#[derive(Default)]
struct Counter {
    count: AtomicU64,
    wanted: AtomicU64,
    reached_at: Mutex<Option<Instant>>,
    reached: Condvar,
}

impl Counter {
    fn add(&self) {
        if self.count.fetch_add(1, SeqCst) + 1 == self.wanted.load(SeqCst) {
            let now = Instant::now();
            *self.reached_at() = Some(now);
            self.reached.notify_one();
        }
    }

    /// So many more, from now on.
    fn want(&self, more: u64) {
        let mut reached_at = self.reached_at();
        *reached_at = None;
        self.wanted.store(self.count.load(SeqCst) + more, SeqCst);
    }

    /// When they were there, if that was in time.
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
    let port = TcpListener::bind("127.0.0.1:0").and_then(|probe| probe.local_addr());
    let endpoint = format!("tcp/{}", port.expect("a free port"));
    let options = |name| Ok::<_, Error>(Options::new(name)?.login_file("/none"));
    let one = Robot::join(options("wombat-1")?.listen(&endpoint))?;
    let two = Robot::join(options("wombat-2")?.endpoint(&endpoint))?;
    // As the C++ program does: what is asked sets a timer in Zenoh, which each wake-up of its thread pays for a while.
    while one.peers()?.is_empty() || two.peers()?.is_empty() {}

    let heard = Arc::new(Counter::default());
    let receiving = Receiving {
        capacity: 1 << 16,
        when_full: WhenFull::Wait,
    };
    let called = heard.clone();
    let _subscription = two.on_message_with("wombat-1/n", receiving, move |_| called.add())?;
    heard.want(1);
    one.publish("n", TEXT)?;
    while heard.wait(PATIENCE).is_none() {
        one.publish("n", TEXT)?;
    }

    let mut took = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        heard.want(1);
        let began = Instant::now();
        one.publish("n", TEXT)?;
        took.push(heard.wait(DEADLINE).expect("a message does not arrive") - began);
    }
    took.sort_unstable();
    heard.want(MESSAGES);
    let began = Instant::now();
    for _ in 0..MESSAGES {
        one.publish("n", TEXT)?;
    }
    let took_all = heard.wait(DEADLINE).expect("not all messages arrive") - began;
    let per_s = MESSAGES as f64 / took_all.as_secs_f64();
    let p50_us = took[ROUNDS / 2].as_secs_f64() * 1e6;
    println!("{{\"p50_us\": {p50_us}, \"messages_per_s\": {per_s}}}");
    Ok(())
}

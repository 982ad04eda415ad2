//! What the Rust library takes to call back with a message, and how many it carries; `cpp/rounds.cpp` is the same in C++, and
//! `cpp.py` compares them. Two robots in one process, linked over TCP.
use std::{
    net::TcpListener,
    sync::{Arc, Condvar, Mutex, PoisonError},
    time::{Duration, Instant},
};

use rect::{blocking::Robot, Error, Options, Receiving, WhenFull};

const TEXT: &str = r#"{"angle_deg":12.5,"ok":true,"robot":"wombat-1","volt":7.2}"#;
const ROUNDS: usize = 1000;
const MESSAGES: u64 = 20_000;
const PATIENCE: Duration = Duration::from_millis(50);

/// Counts, and wakes who waits for a count.
#[derive(Default)]
struct Counter {
    count: Mutex<u64>,
    changed: Condvar,
}

impl Counter {
    fn add(&self) {
        *self.count.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        self.changed.notify_one();
    }

    fn now(&self) -> u64 {
        *self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there were as many in time.
    fn wait(&self, wanted: u64, time: Duration) -> bool {
        let count = self.count.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self
            .changed
            .wait_timeout_while(count, time, |count| *count < wanted);
        *waited.unwrap_or_else(PoisonError::into_inner).0 >= wanted
    }
}

fn main() -> Result<(), Error> {
    let port = TcpListener::bind("127.0.0.1:0").and_then(|probe| probe.local_addr());
    let endpoint = format!("tcp/{}", port.expect("a free port"));
    let options = |name| Ok::<_, Error>(Options::new(name)?.login_file("/none"));
    let one = Robot::join(options("wombat-1")?.listen(&endpoint))?;
    let two = Robot::join(options("wombat-2")?.endpoint(&endpoint))?;

    let heard = Arc::new(Counter::default());
    let receiving = Receiving {
        capacity: 1 << 16,
        when_full: WhenFull::Wait,
    };
    let messages = two.subscribe_with("wombat-1/n", receiving)?;
    // A callback on a thread of its own, as C++ has it.
    std::thread::spawn({
        let heard = heard.clone();
        move || messages.for_each(|_| heard.add())
    });
    loop {
        one.publish("n", TEXT)?;
        if heard.wait(1, PATIENCE) {
            break;
        }
    }

    let mut took = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let (before, began) = (heard.now(), Instant::now());
        one.publish("n", TEXT)?;
        assert!(heard.wait(before + 1, Duration::from_secs(60)));
        took.push(began.elapsed());
    }
    took.sort_unstable();
    let (before, began) = (heard.now(), Instant::now());
    for _ in 0..MESSAGES {
        one.publish("n", TEXT)?;
    }
    assert!(heard.wait(before + MESSAGES, Duration::from_secs(60)));
    let per_s = MESSAGES as f64 / began.elapsed().as_secs_f64();
    let p50_us = took[ROUNDS / 2].as_secs_f64() * 1e6;
    println!("{{\"p50_us\": {p50_us}, \"messages_per_s\": {per_s}}}");
    Ok(())
}

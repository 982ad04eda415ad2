//! What the Rust library takes to call back with a message, and how many it carries; `cpp/rounds.cpp` is the same in C++, and
//! `cpp.py` compares them. Two robots in one process, linked over TCP.
use std::{
    net::TcpListener,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use rect::{blocking::Robot, Error, Options, Receiving, WhenFull};

const TEXT: &str = r#"{"angle_deg":12.5,"ok":true,"robot":"wombat-1","volt":7.2}"#;
const ROUNDS: usize = 1000;
const MESSAGES: u64 = 20_000;
const PATIENCE: Duration = Duration::from_millis(50);
const DEADLINE: Duration = Duration::from_secs(60);

/// Counts, and wakes who waits for a count once it is reached: what the waking takes is not the library's.
#[derive(Default)]
struct Counter {
    state: Mutex<State>,
    reached: Condvar,
}

#[derive(Default)]
struct State {
    count: u64,
    wanted: u64,
    /// When it counted last.
    at: Option<Instant>,
}

impl Counter {
    fn add(&self) {
        let now = Instant::now();
        let mut state = self.state();
        state.count += 1;
        state.at = Some(now);
        let is_reached = state.count == state.wanted;
        drop(state);
        if is_reached {
            self.reached.notify_one();
        }
    }

    fn now(&self) -> u64 {
        self.state().count
    }

    /// When there were as many, if that was in time.
    fn wait(&self, wanted: u64, time: Duration) -> Option<Instant> {
        let mut state = self.state();
        state.wanted = wanted;
        let is_less = |state: &mut State| state.count < wanted;
        let waited = self.reached.wait_timeout_while(state, time, is_less);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        state.at.filter(|_| state.count >= wanted)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
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
    let called = heard.clone();
    let _subscription = two.on_message_with("wombat-1/n", receiving, move |_| called.add())?;
    loop {
        one.publish("n", TEXT)?;
        if heard.wait(1, PATIENCE).is_some() {
            break;
        }
    }

    let mut took = Vec::with_capacity(ROUNDS);
    for _ in 0..ROUNDS {
        let (before, began) = (heard.now(), Instant::now());
        one.publish("n", TEXT)?;
        let called = heard.wait(before + 1, DEADLINE);
        took.push(called.expect("a message does not arrive") - began);
    }
    took.sort_unstable();
    let (before, began) = (heard.now(), Instant::now());
    for _ in 0..MESSAGES {
        one.publish("n", TEXT)?;
    }
    let called = heard.wait(before + MESSAGES, DEADLINE);
    let took_all = called.expect("not all messages arrive") - began;
    let per_s = MESSAGES as f64 / took_all.as_secs_f64();
    let p50_us = took[ROUNDS / 2].as_secs_f64() * 1e6;
    println!("{{\"p50_us\": {p50_us}, \"messages_per_s\": {per_s}}}");
    Ok(())
}

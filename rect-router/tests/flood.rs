//! A flood of small messages over a slow link delays the next message of its priority by little, and other priorities
//! not at all: `cargo test -p rect-router --test flood`
mod support;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use support::{arrives, client, client_with, simulated, Air, Router, DEADLINE};
use zenoh::{
    qos::{CongestionControl, Priority},
    Wait,
};
use zenoh_link::ble::radio::sim::{AirOptions, LlPayload};

/// How long a program floods: at a few megabytes a second, much longer than the link takes to send it.
const FLOOD: Duration = Duration::from_secs(4);
/// How long an urgent message may take, on a machine that is busy with six floods.
const URGENT: Duration = Duration::from_millis(1500);
/// How long the next message of the same priority may take.
const NEXT: Duration = Duration::from_millis(2500);

/// Two linked robots on an air as slow as a Raspberry Pi 3B's, and where the programs of each reach their router.
struct Pair {
    _routers: [Router; 2],
    here: String,
    there: String,
    _air: Air,
}

impl Pair {
    fn start() -> Self {
        let air = Air::with(AirOptions {
            pdu: LlPayload::Bytes27,
            ..AirOptions::default()
        });
        let (one, here) = simulated(&air, 1, &[]);
        let (two, there) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
        Self {
            _routers: [one, two],
            here,
            there,
            _air: air,
        }
    }
}

/// A program that publishes 128 bytes over and over, as fast as its router takes them.
struct Flood(Arc<AtomicBool>);

impl Flood {
    fn start(router: &str) -> Self {
        // By default a client that has waited for its router for 5 s gives the router up.
        const WAIT: &str = "transport/link/tx/queue/congestion_control/block/wait_before_close";
        let session = client_with(router, &[(WAIT, "60000000")]).expect("a session");
        let is_over = Arc::new(AtomicBool::new(false));
        let over = Arc::clone(&is_over);
        // Not joined: at the end of the test it may still wait for the router.
        thread::spawn(move || {
            let publisher = session.declare_publisher("rect/wombat-1/flood");
            let publisher = publisher.congestion_control(CongestionControl::Block);
            let publisher = publisher.wait().expect("a publisher");
            while !over.load(Ordering::Relaxed) && publisher.put([7; 128]).wait().is_ok() {}
        });
        Self(is_over)
    }

    /// Publishes no more. What the program's connection to its router holds still follows.
    fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Arrival of another program's messages during a flood.
struct Outcome {
    /// How long each took that was published during the flood.
    during: Vec<Duration>,
    /// How long the one took that was published right after it; `None`: it did not arrive within [`DEADLINE`].
    after: Option<Duration>,
}

/// Lets that many programs of robot 1 flood the link, while another one publishes messages of that priority, one after
/// the other.
fn beside_floods(programs: usize, priority: Priority) -> Outcome {
    let pair = Pair::start();
    let (from, to) = (client(&pair.here), client(&pair.there));
    // It takes what arrives at once: one that does not would hold up the whole program.
    let flooded = to.declare_subscriber("rect/wombat-1/flood");
    let _flooded = flooded.callback(|_| {}).wait().expect("subscribed");
    let key = "rect/wombat-1/next";
    assert!(arrives(&from, &to, key), "the robots are linked");
    let arrived = to.declare_subscriber(key).wait().expect("subscribed");
    assert!(
        arrives(&from, &to, "rect/wombat-1/ready"),
        "the subscriptions are known"
    );
    let next = || {
        let published = Instant::now();
        let put = from.put(key, "next").priority(priority);
        put.congestion_control(CongestionControl::Block)
            .wait()
            .expect("published");
        let sample = arrived.recv_timeout(DEADLINE).expect("a session");
        sample.map(|_| published.elapsed())
    };
    assert!(next().is_some(), "nothing else is under way");

    let floods: Vec<_> = (0..programs).map(|_| Flood::start(&pair.here)).collect();
    let (begun, mut during) = (Instant::now(), Vec::new());
    while begun.elapsed() < FLOOD {
        during.extend(next());
        thread::sleep(Duration::from_millis(50));
    }
    for flood in &floods {
        flood.stop();
    }
    let after = next();
    println!("{programs} floods, {priority:?}: {during:?} during, {after:?} after");
    Outcome { during, after }
}

#[test]
fn next_message_of_the_same_priority_arrives_soon_after_a_flood() {
    let outcome = beside_floods(1, Priority::Data);
    assert!(
        outcome.after.is_some_and(|after| after < NEXT),
        "{:?}",
        outcome.after
    );
}

#[test]
fn urgent_messages_arrive_at_once_while_six_programs_flood() {
    let outcome = beside_floods(6, Priority::RealTime);
    let slow = outcome.during.iter().filter(|took| **took > URGENT).count();
    // A busy machine may hold up one of them.
    assert!(slow * 20 <= outcome.during.len(), "{:?}", outcome.during);
    assert!(
        outcome.after.is_some_and(|after| after < URGENT),
        "{:?}",
        outcome.after
    );
}

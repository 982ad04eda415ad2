//! Tests that a flood of messages over a slow link delays the next message of its priority only briefly, and other
//! priorities not at all: `cargo test -p rect-router --test timing flood`
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use crate::support::{arrives, client, client_with, simulated, Air, Router, DEADLINE};
use zenoh::{
    qos::{CongestionControl, Priority},
    Wait,
};
use zenoh_link_ble_air::{AirOptions, LlPayload};

/// Duration of the flood. At a few megabytes per second, the link would need much longer to send it.
const FLOOD: Duration = Duration::from_secs(4);
/// Maximum delay of an urgent message on a machine that is busy with six floods.
const URGENT: Duration = Duration::from_millis(1500);
/// Maximum delay of the next message of the same priority.
const NEXT: Duration = Duration::from_millis(2500);

/// Two linked robots on an air as slow as a Raspberry Pi 3B's radio, with the endpoints of their routers.
struct Pair {
    _routers: [Router; 2],
    local: String,
    remote: String,
    _air: Air,
}

impl Pair {
    fn start() -> Self {
        let air = Air::with(AirOptions {
            pdu: LlPayload::Bytes27,
            ..AirOptions::default()
        });
        let (one, local) = simulated(&air, 1, &[]);
        let (two, remote) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
        Self {
            _routers: [one, two],
            local,
            remote,
            _air: air,
        }
    }
}

/// A program that publishes messages of one size as fast as its router accepts them.
struct Flood(Arc<AtomicBool>);

impl Flood {
    fn start(router: &str, message_bytes: usize) -> Self {
        // By default a client closes its session if its router accepts no message for 5 s.
        const WAIT: &str = "transport/link/tx/queue/congestion_control/block/wait_before_close";
        let session = client_with(router, &[(WAIT, "60000000")]).expect("a session");
        let is_finished = Arc::new(AtomicBool::new(false));
        let finished = Arc::clone(&is_finished);
        // The thread is not joined, because it may still wait for the router at the end of the test.
        thread::spawn(move || {
            let publisher = session.declare_publisher("rect/wombat-1/flood");
            let publisher = publisher.congestion_control(CongestionControl::Block);
            let publisher = publisher.wait().expect("a publisher");
            while !finished.load(Ordering::Relaxed)
                && publisher.put(vec![7; message_bytes]).wait().is_ok()
            {}
        });
        Self(is_finished)
    }

    /// Stops publishing. Messages that are queued in the program's session are still sent.
    fn stop(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The delays of another program's messages.
struct Outcome {
    /// Delays of the messages published during the flood.
    during: Vec<Duration>,
    /// Delay of the message published right after it; `None` if it did not arrive within [`DEADLINE`].
    after: Option<Duration>,
}

/// Lets `programs` programs of robot 1 flood the link with messages of a size while another one publishes messages of `priority`, one
/// after the other.
fn beside_floods(programs: usize, message_bytes: usize, priority: Priority) -> Outcome {
    let pair = Pair::start();
    let (from, to) = (client(&pair.local), client(&pair.remote));
    // The callback discards messages at once: a full queue would block the whole session.
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
    assert!(next().is_some(), "a message arrives without a flood");

    let floods: Vec<_> = (0..programs)
        .map(|_| Flood::start(&pair.local, message_bytes))
        .collect();
    let (begun, mut during) = (Instant::now(), Vec::new());
    while begun.elapsed() < FLOOD {
        during.extend(next());
        thread::sleep(Duration::from_millis(50));
    }
    for flood in &floods {
        flood.stop();
    }
    let after = next();
    println!("{programs} floods of {message_bytes} bytes, {priority:?}: {during:?} during, {after:?} after");
    Outcome { during, after }
}

#[test]
fn a_message_of_the_same_priority_arrives_soon_after_a_flood() {
    let outcome = beside_floods(1, 128, Priority::Data);
    assert!(
        outcome.after.is_some_and(|after| after < NEXT),
        "{:?}",
        outcome.after
    );
}

/// Large messages have a lane of their own (`qos/network`), so that normal messages do not wait for them.
#[test]
fn a_message_of_the_same_priority_arrives_soon_after_a_flood_of_large_ones() {
    let outcome = beside_floods(1, 100_000, Priority::Data);
    assert!(!outcome.during.is_empty());
    for took in outcome.during.into_iter().chain(outcome.after) {
        assert!(took < NEXT, "{took:?}");
    }
}

#[test]
fn urgent_messages_arrive_at_once_while_six_programs_flood() {
    let outcome = beside_floods(6, 128, Priority::RealTime);
    let slow = outcome.during.iter().filter(|took| **took > URGENT).count();
    // A busy machine may delay some of them.
    assert!(slow * 20 <= outcome.during.len(), "{:?}", outcome.during);
    assert!(
        outcome.after.is_some_and(|after| after < URGENT),
        "{:?}",
        outcome.after
    );
}

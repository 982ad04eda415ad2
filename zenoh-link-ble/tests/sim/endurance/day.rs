//! Tests two robots with little traffic and many radio faults for 24 hours of virtual time.
use std::{cell::Cell, time::Duration};

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};
use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble_air::Condition;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use crate::shared::{
    heap::live_bytes,
    pair::{Pair, RECONNECT_LIMIT, SUPERVISION},
};

const HOURS: u32 = 24;
const HOUR: Duration = Duration::from_secs(3600);
/// Interval of Zenoh's keep-alive: a quarter of its lease of 10 s.
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
/// Initial pause between dials, from `config/robot.json5`. Zenoh doubles it after each failure, up to `LONGEST_RETRY`.
const RETRY: Duration = Duration::from_millis(200);
const LONGEST_RETRY: Duration = Duration::from_secs(1);
/// Allowed growth of the heap in bytes: less than one byte per reconnect.
const SLACK: isize = 1_024;

/// Two robots, and the statistics of their links.
struct Robots {
    pair: Pair,
    /// Time since which both are on and in range; `None` during a fault.
    reachable_since: Cell<Option<Instant>>,
    /// Time since which both sides know that there is no link; `None` while there is one.
    apart_since: Cell<Option<Instant>>,
    /// Whether a fault occurred since the link was established.
    fault_occurred: Cell<bool>,
    links: Cell<u32>,
    batches: Cell<u64>,
    /// Longest duration of a dial to a reachable peer.
    slowest_dial: Cell<Duration>,
    /// Longest time without a link while both robots were reachable, including Zenoh's pause between dials.
    longest_apart: Cell<Duration>,
}

impl Robots {
    /// Dials as Zenoh does, and exchanges batches until the link ends; repeats forever.
    async fn stay_linked(&self) {
        let mut wait = RETRY;
        loop {
            let dialling_since = Instant::now();
            let Ok(near) = self.pair.near.dial("ble/far").await else {
                sleep(wait).await;
                wait = (2 * wait).min(LONGEST_RETRY);
                continue;
            };
            wait = RETRY;
            let Some(far) = self.other_end(&near).await else {
                continue;
            };
            self.on_linked(dialling_since);
            tokio::join!(self.talk(&near, &far), self.talk(&far, &near));
            assert!(self.fault_occurred.get(), "the link ended without a fault");
            self.apart_since.set(Some(Instant::now()));
        }
    }

    /// Returns the incoming link whose first batch came from `near`. Links that were lost during the handshake arrive
    /// before it.
    async fn other_end(&self, near: &LinkUnicast) -> Option<LinkUnicast> {
        let marker = near.get_src().as_str().as_bytes();
        near.write_all(marker, Some(Priority::Control)).await.ok()?;
        let finding = async {
            loop {
                let far = self.pair.far.incoming().await;
                let mut received = [0; 100];
                let read = far.read(&mut received, Some(Priority::Control)).await;
                if read.is_ok_and(|size| received[..size] == *marker) {
                    return far;
                }
            }
        };
        let mut nothing = [0; 100];
        tokio::select! {
            far = finding => Some(far),
            _ended = near.read(&mut nothing, Some(Priority::Control)) => None,
        }
    }

    fn on_linked(&self, dialling_since: Instant) {
        self.links.set(self.links.get() + 1);
        self.fault_occurred
            .set(self.reachable_since.get().is_none());
        let apart = self.apart_since.take();
        if let (Some(apart), Some(reachable)) = (apart, self.reachable_since.get()) {
            let since = apart.max(reachable);
            let longest = self.longest_apart.get().max(since.elapsed());
            self.longest_apart.set(longest);
            let slowest = since.max(dialling_since).elapsed();
            self.slowest_dial.set(self.slowest_dial.get().max(slowest));
        }
    }

    /// Sends batches in one direction until the link ends, and checks that they arrive in order.
    async fn talk(&self, from: &LinkUnicast, to: &LinkUnicast) {
        let size = |number: u32| 8 + (number as usize * 37) % 700;
        let sent = Cell::new(0_u32);
        let writing = async {
            loop {
                let mut batch = vec![7; size(sent.get())];
                batch[..4].copy_from_slice(&sent.get().to_le_bytes());
                let written = from.write_all(&batch, Some(Priority::Data)).await;
                if written.is_err() {
                    return;
                }
                sent.set(sent.get() + 1);
                sleep(KEEP_ALIVE).await;
            }
        };
        let reading = async {
            let mut buffer = [0; 1000];
            let mut received = 0_u32;
            while let Ok(got) = to.read(&mut buffer, Some(Priority::Data)).await {
                assert_eq!(buffer[..4], received.to_le_bytes(), "the next batch");
                assert_eq!(got, size(received));
                received += 1;
                // Everything sent before the last supervision timeout has arrived, unless the link has ended.
                let late = sent.get() - received;
                assert!(late <= 1, "{late} batches are missing");
            }
            self.batches.set(self.batches.get() + u64::from(received));
        };
        tokio::join!(writing, reading);
    }

    /// Runs one random fault from its start to its end.
    async fn run_fault(&self, rng: &mut Pcg32) {
        let air = &self.pair.air;
        let name = ["sim-near", "sim-far"][rng.next_u32() as usize % 2];
        let duration = Duration::from_millis(u64::from(rng.next_u32()) % 30_000);
        self.fault_occurred.set(true);
        self.reachable_since.set(None);
        match rng.next_u32() % 8 {
            0 => air.set_condition(Condition::EdgeOfRange),
            1 => air.set_condition(Condition::CrowdedHall),
            2 => air.cut(),
            // A short shadow, as behind a wall: about as long as the supervision timeout.
            3 | 4 => {
                air.cut();
                sleep(duration / 12).await;
                air.restore();
            }
            5 => air.power(name, false).expect("is attached"),
            6 => air.remove(name).expect("is attached"),
            _ => {
                air.power(name, false).expect("is attached");
                air.power(name, true).expect("is attached");
            }
        }
        sleep(duration).await;
        air.restore();
        air.set_condition(Condition::Room);
        for name in ["sim-near", "sim-far"] {
            air.power(name, true).expect("is attached");
        }
        self.reachable_since.set(Some(Instant::now()));
    }

    /// Runs faults for an hour, and checks that the robots are linked at the end.
    async fn run_hour(&self, rng: &mut Pcg32) {
        let start = Instant::now();
        while start.elapsed() < HOUR {
            sleep(Duration::from_millis(u64::from(rng.next_u32()) % 120_000)).await;
            self.run_fault(rng).await;
        }
        sleep(SUPERVISION + LONGEST_RETRY + RECONNECT_LIMIT).await;
        assert_eq!(self.apart_since.get(), None, "they are linked");
    }
}

#[tokio::test(start_paused = true)]
async fn two_robots_reconnect_after_every_fault_for_a_day() {
    let robots = Robots {
        pair: Pair::on(Condition::Room, 1).await,
        reachable_since: Cell::new(Some(Instant::now())),
        apart_since: Cell::new(Some(Instant::now())),
        fault_occurred: Cell::new(false),
        links: Cell::new(0),
        batches: Cell::new(0),
        slowest_dial: Cell::new(Duration::ZERO),
        longest_apart: Cell::new(Duration::ZERO),
    };
    let mut rng = Pcg32::seed_from_u64(24);
    let mut bytes = Vec::new();
    let day = async {
        for _ in 0..HOURS {
            robots.run_hour(&mut rng).await;
            bytes.push(live_bytes());
        }
    };
    let day = timeout(2 * HOURS * HOUR, day);
    tokio::select! {
        in_time = day => in_time.expect("the day ends in time"),
        () = robots.stay_linked() => unreachable!("they dial forever"),
    }
    println!(
        "{HOURS} h: {} links, {} batches; with a reachable peer, the slowest dial took {:?}; the longest time without a link was \
         {:?}; bytes on the heap after each hour: {bytes:?}",
        robots.links.get(),
        robots.batches.get(),
        robots.slowest_dial.get(),
        robots.longest_apart.get(),
    );
    assert!(robots.links.get() > 20 * HOURS, "enough faults occurred");
    assert!(robots.slowest_dial.get() <= RECONNECT_LIMIT);
    assert!(robots.longest_apart.get() <= RECONNECT_LIMIT + LONGEST_RETRY);
    let settled = bytes[..3].iter().max().expect("three hours");
    let last = bytes.last().expect("the last hour");
    assert!(*last <= settled + SLACK, "{bytes:?}");
}

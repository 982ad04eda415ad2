//! A day of two robots that say little, on a bad day for radios.
use std::{cell::Cell, time::Duration};

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};
use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble::radio::sim::Condition;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use crate::shared::{
    heap::live_bytes,
    pair::{Pair, BACK, SUPERVISION},
};

const HOURS: u32 = 24;
const HOUR: Duration = Duration::from_secs(3600);
/// Zenoh's keep-alive: a quarter of its lease of 10 s.
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
/// `config/robot.json5`: Zenoh dials again after so long, then after twice as long, up to a second.
const RETRY: Duration = Duration::from_millis(200);
const LONGEST_RETRY: Duration = Duration::from_secs(1);
/// The heap may grow by that: less than a byte for each reconnect.
const SLACK: isize = 1_024;

/// Two robots, and what became of them so far.
struct Robots {
    pair: Pair,
    /// Since when both are there and hear each other well enough; `None` while a fault lasts.
    reachable_since: Cell<Option<Instant>>,
    /// Since when there is no link, as both know; `None` while there is one.
    apart_since: Cell<Option<Instant>>,
    /// A fault has struck since the link was made.
    has_reason_to_end: Cell<bool>,
    links: Cell<u32>,
    batches: Cell<u64>,
    /// The longest that a dial took with a peer it could reach.
    slowest_dial: Cell<Duration>,
    /// The longest that two robots were apart which could reach each other; Zenoh's wait between dials comes in.
    longest_apart: Cell<Duration>,
}

impl Robots {
    /// Dials as Zenoh does, and talks as long as the link lives.
    async fn stay_linked(&self) {
        let mut wait = RETRY;
        loop {
            let dialling_since = Instant::now();
            let Ok(near) = self.pair.near.dials("ble/far").await else {
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
            assert!(self.has_reason_to_end.get(), "the link ended by itself");
            self.apart_since.set(Some(Instant::now()));
        }
    }

    /// The incoming link that brings what `near` says. Links that were lost while they were made come in before.
    async fn other_end(&self, near: &LinkUnicast) -> Option<LinkUnicast> {
        let word = near.get_src().as_str().as_bytes();
        near.write_all(word, Some(Priority::Control)).await.ok()?;
        let finding = async {
            loop {
                let far = self.pair.far.incoming().await;
                let mut heard = [0; 100];
                let read = far.read(&mut heard, Some(Priority::Control)).await;
                if read.is_ok_and(|size| heard[..size] == *word) {
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
        self.has_reason_to_end
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

    /// One direction: a batch now and then, each of which must be the next to arrive, until the link ends.
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
                assert_eq!(buffer[..4], received.to_le_bytes(), "the next one");
                assert_eq!(got, size(received));
                received += 1;
                // What was sent before the supervision timeout has come, or the link has ended.
                let late = sent.get() - received;
                assert!(late <= 1, "{late} batches are not there");
            }
            self.batches.set(self.batches.get() + u64::from(received));
        };
        tokio::join!(writing, reading);
    }

    /// A fault begins, lasts and is over.
    async fn suffer(&self, dice: &mut Pcg32) {
        let air = &self.pair.air;
        let name = ["sim-near", "sim-far"][dice.next_u32() as usize % 2];
        let lasts = Duration::from_millis(u64::from(dice.next_u32()) % 30_000);
        self.has_reason_to_end.set(true);
        self.reachable_since.set(None);
        match dice.next_u32() % 8 {
            0 => air.set_condition(Condition::EdgeOfRange),
            1 => air.set_condition(Condition::CrowdedHall),
            2 => air.cut(),
            // As behind a wall: about as long as the supervision timeout.
            3 | 4 => {
                air.cut();
                sleep(lasts / 12).await;
                air.restore();
            }
            5 => air.power(name, false).expect("is there"),
            6 => air.remove(name).expect("is there"),
            _ => {
                air.power(name, false).expect("is there");
                air.power(name, true).expect("is there");
            }
        }
        sleep(lasts).await;
        air.restore();
        air.set_condition(Condition::Room);
        for name in ["sim-near", "sim-far"] {
            air.power(name, true).expect("is there");
        }
        self.reachable_since.set(Some(Instant::now()));
    }

    /// Faults for an hour; in the end the two are linked.
    async fn an_hour(&self, dice: &mut Pcg32) {
        let start = Instant::now();
        while start.elapsed() < HOUR {
            sleep(Duration::from_millis(u64::from(dice.next_u32()) % 120_000)).await;
            self.suffer(dice).await;
        }
        sleep(SUPERVISION + LONGEST_RETRY + BACK).await;
        assert_eq!(self.apart_since.get(), None, "they are linked");
    }
}

#[tokio::test(start_paused = true)]
async fn two_robots_find_each_other_again_all_day_long() {
    let robots = Robots {
        pair: Pair::on(Condition::Room, 1).await,
        reachable_since: Cell::new(Some(Instant::now())),
        apart_since: Cell::new(Some(Instant::now())),
        has_reason_to_end: Cell::new(false),
        links: Cell::new(0),
        batches: Cell::new(0),
        slowest_dial: Cell::new(Duration::ZERO),
        longest_apart: Cell::new(Duration::ZERO),
    };
    let mut dice = Pcg32::seed_from_u64(24);
    let mut bytes = Vec::new();
    let day = async {
        for _ in 0..HOURS {
            robots.an_hour(&mut dice).await;
            bytes.push(live_bytes());
        }
    };
    let day = timeout(2 * HOURS * HOUR, day);
    tokio::select! {
        in_time = day => in_time.expect("a day has an end"),
        () = robots.stay_linked() => unreachable!("they never give up"),
    }
    println!(
        "{HOURS} h: {} links, {} batches; with a peer in reach the slowest dial took {:?}, the longest they were apart was \
         {:?}; bytes on the heap after each hour: {bytes:?}",
        robots.links.get(),
        robots.batches.get(),
        robots.slowest_dial.get(),
        robots.longest_apart.get(),
    );
    assert!(robots.links.get() > 20 * HOURS, "there were faults enough");
    assert!(robots.slowest_dial.get() <= BACK);
    assert!(robots.longest_apart.get() <= BACK + LONGEST_RETRY);
    let settled = bytes[..3].iter().max().expect("three hours");
    let last = bytes.last().expect("the last hour");
    assert!(*last <= settled + SLACK, "{bytes:?}");
}

//! Tests both ends of a link together, over simulated paths: `cargo test -p zenoh-link-any`
use std::time::Duration;

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

use super::{
    simulation::{Conversation, Quality, World, BLUETOOTH, NETWORK},
    *,
};
use crate::path::AckError;

const MS: Duration = Duration::from_millis(1);
const DATA: u8 = 5;

fn lane(number: u8) -> Lane {
    Lane::new(number).expect("valid")
}

fn primary_of(end: &Multipath) -> Option<Medium> {
    end.paths()
        .find(|(_, report)| report.is_primary)
        .map(|(_, report)| report.medium)
}

/// Runs a conversation in both directions for a time.
fn talk(world: &mut World, talks: &mut [Conversation; 2], time: Duration, with_bulk: bool) {
    let until = world.now + time;
    let mut due = world.now;
    while world.now < until {
        if world.now >= due {
            talks[0].send_small(world, 0);
            talks[1].send_small(world, 1);
            due += 50 * MS;
        }
        if with_bulk {
            talks[0].fill(world, 0, lane(DATA));
        }
        world.step(until.min(due));
        talks[0].receive(world, 1);
        talks[1].receive(world, 0);
    }
}

/// Lets everything arrive.
fn finish(world: &mut World, talks: &mut [Conversation; 2], case: &str) {
    let until = world.now + Duration::from_secs(60);
    while !talks.iter().all(Conversation::is_complete) {
        assert!(world.now < until, "{case}: not everything has arrived");
        world.step(until);
        talks[0].receive(world, 1);
        talks[1].receive(world, 0);
    }
}

fn percentile(ages: &mut [Duration], share: f64) -> Duration {
    ages.sort();
    ages[((ages.len() - 1) as f64 * share) as usize]
}

#[test]
fn one_path_carries_everything_in_order() {
    for quality in [BLUETOOTH, NETWORK] {
        let mut world = World::new();
        world.connect(quality);
        let mut talks = Default::default();
        talk(&mut world, &mut talks, Duration::from_secs(5), true);
        finish(&mut world, &mut talks, "one path");
        assert!(talks[0].received() > 800);
    }
}

#[test]
fn bulk_moves_to_the_network_and_returns_when_it_is_lost() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(2), true);
    assert_eq!(primary_of(&world.ends[0]), Some(Medium::Bluetooth));
    let network = world.connect(NETWORK);
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    assert_eq!(primary_of(&world.ends[0]), Some(Medium::Network));
    world.cut(network, [10 * MS, 30 * MS]);
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    assert_eq!(primary_of(&world.ends[0]), Some(Medium::Bluetooth));
    finish(&mut world, &mut talks, "lost network");
}

/// A network that carries more than the bytes in flight of a path that was not measured.
#[test]
fn rate_of_a_network_is_measured_and_used() {
    let mut world = World::new();
    let network = Quality {
        bytes_per_s: 20_000_000.0,
        ..NETWORK
    };
    world.connect(network);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    world.carried = [0; 2];
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    assert!(world.carried[1] > 18_000_000, "{:?}", world.carried);
    let (_, report) = world.ends[0].paths().next().expect("one path");
    let rate = report.rate_bytes_per_s;
    assert!((18e6..21e6).contains(&rate), "{rate}");
}

#[test]
fn network_has_no_more_in_flight_than_bluetooth_carries_in_time() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    let network = world.connect(NETWORK);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(2), true);
    world.jam(network, Duration::from_secs(60));
    let fault = world.now;
    finish(&mut world, &mut talks, "network that stays silent");
    let time = world.now - fault;
    assert!(
        time < Options::default().bounds.backlog + 500 * MS,
        "{time:?}"
    );
}

/// Returns the reason and the new medium of the last switch, and how long data had waited.
fn last_switch(end: &Multipath) -> Option<(SwitchReason, Medium, Duration)> {
    let switch = end.last_switch()?;
    Some((switch.reason, switch.current, switch.gap))
}

#[test]
fn each_switch_has_a_reason_and_a_gap() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    assert_eq!(last_switch(&world.ends[0]), None, "the first path");
    let network = world.connect(NETWORK);
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    let faster = (SwitchReason::Faster, Medium::Network, Duration::ZERO);
    assert_eq!(last_switch(&world.ends[0]), Some(faster));
    world.jam(network, Duration::from_millis(500));
    talk(&mut world, &mut talks, Duration::from_millis(400), true);
    let silent = last_switch(&world.ends[0]);
    let (reason, to, gap) = silent.expect("switched");
    assert_eq!((reason, to), (SwitchReason::Silent, Medium::Bluetooth));
    assert!(gap >= 100 * MS && gap < 300 * MS, "{gap:?}");
    talk(&mut world, &mut talks, Duration::from_secs(2), true);
    assert_eq!(primary_of(&world.ends[0]), Some(Medium::Network));
    world.cut(network, [10 * MS, 30 * MS]);
    talk(&mut world, &mut talks, Duration::from_secs(1), true);
    let (reason, to, gap) = last_switch(&world.ends[0]).expect("switched");
    assert_eq!((reason, to), (SwitchReason::Ended, Medium::Bluetooth));
    assert!(gap <= 50 * MS, "{gap:?}");
    assert_eq!(world.ends[0].switches(), 4);
}

/// Faults of all kinds, while small messages travel on all lanes in both directions beside bulk.
#[test]
fn nothing_is_lost_repeated_or_reordered_at_any_switch() {
    let switches = std::env::var("RECT_SWITCHES").map_or(2000, |n| n.parse().expect("a number"));
    let (mut done, mut seed) = (0, 0);
    let mut urgent = Vec::new();
    while done < switches {
        let mut rng = Pcg32::seed_from_u64(seed);
        let mut below = |limit: u64| u64::from(rng.next_u32()) % limit;
        let mut world = World::new();
        let mut paths = [Some(world.connect(BLUETOOTH)), Some(world.connect(NETWORK))];
        let mut talks = Default::default();
        talk(&mut world, &mut talks, 400 * MS, true);
        for fault in 0..20 {
            let n = usize::from(below(4) > 0);
            match (paths[n], below(4)) {
                (Some(path), 0) => world.jam(path, (20 + below(2000)) as u32 * MS),
                (Some(path), kind) => {
                    // An interface that is down is noticed at once, silence only after seconds.
                    let limit = if kind == 1 { 30 } else { 4000 };
                    world.cut(path, [below(limit) as u32 * MS, below(limit) as u32 * MS]);
                    paths[n] = None;
                }
                (None, _) => {
                    let quality = if n == 0 { BLUETOOTH } else { NETWORK };
                    paths[n] = Some(world.connect(quality));
                }
            }
            talk(&mut world, &mut talks, below(800) as u32 * MS, true);
            for end in &world.ends {
                assert_eq!(end.end(), None, "seed {seed}, fault {fault}");
            }
            // One path comes back within the lease.
            if paths == [None, None] {
                paths[0] = Some(world.connect(BLUETOOTH));
            }
            done += 1;
        }
        finish(&mut world, &mut talks, &format!("seed {seed}"));
        urgent.append(&mut talks[0].ages[1]);
        seed += 1;
    }
    assert!(!urgent.is_empty());
}

/// Measures what a switch adds: urgent messages over both paths, and other small ones.
#[test]
fn delays_at_a_switch_are_bounded() {
    for (what, noticed, limit) in [
        ("interface down", 5 * MS, 150 * MS),
        ("silence", Duration::from_secs(3), 500 * MS),
    ] {
        let (mut urgent, mut small) = (Vec::new(), Vec::new());
        for n in 0..100 {
            let mut world = World::new();
            world.connect(BLUETOOTH);
            let network = world.connect(NETWORK);
            let mut talks = Default::default();
            talk(&mut world, &mut talks, 1000 * MS + n * 7 * MS, true);
            for ages in &mut talks[0].ages {
                ages.clear();
            }
            world.cut(network, [noticed; 2]);
            talk(&mut world, &mut talks, 1000 * MS, false);
            urgent.append(&mut talks[0].ages[1]);
            small.append(&mut talks[0].ages[4]);
        }
        let (urgent_p99, urgent_max) =
            (percentile(&mut urgent, 0.99), percentile(&mut urgent, 1.0));
        let small_p99 = percentile(&mut small, 0.99);
        println!("{what}: urgent p99 {urgent_p99:?} max {urgent_max:?}, small p99 {small_p99:?}");
        assert!(
            urgent_p99 <= 40 * MS + BLUETOOTH.interval,
            "{what}: {urgent_p99:?}"
        );
        assert!(
            urgent_max <= 60 * MS + BLUETOOTH.interval,
            "{what}: {urgent_max:?}"
        );
        assert!(small_p99 <= limit, "{what}: {small_p99:?}");
    }
}

#[test]
fn jammed_path_is_used_again_when_it_answers() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    let network = world.connect(NETWORK);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(1), false);
    for with_bulk in [false, true] {
        talk(&mut world, &mut talks, 500 * MS, with_bulk);
        world.jam(network, Duration::from_secs(6));
        talk(&mut world, &mut talks, Duration::from_secs(5), with_bulk);
        assert_eq!(primary_of(&world.ends[0]), Some(Medium::Bluetooth));
        talk(&mut world, &mut talks, Duration::from_secs(5), with_bulk);
        assert_eq!(primary_of(&world.ends[0]), Some(Medium::Network));
    }
    finish(&mut world, &mut talks, "jam");
    assert!(
        world.ends[1].repeated_bytes() > 0,
        "urgent messages arrive twice"
    );
}

/// A radio that serves another connection now and then.
#[test]
fn nothing_is_sent_again_on_the_only_path() {
    let mut world = World::new();
    let bluetooth = world.connect(BLUETOOTH);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(2), true);
    let (mut suspicions, before) = (0, world.carried[0]);
    for _ in 0..20 {
        world.jam(bluetooth, 700 * MS);
        talk(&mut world, &mut talks, 690 * MS, true);
        let is_suspected = |(_, report): (_, PathReport)| report.state == PathState::Suspected;
        suspicions += u32::from(world.ends[0].paths().any(is_suspected));
        talk(&mut world, &mut talks, 310 * MS, true);
    }
    assert!(suspicions > 1, "{suspicions}");
    assert_eq!(world.ends[1].repeated_bytes(), 0);
    finish(&mut world, &mut talks, "busy radio");
    // The simulated radio is silent for 14 s, and its queue holds what it cannot send.
    assert!(world.carried[0] - before > 80_000, "{:?}", world.carried);
}

#[test]
fn link_ends_after_the_lease_without_a_path() {
    let mut world = World::new();
    let only = world.connect(BLUETOOTH);
    world.run(Duration::from_secs(1));
    world.cut(only, [10 * MS; 2]);
    world.run(Duration::from_secs(9));
    assert_eq!(world.ends[0].end(), None);
    world.run(Duration::from_secs(2));
    assert_eq!(
        world.ends[0].end(),
        Some(End::NoPath(Options::default().lease))
    );
}

#[test]
fn close_arrives_after_everything_else() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    world.connect(NETWORK);
    let mut talks: [Conversation; 2] = Default::default();
    world.run(100 * MS);
    talks[0].send_small(&mut world, 0);
    talks[0].fill(&mut world, 0, lane(DATA));
    world.ends[0].close(0);
    assert!(!world.ends[0].push(lane(DATA), b"too late", world.now));
    while world.ends[1].end().is_none() {
        world.step(world.now + Duration::from_secs(1));
        talks[0].receive(&mut world, 1);
    }
    assert!(talks[0].is_complete());
    assert_eq!(world.ends[1].end(), Some(End::ClosedByPeer(0)));
    assert_eq!(world.ends[0].end(), Some(End::Closed));
}

/// Nothing but Zenoh's keep-alives travels: one byte on the first lane, four times in a lease.
#[test]
fn idle_link_sends_little_over_bluetooth() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    world.connect(NETWORK);
    world.run(Duration::from_secs(2));
    world.carried = [0; 2];
    for _ in 0..40 {
        for end in 0..2 {
            assert!(world.ends[end].push(Lane::first(), &[4], world.now));
        }
        world.run(2500 * MS);
        for end in 0..2 {
            while world.ends[end].take(Lane::first(), world.now).is_some() {}
        }
    }
    let per_s = world.carried.map(|bytes| bytes as f64 / 100.0);
    assert!(per_s[0] < 1.0, "Bluetooth: {} B/s", per_s[0]);
    assert!(per_s[1] < 20.0, "network: {} B/s", per_s[1]);
}

#[test]
fn acknowledgement_of_more_than_was_sent_is_a_violation() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    world.run(100 * MS);
    let mut ack = Vec::new();
    let (frames, stopped, change) = (40, 0, 0);
    Frame::Ack {
        frames,
        stopped,
        change,
    }
    .encode(&mut ack);
    let now = world.now;
    assert_eq!(
        world.ends[0].on_frame(PathId(0), &ack, now),
        Err(Violation::Ack(AckError))
    );
}

#[test]
fn lane_that_is_not_read_stops_without_stopping_others() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    world.connect(NETWORK);
    world.run(500 * MS);
    let batch = [0xff; 1000];
    let mut sent = 0;
    for _ in 0..100 {
        while world.ends[0].push(lane(4), &batch, world.now) {
            sent += 1;
        }
        world.run(20 * MS);
    }
    assert!(sent < 1000, "{sent}");
    assert!(world.ends[0].push(lane(6), b"another lane", world.now));
    world.run(100 * MS);
    assert_eq!(
        world.ends[1].take(lane(6), world.now).as_deref(),
        Some(&b"another lane"[..])
    );
    let mut taken = 0;
    for _ in 0..1000 {
        while world.ends[1].take(lane(4), world.now).is_some() {
            taken += 1;
        }
        world.run(20 * MS);
    }
    assert_eq!(taken, sent);
}

/// Prints what arrives around a fault of the network, for `scripts/switch-picture`.
#[test]
fn arrivals_continue_on_bluetooth_when_the_network_falls_silent() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    let network = world.connect(NETWORK);
    let mut talks: [Conversation; 2] = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(1), false);
    let fault = world.now;
    world.jam(network, Duration::from_secs(1));
    let before = world.arrivals.len();
    let until = world.now + Duration::from_secs(2);
    while world.now < until {
        // A stream of 20 kB/s, which Bluetooth can carry.
        for _ in 0..2 {
            assert!(talks[0].offer(&mut world, 0, lane(6), 1000));
        }
        talk(&mut world, &mut talks, 100 * MS, false);
    }
    let arrivals = world.arrivals.split_off(before);
    let jam_ended = world.time_of(fault) + Duration::from_secs(1);
    for arrival in &arrivals {
        let ms = (arrival.at - world.time_of(fault)).as_secs_f64() * 1000.0;
        let (medium, lane) = (arrival.medium, arrival.lane.number());
        println!("arrival: {ms:.1} {medium} {lane} {}", arrival.position);
    }
    let during = arrivals.iter().filter(|arrival| arrival.at < jam_ended);
    assert!(during.clone().count() > 50);
    assert!(during
        .clone()
        .all(|arrival| arrival.medium == Medium::Bluetooth));
    assert!(arrivals
        .iter()
        .any(|arrival| arrival.medium == Medium::Network));
}

#[test]
fn what_each_medium_carries_is_counted_with_second_copies() {
    let mut world = World::new();
    world.connect(BLUETOOTH);
    world.connect(NETWORK);
    let keep = Duration::from_secs(60);
    world.ends[0].usage(world.now, keep);
    let mut talks = Default::default();
    talk(&mut world, &mut talks, Duration::from_secs(3), true);
    finish(&mut world, &mut talks, "two media");
    assert_eq!(primary_of(&world.ends[0]), Some(Medium::Network));
    let counted = world.ends[0].usage(world.now, keep);
    for (_, path) in world.ends[0].paths() {
        let sizes = counted[&path.medium].sent.iter();
        let frames: u64 = sizes.map(|(_, size)| size.cost).sum();
        let share = frames as f64 / path.sent_bytes as f64;
        assert!((0.99..1.01).contains(&share), "{frames} of {path:?}");
    }
}

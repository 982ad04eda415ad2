//! Tests streams over slow links, in virtual time: `cargo test --no-default-features -p rect-robot stream`
use std::time::Duration;

use super::{
    feedback::Feedback,
    ladder::Coding,
    sender::{Options, Sender, MAX_RECEIVERS, MAX_RECEIVERS_OF_ROBOT},
    simulation::{Arrival, Condition, Random, World},
    Group,
};
use crate::{
    message::{
        attachment::{Attachment, Sent},
        encoding::Encoding,
        payload::Payload,
    },
    name::Name,
};

const PIXELS: usize = 320 * 240;
const SEEDS: std::ops::Range<u64> = 0..5;

fn world(seed: u64) -> World {
    World::new(Options::default(), PIXELS, seed)
}

fn secs(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

/// The frames that arrived in a time span, in seconds.
#[derive(Debug)]
struct Found {
    frames_per_s: f64,
    bytes_per_s: f64,
    age_p99: Duration,
}

fn found(world: &World, name: &str, from: u64, to: u64) -> Found {
    let is_in = |arrival: &&Arrival| (secs(from)..secs(to)).contains(&arrival.at);
    let arrivals: Vec<_> = world.endpoint(name).arrivals.iter().filter(is_in).collect();
    let mut ages: Vec<_> = arrivals.iter().map(|arrival| arrival.age).collect();
    ages.sort();
    let span = (to - from) as f64;
    Found {
        frames_per_s: arrivals.len() as f64 / span,
        bytes_per_s: arrivals
            .iter()
            .map(|arrival| arrival.bytes as f64)
            .sum::<f64>()
            / span,
        age_p99: ages
            .get(ages.len() * 99 / 100)
            .copied()
            .unwrap_or(Duration::MAX),
    }
}

/// Returns how often the step of a group changed.
fn changes(world: &World, group: Group, from: u64, to: u64) -> usize {
    let is_in =
        |&&(at, of, _): &&(Duration, Group, _)| of == group && at >= secs(from) && at < secs(to);
    world.changes.iter().filter(is_in).count()
}

/// Returns the standard deviation of a group's rate, as a share of its mean.
fn deviation(world: &World, group: Group, from: u64, to: u64) -> f64 {
    let is_in =
        |&&(at, of, _): &&(Duration, Group, f64)| of == group && at >= secs(from) && at < secs(to);
    let rates: Vec<f64> = world
        .rates
        .iter()
        .filter(is_in)
        .map(|&(_, _, rate)| rate)
        .collect();
    let count = rates.len() as f64;
    let mean = rates.iter().sum::<f64>() / count;
    let square = rates.iter().map(|rate| (rate - mean).powi(2)).sum::<f64>() / count;
    square.sqrt() / mean
}

/// Asserts that the stream does not oscillate: while the link does not change, the step changes at most once in 20 s,
/// and the standard deviation of the rate is below 15 %.
fn assert_calm(world: &World, group: Group, from: u64, to: u64, about: &str) {
    let changes = changes(world, group, from, to);
    assert!(
        changes as u64 <= (to - from) / 20,
        "{about}: {changes} changes: {:?}",
        world.changes
    );
    let deviation = deviation(world, group, from, to);
    assert!(
        deviation < 0.15,
        "{about}: the rate varies by {deviation:.2}"
    );
}

#[test]
fn converges_within_5_s_on_links_of_34_100_and_1000_kb_per_s() {
    for seed in SEEDS {
        for rate in [34e3, 100e3, 1e6] {
            let mut world = world(seed);
            world.add("wombat-2", 30, move |_| Condition::of(rate));
            world.run(60);
            let about = format!("seed {seed}, {rate} B/s");
            let late = found(&world, "wombat-2", 5, 60);
            assert!(late.frames_per_s >= 5.0, "{about}: {late:?}");
            assert!(
                late.age_p99 < Duration::from_millis(600),
                "{about}: {late:?}"
            );
            if rate < 5e5 {
                assert!(late.bytes_per_s >= 0.7 * rate, "{about}: {late:?}");
            }
            assert_calm(&world, Group::Main, 5, 60, &about);
        }
    }
}

#[test]
fn the_first_frames_do_not_fill_the_queue_of_a_slow_link() {
    for seed in SEEDS {
        for rate in [3e3, 5e3, 10e3, 34e3] {
            let mut world = world(seed);
            // As much as waits above an `any` link: 8 of Zenoh's batches of 16,000 bytes.
            let queue_bytes = 128e3;
            world.add("wombat-2", 30, move |_| Condition {
                queue_bytes,
                ..Condition::of(rate)
            });
            world.run(30);
            let ages = world
                .endpoint("wombat-2")
                .arrivals
                .iter()
                .map(|arrival| arrival.age);
            let oldest = ages.max().unwrap();
            // Two of the first frames, which have about 5 kB.
            let limit = Duration::from_millis(100) + Duration::from_secs_f64(2.0 * 5300.0 / rate);
            assert!(oldest < limit, "seed {seed}, {rate} B/s: {oldest:?}");
        }
    }
}

#[test]
fn is_lossless_within_8_s_on_wi_fi() {
    for seed in SEEDS {
        let mut world = world(seed);
        world.add("laptop", 2, |_| Condition::of(20e6));
        world.run(30);
        let late = |arrival: &&Arrival| arrival.at > secs(8);
        let arrivals: Vec<_> = world
            .endpoint("laptop")
            .arrivals
            .iter()
            .filter(late)
            .collect();
        assert!(
            arrivals
                .iter()
                .all(|arrival| arrival.step.coding == Coding::Lossless),
            "seed {seed}: {:?}",
            world.changes
        );
        assert!(
            found(&world, "laptop", 8, 30).frames_per_s > 12.0,
            "seed {seed}"
        );
    }
}

#[test]
fn estimates_the_age_correctly_for_any_clock_offset() {
    for seed in SEEDS {
        let mut world = world(seed);
        world.add("wombat-2", 30, |_| Condition::of(34e3));
        world.run(130);
        for arrival in world
            .endpoint("wombat-2")
            .arrivals
            .iter()
            .filter(|arrival| arrival.at > secs(2))
        {
            let estimated = arrival.estimated.expect("known");
            assert!(
                estimated.abs_diff(arrival.age) <= Duration::from_millis(35),
                "seed {seed}: {arrival:?}"
            );
        }
    }
}

#[test]
fn adapts_within_5_s_when_the_link_changes() {
    for seed in SEEDS {
        for (before, after) in [(100e3, 34e3), (34e3, 100e3), (1e6, 34e3)] {
            let mut world = world(seed);
            world.add("wombat-2", 30, move |at| {
                Condition::of(if at < secs(20) { before } else { after })
            });
            world.run(60);
            let about = format!("seed {seed}, from {before} to {after} B/s");
            let late = found(&world, "wombat-2", 25, 60);
            assert!(late.frames_per_s >= 5.0, "{about}: {late:?}");
            assert!(late.bytes_per_s >= 0.7 * after, "{about}: {late:?}");
            assert!(
                late.age_p99 < Duration::from_millis(600),
                "{about}: {late:?}"
            );
            assert_calm(&world, Group::Main, 26, 60, &about);
        }
    }
}

#[test]
fn recovers_within_3_s_after_an_interruption() {
    for seed in SEEDS {
        for cut in [1, 3, 10, 40] {
            let mut world = world(seed);
            world.add("wombat-2", 30, move |at| Condition {
                is_cut: at >= secs(20) && at < secs(20 + cut),
                ..Condition::of(34e3)
            });
            world.run(20);
            let before = world.encoded;
            world.run(cut);
            let encoded = world.encoded - before;
            assert!(
                encoded <= 2,
                "seed {seed}: {encoded} frames were encoded without a receiver"
            );
            world.run(30);
            let about = format!("seed {seed}, cut for {cut} s");
            let soon = found(&world, "wombat-2", 20 + cut, 23 + cut);
            assert!(soon.frames_per_s >= 4.0, "{about}: {soon:?}");
            let late = found(&world, "wombat-2", 23 + cut, 50 + cut);
            assert!(late.bytes_per_s >= 0.7 * 34e3, "{about}: {late:?}");
            assert!(
                late.age_p99 < Duration::from_millis(600),
                "{about}: {late:?}"
            );
        }
    }
}

#[test]
fn tolerates_a_loss_of_five_percent() {
    for seed in SEEDS {
        for rate in [34e3, 100e3] {
            let mut world = world(seed);
            world.add("wombat-2", 30, move |_| Condition {
                loss: 0.05,
                ..Condition::of(rate)
            });
            world.run(120);
            let about = format!("seed {seed}, {rate} B/s");
            let late = found(&world, "wombat-2", 5, 120);
            assert!(late.bytes_per_s >= 0.7 * 0.95 * rate, "{about}: {late:?}");
            assert_calm(&world, Group::Main, 5, 120, &about);
        }
    }
}

#[test]
fn leaves_room_for_other_traffic() {
    for seed in SEEDS {
        let mut world = world(seed);
        let busy = |at: Duration| at >= secs(20) && at < secs(50);
        world.add("wombat-2", 30, move |at| Condition {
            others_bytes_per_s: if busy(at) { 40e3 } else { 0.0 },
            ..Condition::of(100e3)
        });
        world.run(80);
        let meanwhile = found(&world, "wombat-2", 25, 50);
        assert!(
            meanwhile.age_p99 < Duration::from_millis(600),
            "seed {seed}: {meanwhile:?}"
        );
        assert!(
            meanwhile.bytes_per_s >= 0.6 * 60e3,
            "seed {seed}: {meanwhile:?}"
        );
        assert!(
            found(&world, "wombat-2", 56, 80).bytes_per_s >= 0.7 * 100e3,
            "seed {seed}"
        );
        assert!(
            changes(&world, Group::Main, 25, 50) <= 3,
            "seed {seed}: {:?}",
            world.changes
        );
    }
}

#[test]
fn changes_the_step_when_pictures_become_larger() {
    for seed in SEEDS {
        let mut world = world(seed);
        world.scene = Box::new(|at| {
            if (secs(20)..secs(40)).contains(&at) {
                2.2
            } else {
                1.0
            }
        });
        world.add("wombat-2", 30, |_| Condition::of(34e3));
        world.run(100);
        for (from, to) in [(22, 40), (45, 100)] {
            let late = found(&world, "wombat-2", from, to);
            assert!(
                late.age_p99 < Duration::from_millis(600),
                "seed {seed}: {late:?}"
            );
            assert!(
                late.frames_per_s >= 4.5,
                "seed {seed}: {late:?} {:?}",
                world.changes
            );
        }
        assert!(
            changes(&world, Group::Main, 5, 100) <= 6,
            "seed {seed}: {:?}",
            world.changes
        );
    }
}

#[test]
fn a_robot_on_bluetooth_does_not_limit_a_laptop_on_wi_fi() {
    for seed in SEEDS {
        let mut world = world(seed);
        world.add("laptop", 2, |_| Condition::of(20e6));
        world.add("wombat-2", 30, |_| Condition::of(34e3));
        world.run(60);
        let (fast, slow) = (world.endpoint("laptop"), world.endpoint("wombat-2"));
        let last = fast.arrivals.last().expect("frames");
        assert_eq!(
            (last.group, last.step.coding),
            (Group::Main, Coding::Lossless),
            "seed {seed}"
        );
        assert!(
            found(&world, "laptop", 20, 60).frames_per_s > 12.0,
            "seed {seed}"
        );
        assert_eq!(
            slow.arrivals.last().map(|arrival| arrival.group),
            Some(Group::Slow)
        );
        assert!(
            slow.groups.len() <= 2 && fast.groups.len() <= 2,
            "seed {seed}"
        );
        let late = found(&world, "wombat-2", 10, 60);
        assert!(
            late.frames_per_s >= 5.0 && late.bytes_per_s >= 0.7 * 34e3,
            "seed {seed}: {late:?}"
        );
        assert!(
            late.age_p99 < Duration::from_millis(600),
            "seed {seed}: {late:?}"
        );
    }
}

#[test]
fn a_robot_on_bluetooth_that_joins_late_gets_only_small_frames() {
    for seed in SEEDS {
        let mut world = world(seed);
        world.add_at_times("laptop", 2, |_| Condition::of(20e6), |at| at < secs(40));
        world.add_at_times("wombat-2", 30, |_| Condition::of(34e3), |at| at > secs(20));
        world.run(80);
        let slow = world.endpoint("wombat-2");
        let oldest = slow
            .arrivals
            .iter()
            .map(|arrival| arrival.age)
            .max()
            .expect("frames");
        assert!(oldest < secs(1), "seed {seed}: {oldest:?}");
        assert!(
            found(&world, "wombat-2", 21, 24).frames_per_s >= 3.0,
            "seed {seed}"
        );
        // After the laptop has left, the robot is in the main group.
        assert_eq!(
            slow.groups.last().map(|&(_, group)| group),
            Some(Group::Main),
            "seed {seed}"
        );
        assert!(
            found(&world, "wombat-2", 55, 80).frames_per_s >= 5.0,
            "seed {seed}"
        );
    }
}

#[test]
fn feedback_takes_less_than_60_bytes_per_second() {
    let mut world = world(1);
    world.add("wombat-2", 30, |_| Condition::of(34e3));
    world.run(60);
    let per_s = world.feedback_bytes / 60;
    assert!(per_s < 60, "{per_s}");
}

#[test]
fn sensor_values_are_sent_at_once_with_six_to_eight_bytes_of_overhead() {
    let start = std::time::Instant::now();
    let mut sender = Sender::new(Options::sensor(), 7, 1_795_000_000_000, start);
    assert_eq!(sender.offer(4, start), [], "no receivers");
    sender.on_subscribers(Group::Main, true);
    for n in 0..20_000u32 {
        let now = start + Duration::from_millis(u64::from(n));
        let jobs = sender.offer(4, now);
        assert_eq!(jobs.len(), 1, "value {n}");
        assert_eq!(jobs[0].step, None);
        let attachment = sender.on_encoded(
            jobs[0],
            &Payload::new([0; 4].as_slice(), Encoding::BYTES),
            now,
        );
        assert_eq!(attachment.sequence, n);
        assert!(matches!(attachment.sent, Sent::Low(_)));
        assert!(attachment.encode().len() <= 8);
    }
    assert_eq!(sender.notice(start).feedback_ms, 0);
}

#[cfg(feature = "video")]
#[test]
fn pictures_are_video_only_if_every_receiver_of_the_group_decodes_it() {
    let start = std::time::Instant::now();
    let mut sender = Sender::new(Options::video(), 7, 1_795_000_000_000, start);
    sender.on_subscribers(Group::Main, true);
    let now = std::cell::Cell::new(start);
    let offered = |sender: &mut Sender, size: (u32, u32)| {
        now.set(now.get() + Duration::from_millis(100));
        let jobs = sender.offer_picture(size.0, size.1, now.get());
        assert_eq!(jobs.len(), 1);
        assert!(jobs[0].video.is_some() != jobs[0].step.is_some());
        jobs[0].video.is_some()
    };
    assert!(offered(&mut sender, (640, 480)), "nobody has said anything");
    assert!(!offered(&mut sender, (8, 8)), "too small");
    let feedback = |receiver, accepts_video| Feedback {
        receiver,
        accepts_video,
        ..Feedback::default()
    };
    let (modern, plain) = (name("wombat-2"), name("wombat-3"));
    sender.on_feedback(&modern, &feedback(1, true), start);
    assert!(offered(&mut sender, (640, 480)));
    sender.on_feedback(&plain, &feedback(2, false), start);
    assert!(!offered(&mut sender, (640, 480)));
    // It has left.
    sender.on_feedback(&modern, &feedback(1, true), start + secs(20));
    now.set(start + secs(20));
    assert!(offered(&mut sender, (640, 480)));
    // Frames that are not pictures adapt as in the other mode.
    assert!(sender.offer(1000, start + secs(21))[0].step.is_some());
}

/// Returns an attacker's feedback, sent in the robot's own name, about a stream that it subscribes to.
fn reported(newest: [Option<Attachment>; 2], group: Group, pace: u32) -> Option<Feedback> {
    let newest = newest[group.index()]?;
    Some(Feedback {
        group,
        receiver: 7,
        source: newest.source,
        last: newest.sequence,
        span_ms: 500,
        frames: 5,
        bytes: 5000,
        pace_bytes_per_s: Some(pace),
        ..Feedback::default()
    })
}

#[cfg(feature = "video")]
fn name(text: &str) -> Name {
    Name::new(text).expect("valid name")
}

fn attacker() -> Name {
    Name::new("attacker").expect("valid name")
}

#[test]
fn invalid_feedback_has_no_effect() {
    let mut world = world(1);
    world.add("laptop", 2, |_| Condition::of(20e6));
    let mut random = Random(5);
    world.forge = Box::new(move |sender, _, _, now| {
        for _ in 0..20 {
            let mut number = || random.next() as u32;
            let feedback = Feedback {
                receiver: number() as u16,
                source: number() as u16,
                last: number(),
                span_ms: number(),
                frames: number(),
                bytes: number(),
                skipped: number(),
                age_ms: number(),
                pace_bytes_per_s: Some(number() % 1000),
                ..Feedback::default()
            };
            sender.on_feedback(&attacker(), &feedback, now);
        }
    });
    world.run(40);
    assert_eq!(world.sender.status().receivers.len(), 1, "the laptop");
    let late = found(&world, "laptop", 10, 40);
    println!("{late:?}");
    assert!(
        late.frames_per_s > 12.0 && late.bytes_per_s > 500e3,
        "{late:?}"
    );
}

#[test]
fn a_robot_that_reports_a_low_rate_limits_others_for_seconds_only() {
    for (about, forge_from) in [("from the beginning", 0), ("later", 20)] {
        let mut world = world(1);
        world.add("laptop", 2, |_| Condition::of(20e6));
        world.forge = Box::new(move |sender, newest, since, now| {
            // The attacker ignores the notices and stays in its group.
            let feedback = reported(newest, Group::Main, 1);
            if let Some(feedback) = feedback.filter(|_| since >= secs(forge_from)) {
                sender.on_feedback(&attacker(), &feedback, now);
            }
        });
        world.run(60);
        let late = found(&world, "laptop", forge_from + 15, 60);
        println!("{about}: {late:?}");
        assert!(late.frames_per_s > 12.0, "{about}: {late:?}");
        assert!(late.bytes_per_s > 500e3, "{about}: {late:?}");
    }
}

#[test]
fn a_robot_that_alternates_its_reports_limits_others_less_and_less() {
    let mut world = world(1);
    world.add("laptop", 2, |_| Condition::of(20e6));
    world.forge = Box::new(|sender, newest, since, now| {
        let pace = if since.as_secs() % 16 < 8 {
            20_000_000
        } else {
            1
        };
        if let Some(feedback) = reported(newest, Group::Main, pace) {
            sender.on_feedback(&attacker(), &feedback, now);
        }
    });
    world.run(300);
    let held_down = |from, to| {
        let rates = world
            .rates
            .iter()
            .filter(|(at, group, _)| *group == Group::Main && (secs(from)..secs(to)).contains(at));
        let (count, limited) = rates.fold((0, 0), |(count, limited), (_, _, rate)| {
            (count + 1, limited + u32::from(*rate < 500e3))
        });
        f64::from(limited) / f64::from(count)
    };
    let share = held_down(60, 300);
    println!("limited for {share:.2} of the time");
    assert!(share < 0.2, "{share}");
}

#[test]
fn a_robot_that_reports_a_low_rate_leaves_the_slow_group_a_third() {
    for seed in SEEDS {
        let mut world = world(seed);
        world.add("laptop", 2, |_| Condition::of(20e6));
        world.add("wombat-2", 30, |_| Condition::of(34e3));
        world.forge = Box::new(|sender, newest, since, now| {
            let feedback = reported(newest, Group::Slow, 1);
            if let Some(feedback) = feedback.filter(|_| since >= secs(20)) {
                sender.on_feedback(&attacker(), &feedback, now);
            }
        });
        world.run(80);
        let (before, after) = (
            found(&world, "wombat-2", 10, 20),
            found(&world, "wombat-2", 40, 80),
        );
        println!("seed {seed}: {before:?} then {after:?}");
        assert!(
            after.bytes_per_s > before.bytes_per_s / 4.0,
            "seed {seed}: {after:?}"
        );
        assert!(
            found(&world, "laptop", 40, 80).frames_per_s > 12.0,
            "seed {seed}"
        );
    }
}

#[test]
fn one_robot_does_not_displace_the_receivers_of_others() {
    let now = std::time::Instant::now();
    let mut sender = Sender::new(Options::default(), 1, 0, now);
    for receiver in 1..1000 {
        let feedback = Feedback {
            receiver,
            ..Feedback::default()
        };
        sender.on_feedback(&attacker(), &feedback, now);
    }
    assert_eq!(sender.status().receivers.len(), MAX_RECEIVERS_OF_ROBOT);
    for robot in 0..MAX_RECEIVERS {
        let name = Name::new(&format!("wombat-{robot}")).expect("valid name");
        let feedback = Feedback {
            receiver: 1,
            ..Feedback::default()
        };
        sender.on_feedback(&name, &feedback, now);
    }
    assert_eq!(sender.status().receivers.len(), MAX_RECEIVERS);
}

#[cfg(feature = "video")]
#[test]
fn a_recorder_gets_a_key_frame_and_is_no_receiver() {
    let start = std::time::Instant::now();
    let options = Options {
        mode: super::options::Mode::Video,
        ..Options::default()
    };
    let mut sender = Sender::new(options, 1, 0, start);
    sender.on_subscribers(Group::Main, true);
    let is_key = |sender: &mut Sender, seconds| {
        let now = start + Duration::from_secs(seconds);
        let jobs = sender.offer_picture(320, 240, now);
        let is_key = jobs[0].video.expect("a video").is_key;
        let units: &[u8] = match is_key {
            true => &[0, 0, 1, 0x67, 1, 0, 0, 1, 0x65, 1],
            false => &[0, 0, 1, 0x61, 1],
        };
        let frame = Payload::new(units, Encoding::H264);
        sender.on_encoded(jobs[0], &frame, now);
        is_key
    };
    assert!(is_key(&mut sender, 0), "the first frame");
    assert!(!is_key(&mut sender, 1));
    sender.on_feedback(&attacker(), &Feedback::of_recorder(), start);
    assert!(is_key(&mut sender, 2));
    assert!(sender.status().receivers.is_empty());
}

//! Tests transfers over a link in virtual time: throughput, queueing, and the cost of interruptions.
use std::time::Duration;

use super::{
    ranges::Ranges,
    simulated::{Interruption, Link, Result, World},
    window::MAX_LIMIT_BYTES,
};

const MB: u64 = 1_000_000;

fn run(link: Link, sizes: &[u64]) -> Vec<Result> {
    let mut world = World::new(link);
    sizes.iter().for_each(|&size| world.transfer(size));
    let results = world.run(Duration::from_secs(36_000));
    for result in &results {
        assert_eq!(result.ended, Some(Ok(())), "{:?}", result.took);
    }
    results
}

fn goodput(size: u64, result: &Result) -> f64 {
    size as f64 / result.took.as_secs_f64()
}

#[test]
fn uses_slow_links_and_keeps_their_queues_short() {
    for interval_ms in [0, 15, 50] {
        for (rate, round_trip) in [
            (34e3, 100),
            (100e3, 100),
            (34e3, 40),
            (100e3, 30),
            (10e3, 200),
        ] {
            let mut link = Link::new(rate, round_trip);
            link.interval = Duration::from_millis(interval_ms);
            let result = &run(link, &[5 * MB])[0];
            let part = goodput(5 * MB, result) / rate;
            let (typical, p99) = (result.wait(50), result.wait(99));
            println!(
                "{rate} B/s, {round_trip} ms, events of {interval_ms} ms: {part:.3} of the rate, waits p50 {typical:?} \
                 p99 {p99:?} max {:?}, {} bytes out",
                result.wait(100),
                result.max_in_flight
            );
            // One piece, plus the excess of the first rounds. At 10 kB/s the smallest piece takes 0.1 s, and 6 % are
            // overhead.
            let (min_share, bound) = if rate < 20e3 { (0.9, 500) } else { (0.92, 250) };
            assert!(part >= min_share, "{part}");
            assert!(p99 <= Duration::from_millis(bound), "{p99:?}");
        }
    }
}

#[test]
fn uses_fast_links() {
    for (rate, round_trip, min_share) in [
        (1e6, 50, 0.92),
        (10e6, 20, 0.92),
        (100e6, 1, 0.92),
        (500e6, 1, 0.85),
    ] {
        let size = (rate as u64 * 10).max(10 * MB);
        let result = &run(Link::new(rate, round_trip), &[size])[0];
        let part = goodput(size, result) / rate;
        println!(
            "{rate} B/s, {round_trip} ms: {part:.3} of the rate, waits p99 {:?}, {} bytes out",
            result.wait(99),
            result.max_in_flight
        );
        assert!(part >= min_share, "{part}");
        assert!(result.max_in_flight <= MAX_LIMIT_BYTES);
    }
}

#[test]
fn an_interruption_costs_at_most_what_was_in_flight() {
    for reported in [true, false] {
        for rate in [34e3, 100e3, 10e6] {
            let size = (rate * 60.0) as u64;
            let mut link = Link::new(rate, 100);
            link.interruptions = [9, 23, 41]
                .map(|at| Interruption {
                    at: Duration::from_secs(at),
                    lasts: Duration::from_secs(4),
                    reported,
                })
                .to_vec();
            let result = &run(link, &[size])[0];
            let twice = result.sent_bytes - size;
            println!(
                "{rate} B/s, three interruptions of 4 s, reported: {reported}: {:?}, {twice} bytes twice, {} out at most",
                result.took, result.max_in_flight
            );
            assert!(twice <= 3 * result.max_in_flight, "{twice}");
            // Its own time, the interruptions, and after each of these at most the longest pause or timeout, plus a
            // margin.
            assert!(
                result.took < Duration::from_secs(60 + 12 + 3 * 5),
                "{:?}",
                result.took
            );
        }
    }
}

#[test]
fn lost_requests_are_repeated() {
    for lost_per_mille in [1, 10, 100] {
        for seed in 0..5 {
            let mut link = Link::new(100e3, 100);
            (link.lost_per_mille, link.seed) = (lost_per_mille, seed);
            let result = &run(link, &[MB])[0];
            println!(
                "{lost_per_mille} of 1000 lost, seed {seed}: {:?}",
                result.took
            );
            // Delayed data is sent twice.
            assert!(
                result.sent_bytes < MB + MB / 10,
                "seed {seed}: {}",
                result.sent_bytes
            );
        }
    }
}

#[test]
fn two_transfers_share_a_link_and_keep_its_queue_short() {
    let results = run(Link::new(34e3, 100), &[MB, MB]);
    let last = results.iter().map(|result| result.took).max().expect("two");
    let first = results.iter().map(|result| result.took).min().expect("two");
    println!(
        "{first:?} {last:?}, waits p99 {:?} {:?}",
        results[0].wait(99),
        results[1].wait(99)
    );
    assert!(2.0 * MB as f64 / last.as_secs_f64() / 34e3 >= 0.92);
    assert!(
        first.as_secs_f64() > last.as_secs_f64() * 0.6,
        "{first:?} of {last:?}"
    );
    assert!(results
        .iter()
        .all(|result| result.wait(99) < Duration::from_millis(350)));
}

#[test]
fn adapts_to_a_change_of_the_rate() {
    for (before, after) in [(100e3, 20e3), (20e3, 100e3), (10e6, 34e3), (34e3, 10e6)] {
        let mut link = Link::new(before, 60);
        let change = Duration::from_secs(20);
        link.then = Some((change, after));
        let size = (before * 20.0 + after * 60.0) as u64;
        let result = &run(link, &[size])[0];
        // The expected amount of the first 20 s, and the time for the rest at the second rate.
        let rest = (size as f64 - before * 20.0 * 0.92) / after;
        let (took, wait) = (result.took, result.wait(99));
        println!("{before} then {after} B/s: {took:?} of {rest:.0} s and 20, waits p99 {wait:?}");
        // Data that was in flight when the link became slow arrives first, which takes up to half a minute.
        assert!(took < change + Duration::from_secs_f64(rest / 0.9 + 30.0));
    }
}

#[test]
fn does_not_request_received_data_again() {
    let mut received = Ranges::default();
    received.insert(0..600_000);
    received.insert(700_000..800_000);
    let mut world = World::new(Link::new(1e6, 20));
    world.resume(MB, received);
    let result = world.run(Duration::from_secs(60)).remove(0);
    assert_eq!((result.ended, result.sent_bytes), (Some(Ok(())), 300_000));
}

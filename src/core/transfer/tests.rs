//! Transfers over a link in virtual time: how fast, how much waits, what a cut costs.
use std::time::Duration;

use super::{
    ranges::Ranges,
    simulated::{Cut, Link, Result, World},
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
fn a_slow_link_is_used_and_its_queue_stays_short() {
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
            let (typical, most) = (result.wait(50), result.wait(99));
            println!(
                "{rate} B/s, {round_trip} ms, events of {interval_ms} ms: {part:.3} of the rate, waits p50 {typical:?} \
                 p99 {most:?} max {:?}, {} bytes out",
                result.wait(100),
                result.most_out
            );
            // One piece, and what the first rounds overdo; at 10 kB/s the smallest piece takes 0.1 s, and 6 % are overhead.
            let (least, bound) = if rate < 20e3 { (0.9, 500) } else { (0.92, 250) };
            assert!(part >= least, "{part}");
            assert!(most <= Duration::from_millis(bound), "{most:?}");
        }
    }
}

#[test]
fn fast_links_are_used_too() {
    for (rate, round_trip, least) in [
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
            result.most_out
        );
        assert!(part >= least, "{part}");
        assert!(result.most_out <= MAX_LIMIT_BYTES);
    }
}

#[test]
fn a_cut_costs_at_most_what_was_on_its_way() {
    for told in [true, false] {
        for rate in [34e3, 100e3, 10e6] {
            let size = (rate * 60.0) as u64;
            let mut link = Link::new(rate, 100);
            link.cuts = [9, 23, 41]
                .map(|at| Cut {
                    at: Duration::from_secs(at),
                    lasts: Duration::from_secs(4),
                    told,
                })
                .to_vec();
            let result = &run(link, &[size])[0];
            let twice = result.sent_bytes - size;
            println!(
                "{rate} B/s, three cuts of 4 s, told: {told}: {:?}, {twice} bytes twice, {} out at most",
                result.took, result.most_out
            );
            assert!(twice <= 3 * result.most_out, "{twice}");
            // Its own time, the cuts, and after each at most the longest pause or timeout and a little.
            assert!(
                result.took < Duration::from_secs(60 + 12 + 3 * 5),
                "{:?}",
                result.took
            );
        }
    }
}

#[test]
fn requests_that_get_lost_are_asked_again() {
    for lost_per_mille in [1, 10, 100] {
        for seed in 0..5 {
            let mut link = Link::new(100e3, 100);
            (link.lost_per_mille, link.seed) = (lost_per_mille, seed);
            let result = &run(link, &[MB])[0];
            println!(
                "{lost_per_mille} of 1000 lost, seed {seed}: {:?}",
                result.took
            );
            // What was only late is sent twice.
            assert!(
                result.sent_bytes < MB + MB / 10,
                "seed {seed}: {}",
                result.sent_bytes
            );
        }
    }
}

#[test]
fn two_share_a_link_and_its_queue_stays_short() {
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
fn a_rate_that_changes_is_followed() {
    for (before, after) in [(100e3, 20e3), (20e3, 100e3), (10e6, 34e3), (34e3, 10e6)] {
        let mut link = Link::new(before, 60);
        let change = Duration::from_secs(20);
        link.then = Some((change, after));
        let size = (before * 20.0 + after * 60.0) as u64;
        let result = &run(link, &[size])[0];
        // What the first 20 s are to bring, and what the second rate then has to.
        let rest = (size as f64 - before * 20.0 * 0.92) / after;
        let (took, wait) = (result.took, result.wait(99));
        println!("{before} then {after} B/s: {took:?} of {rest:.0} s and 20, waits p99 {wait:?}");
        // What was on its way when it became slow goes first: up to half a minute.
        assert!(took < change + Duration::from_secs_f64(rest / 0.9 + 30.0));
    }
}

#[test]
fn what_is_there_is_not_asked_for_again() {
    let mut held = Ranges::default();
    held.insert(0..600_000);
    held.insert(700_000..800_000);
    let mut world = World::new(Link::new(1e6, 20));
    world.resume(MB, held);
    let result = world.run(Duration::from_secs(60)).remove(0);
    assert_eq!((result.ended, result.sent_bytes), (Some(Ok(())), 300_000));
}

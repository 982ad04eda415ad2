//! Simulates networks of robots for a day, with equal intervals and with the intervals that robots choose. The figures are
//! in docs/concepts/radio.md, and scripts/radio-pictures plots them:
//! `cargo test -p zenoh-link-ble-air --lib air::tests::day -- --nocapture`.
use std::time::Duration;

use super::{
    network::{Intervals, Network},
    AirOptions, Condition,
};
use crate::arbitration::Arbitration;

const DAY: Duration = Duration::from_secs(24 * 3600);

/// A network: its name, and central and peripheral of each link.
type Topology = (&'static str, Vec<(usize, usize)>);

/// Networks whose robots have 2 to 7 links.
fn topologies() -> Vec<Topology> {
    let pairs = |robots: usize| (0..robots).flat_map(move |a| (a + 1..robots).map(move |b| (a, b)));
    vec![
        ("chain of 5", (0..4).map(|n| (n, n + 1)).collect()),
        ("ring of 6", (0..6).map(|n| (n, (n + 1) % 6)).collect()),
        ("fleet of 3", pairs(3).collect()),
        ("fleet of 5", pairs(5).collect()),
        ("star of 4, half dialled by the hub", mixed_star(4)),
        ("star of 7, half dialled by the hub", mixed_star(7)),
        (
            "star of 7, all dialled by the robots",
            (1..=7).map(|n| (n, 0)).collect(),
        ),
        (
            "star of 7, all dialled by the hub",
            (1..=7).map(|n| (0, n)).collect(),
        ),
    ]
}

fn mixed_star(links: usize) -> Vec<(usize, usize)> {
    let link = |n| if n % 2 == 0 { (0, n) } else { (n, 0) };
    (1..=links).map(link).collect()
}

fn options(arbitration: Arbitration) -> AirOptions {
    AirOptions {
        max_clock_drift_ppm: 20,
        arbitration,
        condition: Condition::Desk,
        ..AirOptions::default()
    }
}

#[test]
fn chosen_intervals_lose_no_link_in_a_day_and_equal_ones_many() {
    for (name, links) in topologies() {
        let run = |intervals| {
            let mut network = Network::new(options(Arbitration::FirstCome), &links, intervals);
            network.run(DAY);
            network
        };
        let (equal, chosen) = (run(Intervals::Equal), run(Intervals::Chosen));
        println!(
            "day: {name}; {} links; {} lost with equal intervals; {} lost with {} chosen intervals; hours {:.2?}",
            links.len(),
            equal.drops(),
            chosen.drops(),
            chosen.interval_count(),
            equal.dropped_at.iter().map(|at| at.as_secs_f64() / 3600.0).collect::<Vec<_>>(),
        );
        let has_one_clock = links.iter().all(|(central, _)| *central == 0);
        if has_one_clock {
            assert_eq!(equal.drops(), 0, "{name}");
            assert_eq!(chosen.interval_count(), 1, "{name}");
        } else {
            assert!(equal.drops() >= 10, "{name}: {} drops", equal.drops());
        }
        assert_eq!(chosen.drops(), 0, "{name}");
    }
}

#[test]
fn chosen_intervals_avoid_long_silences_in_every_model_of_arbitration() {
    for arbitration in Arbitration::ALL {
        let (name, links) = &topologies()[1];
        let longest_silence = |intervals| {
            let mut network = Network::new(options(arbitration), links, intervals);
            let mut longest = Duration::ZERO;
            for second in 1..=2 * 3600 {
                network.run(Duration::from_secs(second));
                longest = longest.max(network.longest_silence());
            }
            longest
        };
        let silences = [Intervals::Equal, Intervals::Chosen].map(longest_silence);
        println!("silence: {name}; {arbitration:?}; {silences:.0?}");
        assert!(
            silences[1] < Duration::from_millis(100),
            "{arbitration:?}: {silences:?}"
        );
    }
}

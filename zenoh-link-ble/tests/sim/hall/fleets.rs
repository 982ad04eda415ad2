//! Fleets of three robots link with each other and not with other fleets, and stay linked for an hour.
use std::{
    sync::{atomic::Ordering, Arc},
    time::Duration,
};

use rand_pcg::{rand_core::SeedableRng, Pcg32};
use tokio::time::{sleep, Instant};
use zenoh_link_ble_air::{AirOptions, Condition};
use zenoh_link_ble_radio::Radio;

use crate::shared::{
    hall::{name, Finding, Hall, KEEP_ALIVE, ROBOTS_OF_A_FLEET},
    peer::{assert_delivers, within, Peer},
};

const FLEETS: usize = 15;
const PAIRS: usize = FLEETS * ROBOTS_OF_A_FLEET * (ROBOTS_OF_A_FLEET - 1) / 2;
/// All robots are switched on within this time, in milliseconds.
const ARRIVAL_MS: u32 = 5_000;
const HOUR: Duration = Duration::from_secs(3600);

fn options() -> AirOptions {
    AirOptions {
        seed: 45,
        condition: Condition::CrowdedHall,
        ..AirOptions::default()
    }
}

#[tokio::test(start_paused = true)]
async fn fleets_of_45_robots_link_and_stay_linked_for_an_hour() {
    let mut rng = Pcg32::seed_from_u64(45);
    let hall = Hall::new(FLEETS, options(), &mut rng);
    let start = Instant::now();
    hall.switch_on(Finding::ByName, &mut rng, ARRIVAL_MS);
    let found = hall.all_linked(start).await;
    println!(
        "switched on within {ARRIVAL_MS} ms, {PAIRS} pairs linked: half of them after {:?}, the last after {:?}",
        found[PAIRS / 2],
        found[PAIRS - 1]
    );
    // The last robot to be switched on, its check for name conflicts, and one or two dials.
    assert!(found[PAIRS - 1] < Duration::from_secs(15));

    sleep(Duration::from_secs(10)).await;
    let conflicts = hall.interval_conflicts();
    assert!(conflicts.is_empty(), "{conflicts:#?}");
    let (ended_before, batches_before) = (
        hall.ended.load(Ordering::Relaxed),
        hall.batches.load(Ordering::Relaxed),
    );
    let before = hall.stats();
    sleep(HOUR).await;
    let after = hall.stats();
    let batches = hall.batches.load(Ordering::Relaxed) - batches_before;
    // The share of time for which a radio is busy with its links, and with its advertisements.
    let shares = before.iter().zip(&after).map(|(before, after)| {
        [
            after.busy - before.busy,
            after.advertising - before.advertising,
        ]
        .map(|busy| 100.0 * busy.as_secs_f64() / HOUR.as_secs_f64())
    });
    let shares: Vec<_> = shares.collect();
    let max = shares
        .iter()
        .map(|[links, advertising]| links + advertising);
    let max = max.fold(0.0, f64::max);
    let mean = |n: usize| shares.iter().map(|share| share[n]).sum::<f64>() / shares.len() as f64;
    println!(
        "an hour: {batches} keep-alives arrived; a radio with {} links is busy with them {:.2} % of the time, and with \
         advertising {:.2} %; together at most {max:.2} %",
        ROBOTS_OF_A_FLEET - 1,
        mean(0),
        mean(1),
    );
    assert_eq!(
        hall.ended.load(Ordering::Relaxed),
        ended_before,
        "links ended"
    );
    assert_eq!(hall.links.lock().len(), PAIRS);
    let sent = 2 * PAIRS as u64 * (HOUR.as_millis() / KEEP_ALIVE.as_millis()) as u64;
    assert!(
        batches.abs_diff(sent) <= 2 * PAIRS as u64,
        "{batches} of {sent}"
    );
    assert!(max < 5.0, "{max} %");

    // Two more robots are switched on in the crowded hall.
    let one = hall.air.radio("sim-late-1").await.expect("attaches");
    let other = hall.air.radio("sim-late-2").await.expect("attaches");
    let (one, other): (Arc<dyn Radio>, Arc<dyn Radio>) = (one, other);
    let other = Peer::on(&other).listen_as("name=late-2").await;
    let start = Instant::now();
    let near = Peer::on(&one).dial("ble/late-2").await.expect("dials");
    println!("two more are linked after {:?}", start.elapsed());
    assert!(start.elapsed() < Duration::from_secs(2));
    let far = other.incoming().await;
    within("the first message", assert_delivers(&near, &far, b"hello")).await;
    assert!(other.no_more_incoming());
    assert_eq!(other.manager.link_counts().links, 1);
}

#[tokio::test(start_paused = true)]
async fn robots_link_only_within_their_own_fleet() {
    let mut rng = Pcg32::seed_from_u64(45);
    let hall = Hall::new(FLEETS, options(), &mut rng);
    let start = Instant::now();
    hall.switch_on(Finding::Anyone, &mut rng, 500);
    // A robot has found its fleet when it is linked with one robot of it: Zenoh routes to the others.
    let mut unlinked: Vec<String> = (0..FLEETS)
        .flat_map(|fleet| (0..ROBOTS_OF_A_FLEET).map(move |robot| name(fleet, robot)))
        .collect();
    while !unlinked.is_empty() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "not linked yet: {unlinked:?}"
        );
        sleep(Duration::from_millis(10)).await;
        let links = hall.links.lock();
        unlinked.retain(|robot| links.keys().all(|(a, b)| a != robot && b != robot));
    }
    let found = start.elapsed();
    while hall.links.lock().len() < PAIRS {
        assert!(start.elapsed() < Duration::from_secs(120), "not all pairs");
        sleep(Duration::from_millis(10)).await;
    }
    println!(
        "every robot is linked with one of its fleet after {found:?}, with all after {:?}",
        start.elapsed()
    );
    assert!(found < Duration::from_secs(5));
    sleep(Duration::from_secs(60)).await;
    let fleet_of = |robot: &str| robot.rsplit_once('-').map(|(fleet, _)| fleet.to_owned());
    for (a, b) in hall.links.lock().keys() {
        assert_eq!(fleet_of(a), fleet_of(b), "{a} is linked with {b}");
    }
    assert_eq!(hall.links.lock().len(), PAIRS);
}

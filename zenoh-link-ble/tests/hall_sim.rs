//! Tests a contest hall full of robots, on the simulated air in virtual time:
//! `cargo test -p zenoh-link-ble --profile quick --test hall_sim -- --nocapture`.
mod shared {
    pub mod peer;
}

use std::{
    collections::BTreeMap,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
    time::Duration,
};

use parking_lot::Mutex;
use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};
use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble::{
    interval::ConnectionInterval,
    radio::{
        sim::{AirOptions, Condition, LinkStatus, Phy, SimAir},
        Radio,
    },
};
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use shared::peer::{assert_delivers, within, Peer};

const FLEETS: usize = 15;
const ROBOTS_OF_A_FLEET: usize = 3;
const PAIRS: usize = FLEETS * ROBOTS_OF_A_FLEET * (ROBOTS_OF_A_FLEET - 1) / 2;
/// Size of the hall and range of a robot's radio, in metres. Each robot receives about half of the others.
const HALL_M: (u32, u32) = (60, 30);
const RANGE_M: u32 = 25;
/// Interval of Zenoh's keep-alive: a quarter of its lease of 10 s.
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
/// Initial and maximum pause between dials, from `config/robot.json5`. Zenoh doubles the pause after each failure.
const RETRY: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(1));
/// All robots are switched on within this time, in milliseconds.
const ARRIVAL_MS: u32 = 5_000;
const HOUR: Duration = Duration::from_secs(3600);

fn name(fleet: usize, robot: usize) -> String {
    format!("fleet-{fleet}-{robot}")
}

/// How a robot finds the other robots of its fleet.
#[derive(Clone, Copy)]
enum Finding {
    /// It dials the others by name.
    ByName,
    /// It dials any robot of its fleet, once for each of the others.
    Anyone,
}

impl Finding {
    fn locators(self, fleet: usize, robot: usize) -> Vec<String> {
        let mates = (0..ROBOTS_OF_A_FLEET).filter(|mate| *mate != robot);
        let locator = |mate| match self {
            Self::ByName => format!("ble/{}", name(fleet, mate)),
            Self::Anyone => format!("ble/*#fleet=fleet-{fleet}"),
        };
        mates.map(locator).collect()
    }
}

/// The adapters of all robots and the links between them.
struct Hall {
    air: SimAir,
    /// Links by the sorted names of both ends: time since the link exists, and how often it was established.
    links: Mutex<BTreeMap<(String, String), (Instant, u32)>>,
    ended: AtomicU64,
    batches: AtomicU64,
}

impl Hall {
    /// Returns a hall with the positions of all robots, which are not switched on yet.
    fn new(rng: &mut Pcg32) -> Arc<Self> {
        let air = SimAir::new(AirOptions {
            seed: 45,
            condition: Condition::CrowdedHall,
            ..AirOptions::default()
        });
        let mut draw = |limit: u32| i64::from(rng.next_u32() % limit);
        let mut positions = Vec::new();
        for fleet in 0..FLEETS {
            // The robots of a fleet are within a few metres of each other.
            let (x, y) = (draw(HALL_M.0), draw(HALL_M.1));
            for robot in 0..ROBOTS_OF_A_FLEET {
                positions.push((name(fleet, robot), x + draw(6), y + draw(6)));
            }
        }
        let mut pairs_in_range = 0;
        for (n, (a, ax, ay)) in positions.iter().enumerate() {
            for (b, bx, by) in &positions[..n] {
                let distance_squared = (ax - bx).pow(2) + (ay - by).pow(2);
                if distance_squared > i64::from(RANGE_M).pow(2) {
                    air.cut_between(&format!("sim-{a}"), &format!("sim-{b}"));
                } else {
                    pairs_in_range += 1;
                }
            }
        }
        println!(
            "{} robots; each is in range of {:.0} others",
            positions.len(),
            2.0 * f64::from(pairs_in_range) / positions.len() as f64
        );
        Arc::new(Self {
            air,
            links: Mutex::default(),
            ended: AtomicU64::new(0),
            batches: AtomicU64::new(0),
        })
    }

    /// Switches all robots on, each at a random time within `within_ms`.
    fn switch_on(self: &Arc<Self>, finding: Finding, rng: &mut Pcg32, within_ms: u32) {
        for fleet in 0..FLEETS {
            for robot in 0..ROBOTS_OF_A_FLEET {
                let on_after = Duration::from_millis(u64::from(rng.next_u32() % within_ms));
                tokio::spawn(Arc::clone(self).run_robot(finding, fleet, robot, on_after));
            }
        }
    }

    /// Runs a robot after it is switched on: it listens, dials the robots of its fleet as Zenoh does, and holds its
    /// links.
    async fn run_robot(
        self: Arc<Self>,
        finding: Finding,
        fleet: usize,
        robot: usize,
        on_after: Duration,
    ) {
        sleep(on_after).await;
        let own = name(fleet, robot);
        let adapter = self.air.radio(&format!("sim-{own}")).await;
        let radio: Arc<dyn Radio> = adapter.expect("attaches");
        let listener = format!("name={own};fleet=fleet-{fleet}");
        let peer = Arc::new(Peer::on(&radio).listen_as(&listener).await);
        for locator in finding.locators(fleet, robot) {
            let (hall, peer, own) = (Arc::clone(&self), Arc::clone(&peer), own.clone());
            tokio::spawn(async move {
                let mut wait = RETRY.0;
                loop {
                    match peer.dial(&locator).await {
                        Ok(link) => {
                            wait = RETRY.0;
                            hall.hold(&own, link, true).await;
                        }
                        Err(_) => {
                            sleep(wait).await;
                            wait = (2 * wait).min(RETRY.1);
                        }
                    }
                }
            });
        }
        loop {
            let poll_interval = Duration::from_secs(10);
            if let Ok(link) = timeout(poll_interval, peer.incoming()).await {
                let (hall, own) = (Arc::clone(&self), own.clone());
                tokio::spawn(async move { hall.hold(&own, link, false).await });
            }
        }
    }

    /// Sends keep-alives and reads until the link ends.
    async fn hold(&self, own: &str, link: LinkUnicast, dialled: bool) {
        let mut pair = [own.to_owned(), link.get_dst().address().to_string()];
        pair.sort();
        if dialled {
            let mut links = self.links.lock();
            let [a, b] = pair;
            let (_, times) = links.entry((a, b)).or_insert((Instant::now(), 0));
            *times += 1;
        }
        let writing = async {
            while link
                .write_all(&[7; 20], Some(Priority::Control))
                .await
                .is_ok()
            {
                sleep(KEEP_ALIVE).await;
            }
        };
        let reading = async {
            let mut buffer = [0; 100];
            while link
                .read(&mut buffer, Some(Priority::Control))
                .await
                .is_ok()
            {
                self.batches.fetch_add(1, Ordering::Relaxed);
            }
        };
        tokio::select! {
            () = writing => {}
            () = reading => {}
        }
        self.ended.fetch_add(1, Ordering::Relaxed);
        link.close().await.expect("closing never fails");
    }

    /// Returns the pairs of links of one robot that come from different clocks and have conflicting intervals.
    fn interval_conflicts(&self) -> Vec<(LinkStatus, LinkStatus)> {
        let links = self.air.status().links;
        let interval = |link: &LinkStatus| {
            ConnectionInterval::nearest(Duration::from_micros(link.interval_us))
        };
        let mut conflicts = Vec::new();
        for (n, a) in links.iter().enumerate() {
            for b in &links[..n] {
                let [ends_a, ends_b] = [a, b].map(|l| [&l.central, &l.peripheral]);
                let is_adjacent = ends_a.iter().any(|end| ends_b.contains(end));
                let is_one_clock = a.central == b.central;
                if is_adjacent && !is_one_clock && interval(a).conflicts_with(interval(b)) {
                    conflicts.push((a.clone(), b.clone()));
                }
            }
        }
        conflicts
    }

    /// Returns the maximum and the mean of the time for which a radio is busy with connection events.
    fn busy(&self) -> (Duration, Duration) {
        let adapters = self.air.status().adapters;
        let busy = adapters.iter().map(|adapter| adapter.stats.busy);
        let (max, sum) = busy.fold((Duration::ZERO, Duration::ZERO), |(max, sum), busy| {
            (max.max(busy), sum + busy)
        });
        (max, sum / u32::try_from(adapters.len()).expect("few"))
    }
}

/// Returns the share of airtime of a robot's advertising, which the simulated air does not model: three packets, one
/// per advertising channel, with 6 bytes of address and the 31 bytes of RECT's advertisement, every 100 ms plus a mean
/// delay of 5 ms.
fn advertising_share() -> f64 {
    let event = 3 * Phy::Le1M.airtime(6 + 31);
    event.as_secs_f64() / 0.105
}

#[tokio::test(start_paused = true)]
async fn fleets_of_45_robots_link_and_stay_linked_for_an_hour() {
    let mut rng = Pcg32::seed_from_u64(45);
    let hall = Hall::new(&mut rng);
    let start = Instant::now();
    hall.switch_on(Finding::ByName, &mut rng, ARRIVAL_MS);
    while hall.links.lock().len() < PAIRS {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "not all pairs are linked"
        );
        sleep(Duration::from_millis(10)).await;
    }
    let mut found: Vec<Duration> = hall
        .links
        .lock()
        .values()
        .map(|(since, _)| *since - start)
        .collect();
    found.sort_unstable();
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
    let (max_before, mean_before) = hall.busy();
    sleep(HOUR).await;
    let (max, mean) = hall.busy();
    let share = |busy: Duration| 100.0 * busy.as_secs_f64() / HOUR.as_secs_f64();
    let batches = hall.batches.load(Ordering::Relaxed) - batches_before;
    println!(
        "an hour: {batches} keep-alives arrived; a radio with {} links is busy with them {:.2} % of the time, at most {:.2} %; \
         advertising takes {:.2} % more (computed)",
        ROBOTS_OF_A_FLEET - 1,
        share(mean - mean_before),
        share(max - max_before),
        100.0 * advertising_share(),
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
    assert!(share(max - max_before) < 5.0);

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
    let hall = Hall::new(&mut rng);
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

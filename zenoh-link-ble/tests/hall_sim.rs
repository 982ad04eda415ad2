//! A contest hall full of robots, on the simulated air in virtual time:
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
use zenoh_link_ble::radio::{
    sim::{AirOptions, Condition, Phy, SimAir},
    Radio,
};
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use shared::peer::{says, within, Peer};

const FLEETS: usize = 15;
const ROBOTS_OF_A_FLEET: usize = 3;
const PAIRS: usize = FLEETS * ROBOTS_OF_A_FLEET * (ROBOTS_OF_A_FLEET - 1) / 2;
/// The hall and how far a robot is heard in it, in metres: each hears about half of the others.
const HALL_M: (u32, u32) = (60, 30);
const RANGE_M: u32 = 25;
/// Zenoh's keep-alive: a quarter of its lease of 10 s.
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
/// `config/robot.json5`: Zenoh dials again after so long, then after twice as long, up to a second.
const RETRY: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(1));
/// All robots are switched on within that time.
const ARRIVAL_MS: u32 = 5_000;
const HOUR: Duration = Duration::from_secs(3600);

fn name(fleet: usize, robot: usize) -> String {
    format!("fleet-{fleet}-{robot}")
}

/// How a robot finds its fleet.
#[derive(Clone, Copy)]
enum Finding {
    /// It knows the others' names.
    ByName,
    /// It dials anyone of its fleet, as often as there can be others.
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

/// Everybody's adapter and who is linked with whom.
struct Hall {
    air: SimAir,
    /// Who is linked, by both names in order: since when it is there, and how often it was made.
    links: Mutex<BTreeMap<(String, String), (Instant, u32)>>,
    ended: AtomicU64,
    batches: AtomicU64,
}

impl Hall {
    /// A hall with its robots in place, not switched on yet.
    fn new(dice: &mut Pcg32) -> Arc<Self> {
        let air = SimAir::new(AirOptions {
            seed: 45,
            condition: Condition::CrowdedHall,
            ..AirOptions::default()
        });
        let mut draw = |limit: u32| i64::from(dice.next_u32() % limit);
        let mut places = Vec::new();
        for fleet in 0..FLEETS {
            // A fleet stays together, within a few metres.
            let (x, y) = (draw(HALL_M.0), draw(HALL_M.1));
            for robot in 0..ROBOTS_OF_A_FLEET {
                places.push((name(fleet, robot), x + draw(6), y + draw(6)));
            }
        }
        let mut pairs_in_range = 0;
        for (n, (a, ax, ay)) in places.iter().enumerate() {
            for (b, bx, by) in &places[..n] {
                let distance_squared = (ax - bx).pow(2) + (ay - by).pow(2);
                if distance_squared > i64::from(RANGE_M).pow(2) {
                    air.cut_between(&format!("sim-{a}"), &format!("sim-{b}"));
                } else {
                    pairs_in_range += 1;
                }
            }
        }
        println!(
            "{} robots; each hears {:.0} others",
            places.len(),
            2.0 * f64::from(pairs_in_range) / places.len() as f64
        );
        Arc::new(Self {
            air,
            links: Mutex::default(),
            ended: AtomicU64::new(0),
            batches: AtomicU64::new(0),
        })
    }

    /// All robots, each at some time within that.
    fn switch_on(self: &Arc<Self>, finding: Finding, dice: &mut Pcg32, within_ms: u32) {
        for fleet in 0..FLEETS {
            for robot in 0..ROBOTS_OF_A_FLEET {
                let on_after = Duration::from_millis(u64::from(dice.next_u32() % within_ms));
                tokio::spawn(Arc::clone(self).live(finding, fleet, robot, on_after));
            }
        }
    }

    /// A robot, from when it is switched on: it listens, dials each of its fleet as Zenoh does, and holds its links.
    async fn live(
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
        let peer = Arc::new(Peer::on(&radio).listens_as(&listener).await);
        for locator in finding.locators(fleet, robot) {
            let (hall, peer, own) = (Arc::clone(&self), Arc::clone(&peer), own.clone());
            tokio::spawn(async move {
                let mut wait = RETRY.0;
                loop {
                    match peer.dials(&locator).await {
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
            let a_while = Duration::from_secs(10);
            if let Ok(link) = timeout(a_while, peer.incoming()).await {
                let (hall, own) = (Arc::clone(&self), own.clone());
                tokio::spawn(async move { hall.hold(&own, link, false).await });
            }
        }
    }

    /// Says something every now and then, and reads, as long as the link lives.
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

    /// The most, and the mean, of the share of time that a radio is taken by connection events.
    fn busy(&self) -> (Duration, Duration) {
        let adapters = self.air.status().adapters;
        let busy = adapters.iter().map(|adapter| adapter.stats.busy);
        let (most, all) = busy.fold((Duration::ZERO, Duration::ZERO), |(most, all), busy| {
            (most.max(busy), all + busy)
        });
        (most, all / u32::try_from(adapters.len()).expect("few"))
    }
}

/// Airtime of the advertising that a robot does all the time, which the air does not count: three packets, one for each
/// advertising channel, of 6 bytes of address and the 31 of RECT's advertisement, every 100 ms and half of the 10 ms of delay.
fn advertising_share() -> f64 {
    let event = 3 * Phy::Le1M.airtime(6 + 31);
    event.as_secs_f64() / 0.105
}

#[tokio::test(start_paused = true)]
async fn in_a_hall_of_45_robots_every_fleet_finds_itself_and_stays_linked_for_an_hour() {
    let mut dice = Pcg32::seed_from_u64(45);
    let hall = Hall::new(&mut dice);
    let start = Instant::now();
    hall.switch_on(Finding::ByName, &mut dice, ARRIVAL_MS);
    while hall.links.lock().len() < PAIRS {
        assert!(start.elapsed() < Duration::from_secs(60), "not all found");
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
    // The last one on, its listener's search for another of its name, and a dial or two.
    assert!(found[PAIRS - 1] < Duration::from_secs(15));

    sleep(Duration::from_secs(10)).await;
    let (ended_before, batches_before) = (
        hall.ended.load(Ordering::Relaxed),
        hall.batches.load(Ordering::Relaxed),
    );
    let (most_before, mean_before) = hall.busy();
    sleep(HOUR).await;
    let (most, mean) = hall.busy();
    let share = |busy: Duration| 100.0 * busy.as_secs_f64() / HOUR.as_secs_f64();
    let batches = hall.batches.load(Ordering::Relaxed) - batches_before;
    println!(
        "an hour: {batches} keep-alives arrived; a radio with {} links is taken by them {:.2} % of the time, at most {:.2} %; \
         advertising takes {:.2} % more (computed)",
        ROBOTS_OF_A_FLEET - 1,
        share(mean - mean_before),
        share(most - most_before),
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
    assert!(share(most - most_before) < 5.0);

    // Two more come into the full hall.
    let one = hall.air.radio("sim-late-1").await.expect("attaches");
    let other = hall.air.radio("sim-late-2").await.expect("attaches");
    let (one, other): (Arc<dyn Radio>, Arc<dyn Radio>) = (one, other);
    let other = Peer::on(&other).listens_as("name=late-2").await;
    let start = Instant::now();
    let near = Peer::on(&one).dials("ble/late-2").await.expect("dials");
    println!("two more are linked after {:?}", start.elapsed());
    assert!(start.elapsed() < Duration::from_secs(2));
    let far = other.incoming().await;
    within("a word", says(&near, &far, b"hello")).await;
    assert!(other.no_more_incoming());
    assert_eq!(other.manager.census().links, 1);
}

#[tokio::test(start_paused = true)]
async fn in_a_hall_of_15_fleets_each_robot_finds_its_own_and_never_a_stranger() {
    let mut dice = Pcg32::seed_from_u64(45);
    let hall = Hall::new(&mut dice);
    let start = Instant::now();
    hall.switch_on(Finding::Anyone, &mut dice, 500);
    // A robot has found its fleet when it is linked with one of it: Zenoh routes to the others.
    let mut lonely: Vec<String> = (0..FLEETS)
        .flat_map(|fleet| (0..ROBOTS_OF_A_FLEET).map(move |robot| name(fleet, robot)))
        .collect();
    while !lonely.is_empty() {
        assert!(
            start.elapsed() < Duration::from_secs(60),
            "still alone: {lonely:?}"
        );
        sleep(Duration::from_millis(10)).await;
        let links = hall.links.lock();
        lonely.retain(|robot| links.keys().all(|(a, b)| a != robot && b != robot));
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

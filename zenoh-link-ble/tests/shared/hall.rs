//! Simulates a contest hall: fleets of robots at random positions, on the simulated air in virtual time.
use std::{
    collections::BTreeMap,
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
    time::Duration,
};

use parking_lot::Mutex;
use rand_pcg::{rand_core::RngCore, Pcg32};
use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble_air::{AdapterStats, AirOptions, LinkStatus, SimAir};
use zenoh_link_ble_radio::{interval::ConnectionInterval, Radio};
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::peer::Peer;

pub const ROBOTS_OF_A_FLEET: usize = 3;
/// Size of the hall and range of a robot's radio, in metres. Each robot receives about half of the others.
const HALL_M: (u32, u32) = (60, 30);
const RANGE_M: u32 = 25;
/// Interval of Zenoh's keep-alive: a quarter of its lease of 10 s.
pub const KEEP_ALIVE: Duration = Duration::from_millis(2500);
/// Initial and maximum pause between dials, from `config/robot.json5`. Zenoh doubles the pause after each failure.
const RETRY: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(1));

pub fn name(fleet: usize, robot: usize) -> String {
    format!("fleet-{fleet}-{robot}")
}

/// How a robot finds the other robots of its fleet.
#[derive(Clone, Copy)]
pub enum Finding {
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
pub struct Hall {
    fleets: usize,
    pub air: SimAir,
    /// Links by the sorted names of both ends: time since the link exists, and how often it was established.
    pub links: Mutex<BTreeMap<(String, String), (Instant, u32)>>,
    pub ended: AtomicU64,
    pub batches: AtomicU64,
}

impl Hall {
    /// Returns a hall with the positions of all robots, which are not switched on yet.
    pub fn new(fleets: usize, options: AirOptions, rng: &mut Pcg32) -> Arc<Self> {
        let air = SimAir::new(options);
        let mut draw = |limit: u32| i64::from(rng.next_u32() % limit);
        let mut positions = Vec::new();
        for fleet in 0..fleets {
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
            fleets,
            air,
            links: Mutex::default(),
            ended: AtomicU64::new(0),
            batches: AtomicU64::new(0),
        })
    }

    /// Switches all robots on, each at a random time within `within_ms`.
    pub fn switch_on(self: &Arc<Self>, finding: Finding, rng: &mut Pcg32, within_ms: u32) {
        for fleet in 0..self.fleets {
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
    pub fn interval_conflicts(&self) -> Vec<(LinkStatus, LinkStatus)> {
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

    /// Returns the number of pairs of robots of the same fleet.
    pub fn pairs(&self) -> usize {
        self.fleets * ROBOTS_OF_A_FLEET * (ROBOTS_OF_A_FLEET - 1) / 2
    }

    /// Waits until all pairs are linked, and returns the time of each link since `start`, sorted.
    pub async fn all_linked(&self, start: Instant) -> Vec<Duration> {
        while self.links.lock().len() < self.pairs() {
            let limit = Duration::from_secs(120);
            assert!(start.elapsed() < limit, "not all pairs are linked");
            sleep(Duration::from_millis(10)).await;
        }
        let links = self.links.lock();
        let mut linked: Vec<_> = links.values().map(|(since, _)| *since - start).collect();
        linked.sort_unstable();
        linked
    }

    /// Returns the traffic of each robot's radio.
    pub fn stats(&self) -> Vec<AdapterStats> {
        let adapters = self.air.status().adapters;
        adapters.iter().map(|adapter| adapter.stats).collect()
    }
}

//! Links that collide on the radio of one robot, because something else than RECT has set their intervals.
use std::{sync::Arc, time::Duration};

use tokio::time::{sleep, Instant};
use zenoh_link_ble_air::{AirOptions, Arbitration, Condition, SimAir};
use zenoh_link_ble_radio::{interval::ConnectionInterval, Radio};
use zenoh_link_commons::LinkUnicast;

use crate::shared::peer::Peer;

/// Three robots: `far` is dialled by `middle`, and `middle` by `near`.
struct Chain {
    air: SimAir,
    middle_radio: Arc<dyn Radio>,
    middle: Peer,
    far: Peer,
    near: Peer,
    /// Both ends of the link from `near` to `middle`, then of the link from `middle` to `far`.
    links: [LinkUnicast; 4],
}

impl Chain {
    async fn new(arbitration: Arbitration) -> Self {
        let air = SimAir::new(AirOptions {
            condition: Condition::Desk,
            // The events of the two links overlap within minutes, and for longer than a supervision timeout.
            max_clock_drift_ppm: 100,
            arbitration,
            ..AirOptions::default()
        });
        let radio = async |name: &str| {
            let radio: Arc<dyn Radio> = air.radio(name).await.expect("attaches");
            radio
        };
        let middle_radio = radio("sim-middle").await;
        let far = Peer::on(&radio("sim-far").await)
            .listen_as("name=far")
            .await;
        let middle = Peer::on(&middle_radio).listen_as("name=middle").await;
        let near = Peer::on(&radio("sim-near").await);
        sleep(Duration::from_secs(3)).await;
        let a = near.dial("ble/middle").await.expect("dials");
        let b = middle.incoming().await;
        let c = middle.dial("ble/far").await.expect("dials");
        let d = far.incoming().await;
        Self {
            links: [a, b, c, d],
            middle_radio,
            middle,
            far,
            near,
            air,
        }
    }

    /// Returns the intervals of the links from `near` and to `far`, if they exist.
    fn intervals(&self) -> [Option<ConnectionInterval>; 2] {
        let links = self.air.status().links;
        ["sim-near", "sim-middle"].map(|central| {
            let link = links.iter().find(|link| link.central == central)?;
            let interval = Duration::from_micros(link.interval_us);
            Some(ConnectionInterval::nearest(interval))
        })
    }

    fn has_conflict(&self) -> bool {
        match self.intervals() {
            [Some(a), Some(b)] => a.conflicts_with(b),
            _ => false,
        }
    }

    /// Gives both links the same interval, behind RECT's back.
    async fn make_equal(&self) {
        let far = self.air.radio("sim-far").await.expect("attached");
        let far = far.address().await.expect("an address");
        let interval = self.intervals()[0].expect("linked");
        assert!(self.middle_radio.set_interval(far, interval).await);
        let start = Instant::now();
        while !self.has_conflict() {
            assert!(
                start.elapsed() < Duration::from_secs(5),
                "{:?}",
                self.intervals()
            );
            sleep(Duration::from_millis(10)).await;
        }
    }
}

/// Reads until the link ends.
async fn read_all(link: &LinkUnicast) {
    let mut buffer = [0; 1000];
    while link.read(&mut buffer, None).await.is_ok() {}
}

#[tokio::test(start_paused = true)]
async fn lost_link_has_another_interval_when_it_is_dialled_again() {
    let chain = Chain::new(Arbitration::FirstCome).await;
    assert!(!chain.has_conflict());
    chain.make_equal().await;
    // Nothing is sent, and one of the two links is lost.
    let [_, b, c, _] = &chain.links;
    let lost = async {
        tokio::select! {
            () = read_all(b) => (&chain.near, "ble/middle", &chain.middle),
            () = read_all(c) => (&chain.middle, "ble/far", &chain.far),
        }
    };
    let limit = Duration::from_secs(3600);
    let lost = tokio::time::timeout(limit, lost).await;
    let (dialler, peer, listener) = lost.expect("a link is lost");
    let _again = dialler.dial(peer).await.expect("dials");
    let _accepted = listener.incoming().await;
    sleep(Duration::from_secs(1)).await;
    assert!(!chain.has_conflict(), "{:?}", chain.intervals());
}

#[tokio::test(start_paused = true)]
async fn starved_link_changes_its_interval() {
    let chain = Chain::new(Arbitration::TimeoutFirst).await;
    chain.make_equal().await;
    let [a, b, c, d] = &chain.links;
    let send = async |link: &LinkUnicast| while link.write_all(&[7; 700], None).await.is_ok() {};
    let start = Instant::now();
    tokio::select! {
        () = send(a) => panic!("the link to middle ended"),
        () = send(c) => panic!("the link to far ended"),
        () = read_all(b) => panic!("the link to middle ended"),
        () = read_all(d) => panic!("the link to far ended"),
        () = async {
            while chain.has_conflict() {
                assert!(start.elapsed() < Duration::from_secs(600), "{:?}", chain.intervals());
                sleep(Duration::from_millis(100)).await;
            }
        } => {}
    }
    println!("another interval after {:?}", start.elapsed());
}

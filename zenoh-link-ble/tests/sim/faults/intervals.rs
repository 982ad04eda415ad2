//! Links that collide on the radio of one robot, because something else than RECT has set their intervals, and a central that
//! cannot change the interval of an open link.
use std::{sync::Arc, time::Duration};

use link_lanes::{
    goodbye::Goodbye,
    hello::{Hello, IntervalUnits},
    lanes::sdu::Content,
};
use tokio::time::{sleep, Instant};
use zenoh_link_ble_air::{AirOptions, Arbitration, Condition, SimAir};
use zenoh_link_ble_radio::{interval::ConnectionInterval, Radio};
use zenoh_link_commons::LinkUnicast;

use crate::{
    contract::advertisement,
    shared::{
        listener::OPTIONS,
        peer::{within, Peer},
        raw::{hello, RawPeer},
    },
};

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

/// Returns the next connection interval that the peer announces, in units of 1.25 ms.
async fn announced(raw: &mut RawPeer) -> u16 {
    within("an interval", async {
        loop {
            let received = raw.receive().await.expect("the link is open");
            if let Content::Interval(units) = received {
                return units;
            }
        }
    })
    .await
}

/// Linux before 6.11 changes the interval only for the next connection.
#[tokio::test(start_paused = true)]
async fn central_announces_the_interval_in_force() {
    for changes_open_connections in [true, false] {
        let air = SimAir::new(AirOptions {
            condition: Condition::Desk,
            changes_open_connections,
            ..AirOptions::default()
        });
        let near: Arc<dyn Radio> = air.radio("sim-near").await.expect("attaches");
        let far: Arc<dyn Radio> = air.radio("sim-far").await.expect("attaches");
        let preferred = near.default_interval().units();
        let in_force = || {
            let interval = Duration::from_micros(air.status().links[0].interval_us);
            ConnectionInterval::nearest(interval).units()
        };
        let a = Peer::on(&near);
        let mut requested = Vec::new();
        for _ in 0..2 {
            let listener = far.listen(None, OPTIONS).await.expect("listens");
            let advertised = advertisement(listener.psm(), "raw");
            let advertising = far.advertise(&advertised, "raw").await.expect("advertises");
            // The peer has another link with the interval that the dialler prefers.
            let intervals = IntervalUnits {
                requested: None,
                avoid: vec![preferred],
            };
            let own = Hello {
                intervals: Some(intervals),
                ..hello(6, "raw")
            };
            let accepting = async {
                let channel = listener.accept().await.expect("accepts");
                RawPeer::accept(channel, own).await
            };
            let (dialled, (mut raw, peer)) = tokio::join!(a.dial("ble/raw"), accepting);
            let link = dialled.expect("dials");
            requested.push(peer.intervals.and_then(|own| own.requested));
            let is_first = requested.len() == 1;
            if is_first && !changes_open_connections {
                // Not the one that both sides have computed.
                assert_eq!(announced(&mut raw).await, preferred);
            }
            sleep(Duration::from_secs(2)).await;
            let expected = match (changes_open_connections, is_first) {
                (true, _) => preferred + 1,
                (false, true) => preferred,
                (false, false) => preferred + 2,
            };
            assert_eq!(in_force(), expected, "{requested:?}");
            if is_first {
                raw.send(Content::Interval(preferred + 2)).await;
                let answer = announced(&mut raw).await;
                sleep(Duration::from_secs(2)).await;
                assert_eq!(answer, in_force(), "{requested:?}");
            }
            raw.send(Content::Goodbye(Goodbye::Closing.code())).await;
            assert_eq!(raw.receive_goodbye().await, None, "the channel is down");
            drop(advertising);
            let end = within("the end", link.read(&mut [0; 100], None)).await;
            assert!(end.is_err());
            link.close().await.expect("closes");
        }
        if !changes_open_connections {
            let expected = [preferred, preferred + 2].map(Some);
            assert_eq!(requested, expected, "the next dial requests the other one");
        }
    }
}

//! Tests peers without the team's secret that are in range:
//! `cargo test -p zenoh-link-ble --test sim rejected_peers`.
use std::{sync::Arc, time::Duration};

use tokio::{
    task::JoinSet,
    time::{timeout, Instant},
};
use zenoh_link_ble_air::{AirOptions, SimAir};
use zenoh_link_ble_radio::Radio;

use crate::shared::{
    listener::{psm_of, OPTIONS},
    peer::{assert_delivers, Peer},
};

/// More than the maximum number of links of a robot.
const INTRUDERS: usize = 12;

#[tokio::test(start_paused = true)]
async fn finds_its_fleet_among_intruders_that_use_the_fleets_name() {
    let folder = tempfile::tempdir().expect("makes a folder");
    let (ours, theirs) = (folder.path().join("ours"), folder.path().join("theirs"));
    std::fs::write(&ours, "fleet:what only we know").expect("writes");
    std::fs::write(&theirs, "fleet:what only they know").expect("writes");
    let air = SimAir::new(AirOptions::default());
    let robot = |name: String, options: String| {
        let air = air.clone();
        async move {
            let radio: Arc<dyn Radio> = air.radio(&format!("sim-{name}")).await.expect("attaches");
            let options = format!("name={name};fleet=lions{options}");
            Peer::on(&radio).listen_as(&options).await
        }
    };
    let mut intruders = Vec::new();
    for n in 0..INTRUDERS {
        // Half of them have another secret and half have none: listeners without a secret accept every peer.
        let secret = match n % 2 {
            0 => String::new(),
            _ => format!(";secret={}", theirs.display()),
        };
        intruders.push(robot(format!("intruder-{n}"), secret).await);
    }
    let secret = format!(";secret={}", ours.display());
    let mate = robot("mate".to_owned(), secret.clone()).await;
    let own = robot("own".to_owned(), secret).await;

    let start = Instant::now();
    let near = timeout(Duration::from_secs(60), async {
        loop {
            if let Ok(link) = own.dial("ble/*#fleet=lions").await {
                return link;
            }
        }
    })
    .await
    .expect("finds its fleet");
    println!("found after {:.1} s", start.elapsed().as_secs_f64());
    let far = mate.incoming().await;
    assert_delivers(&near, &far, b"there").await;
    // Dialling an intruder by name fails too, and no intruder can dial in.
    for name in ["ble/intruder-0", "ble/intruder-1"] {
        own.dial(name).await.expect_err(name);
    }
    for intruder in &intruders {
        intruder.dial("ble/own").await.expect_err("an intruder");
    }
    assert!(own.no_more_incoming());
}

/// Each intruder has its own address, keeps its channel open as long as possible, and then opens the next one.
#[tokio::test(start_paused = true)]
async fn intruders_that_occupy_all_handshakes_do_not_delay_a_robot() {
    let folder = tempfile::tempdir().expect("makes a folder");
    let ours = folder.path().join("ours");
    std::fs::write(&ours, "fleet:what only we know").expect("writes");
    let secret = format!("secret={}", ours.display());
    let air = SimAir::new(AirOptions::default());
    let radio = async |name: String| {
        let radio: Arc<dyn Radio> = air.radio(&name).await.expect("attaches");
        radio
    };
    let base = radio("sim-base".to_owned()).await;
    let listener = Peer::on(&base)
        .listen_as(&format!("name=base;{secret}"))
        .await;
    let to = base.address().await.expect("has an address");
    let mut intruders = JoinSet::new();
    for n in 0..INTRUDERS {
        let radio = radio(format!("sim-intruder-{n}")).await;
        let psm = psm_of(&radio, &base).await;
        intruders.spawn(async move {
            loop {
                if let Ok(channel) = radio.connect(to, psm, OPTIONS).await {
                    while channel.recv(&mut [0; 100]).await.is_ok() {}
                }
            }
        });
    }
    tokio::time::sleep(Duration::from_secs(2)).await;
    let robot = Peer::on(&radio("sim-robot".to_owned()).await);
    for n in 0..10 {
        let start = Instant::now();
        let locator = format!("ble/base#{secret}");
        let near = robot.dial(&locator).await.expect("is accepted immediately");
        println!("dial {n}: linked after {:?}", start.elapsed());
        assert!(
            start.elapsed() < Duration::from_secs(3),
            "{:?}",
            start.elapsed()
        );
        let far = listener.incoming().await;
        assert_delivers(&near, &far, b"there").await;
        let mut buffer = [0; 10];
        let (closed, _) = tokio::join!(near.close(), far.read(&mut buffer, None));
        closed.expect("closes");
        far.close().await.expect("closes");
    }
}

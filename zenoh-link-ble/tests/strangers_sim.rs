//! Strangers in range of a team with a secret, on the simulated air in virtual time:
//! `cargo test -p zenoh-link-ble --test strangers_sim`.
mod shared {
    pub mod listener;
    pub mod peer;
}

use std::{sync::Arc, time::Duration};

use shared::{
    listener::{psm_of, OPTIONS},
    peer::{says, Peer},
};
use tokio::{
    task::JoinSet,
    time::{timeout, Instant},
};
use zenoh_link_ble::radio::{
    sim::{AirOptions, SimAir},
    Radio,
};

/// More than a robot's links.
const STRANGERS: usize = 12;

#[tokio::test(start_paused = true)]
async fn a_crowd_that_takes_our_fleets_name_does_not_keep_us_from_our_own() {
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
            Peer::on(&radio).listens_as(&options).await
        }
    };
    let mut strangers = Vec::new();
    for n in 0..STRANGERS {
        // Some with a secret of their own, some without: their listeners take anybody.
        let secret = match n % 2 {
            0 => String::new(),
            _ => format!(";secret={}", theirs.display()),
        };
        strangers.push(robot(format!("stranger-{n}"), secret).await);
    }
    let secret = format!(";secret={}", ours.display());
    let mate = robot("mate".to_owned(), secret.clone()).await;
    let own = robot("own".to_owned(), secret).await;

    let start = Instant::now();
    let near = timeout(Duration::from_secs(60), async {
        loop {
            if let Ok(link) = own.dials("ble/*#fleet=lions").await {
                return link;
            }
        }
    })
    .await
    .expect("finds its own");
    println!("found after {:.1} s", start.elapsed().as_secs_f64());
    let far = mate.incoming().await;
    says(&near, &far, b"there").await;
    // Nor by name, and they do not get in by themselves.
    for name in ["ble/stranger-0", "ble/stranger-1"] {
        own.dials(name).await.expect_err(name);
    }
    for stranger in &strangers {
        stranger.dials("ble/own").await.expect_err("a stranger");
    }
    assert!(own.no_more_incoming());
}

/// Each has an address of its own, keeps its channel open for as long as it is let, and opens the next one then.
#[tokio::test(start_paused = true)]
async fn strangers_that_occupy_all_handshakes_do_not_keep_a_robot_waiting() {
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
        .listens_as(&format!("name=base;{secret}"))
        .await;
    let to = base.address().await.expect("has an address");
    let mut strangers = JoinSet::new();
    for n in 0..STRANGERS {
        let radio = radio(format!("sim-stranger-{n}")).await;
        let psm = psm_of(&radio, &base).await;
        strangers.spawn(async move {
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
        let near = robot.dials(&locator).await.expect("is let in at once");
        println!("dial {n}: linked after {:?}", start.elapsed());
        assert!(
            start.elapsed() < Duration::from_secs(3),
            "{:?}",
            start.elapsed()
        );
        let far = listener.incoming().await;
        says(&near, &far, b"there").await;
        let mut buffer = [0; 10];
        let (closed, _) = tokio::join!(near.close(), far.read(&mut buffer, None));
        closed.expect("closes");
        far.close().await.expect("closes");
    }
}

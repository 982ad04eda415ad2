//! Tests the loss of a peer or an adapter, with or without a termination, and the reconnect.
use std::{sync::Arc, time::Duration};

use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble_air::{Condition, SimAir};
use zenoh_link_ble_radio::Radio;
use zenoh_link_commons::LinkUnicast;

use super::{conversation::converse_on, cuts::EVENTS};
use crate::shared::{
    pair::{Pair, RECONNECT_LIMIT, SUPERVISION},
    peer::{assert_delivers, within, Peer},
};

/// Pause until Zenoh dials again, from `config/robot.json5`.
const RETRY: Duration = Duration::from_millis(200);
/// Part of the error when the peer or the local radio is lost.
const DOWN: &str = "is down";

/// A fault, and its end.
struct Fault {
    name: &'static str,
    start: fn(&SimAir),
    end: fn(&SimAir),
    /// Maximum time until `near` and `far` detect the fault.
    notice_limits: [Duration; 2],
}

fn power(air: &SimAir, name: &str, on: bool) {
    air.power(name, on).expect("is on the air");
}

/// Limit for a fault of the local adapter.
const AT_ONCE: Duration = Duration::ZERO;
/// Limit for the loss of the peer without a termination: the supervision timeout and a margin.
const SILENTLY: Duration = Duration::from_millis(2100);
/// Limit for the loss of the peer with a termination.
const IN_ORDER: Duration = EVENTS;

const FAULTS: [Fault; 7] = [
    Fault {
        name: "the listener's adapter is switched off",
        start: |air| power(air, "sim-far", false),
        end: |air| power(air, "sim-far", true),
        notice_limits: [IN_ORDER, AT_ONCE],
    },
    Fault {
        name: "the dialler's adapter is switched off",
        start: |air| power(air, "sim-near", false),
        end: |air| power(air, "sim-near", true),
        notice_limits: [AT_ONCE, IN_ORDER],
    },
    Fault {
        name: "the listener's adapter is pulled out",
        start: |air| air.remove("sim-far").expect("is attached"),
        end: |air| power(air, "sim-far", true),
        notice_limits: [SILENTLY, AT_ONCE],
    },
    Fault {
        name: "the dialler's adapter is pulled out",
        start: |air| air.remove("sim-near").expect("is attached"),
        end: |air| power(air, "sim-near", true),
        notice_limits: [AT_ONCE, SILENTLY],
    },
    Fault {
        name: "both adapters are switched off",
        start: |air| {
            power(air, "sim-near", false);
            power(air, "sim-far", false);
        },
        end: |air| {
            power(air, "sim-near", true);
            power(air, "sim-far", true);
        },
        notice_limits: [AT_ONCE, AT_ONCE],
    },
    Fault {
        name: "range is lost",
        start: SimAir::cut,
        end: SimAir::restore,
        notice_limits: [SILENTLY, SILENTLY],
    },
    Fault {
        name: "range is lost and an adapter is switched off",
        start: |air| {
            air.cut();
            power(air, "sim-far", false);
        },
        end: |air| {
            power(air, "sim-far", true);
            air.restore();
        },
        notice_limits: [SILENTLY, AT_ONCE],
    },
];

/// Asserts that a read of the link fails within `limit`, and a write after it too. Then drops the link, as Zenoh does.
async fn assert_ends(link: LinkUnicast, limit: Duration, what: &str) {
    let mut buffer = [0; 100];
    let reading = link.read(&mut buffer, None);
    let error = timeout(limit + Duration::from_millis(1), reading)
        .await
        .unwrap_or_else(|_| panic!("{what}: not detected within {limit:?}"))
        .expect_err("the link ended");
    assert!(error.to_string().contains(DOWN), "{what}: {error}");
    let error = link
        .write_all(b"?", None)
        .await
        .expect_err("the link ended");
    assert!(error.to_string().contains(DOWN), "{what}: {error}");
}

#[tokio::test(start_paused = true)]
async fn both_sides_detect_every_fault_and_reconnect_after_it() {
    let pair = Pair::on(Condition::Room, 1).await;
    let before = pair.resources();
    for (
        Fault {
            name,
            start,
            end,
            notice_limits,
        },
        stays_away_ms,
    ) in FAULTS
        .iter()
        .flat_map(|fault| [0, 50, 1000, 4000, 61_000].map(|away_ms| (fault, away_ms)))
    {
        let what = format!("{name}, ended {stays_away_ms} ms after both detected it");
        let (near, far) = pair.link().await;
        start(&pair.air);
        tokio::join!(
            assert_ends(near, notice_limits[0], &what),
            assert_ends(far, notice_limits[1], &what)
        );
        sleep(Duration::from_millis(stays_away_ms)).await;
        end(&pair.air);
        drop(pair.link_again(Instant::now(), &what).await);
        assert_eq!(pair.resources_after_cleanup().await, before, "{what}");
    }
}

#[tokio::test(start_paused = true)]
async fn reconnects_within_a_second_after_an_adapter_reset() {
    let pair = Pair::on(Condition::Room, 2).await;
    for name in ["sim-near", "sim-far"] {
        let (near, far) = pair.link().await;
        let start = Instant::now();
        power(&pair.air, name, false);
        power(&pair.air, name, true);
        let what = format!("{name} is reset");
        tokio::join!(
            assert_ends(near, IN_ORDER, &what),
            assert_ends(far, IN_ORDER, &what)
        );
        drop(pair.link_again(start, &what).await);
    }
}

#[tokio::test(start_paused = true)]
async fn listener_with_wait_option_waits_for_its_adapter() {
    let pair = Pair::on(Condition::Room, 5).await;
    let radio: Arc<dyn Radio> = pair.air.radio("sim-late").await.expect("attaches");
    for (reason, disable) in [
        (
            "is switched off",
            (|air| power(air, "sim-late", false)) as fn(&SimAir),
        ),
        ("there is no", |air| {
            air.remove("sim-late").expect("is attached")
        }),
    ] {
        let late = Peer::on(&radio);
        disable(&pair.air);
        let error = late.try_listen("name=late").await.expect_err(reason);
        assert!(error.to_string().contains(reason), "{error}");
        late.try_listen("name=late;wait=true").await.expect(reason);
        sleep(Duration::from_secs(61)).await;
        power(&pair.air, "sim-late", true);
        let start = Instant::now();
        let link = pair.near.dial("ble/late").await.expect("dials");
        assert!(
            start.elapsed() <= RECONNECT_LIMIT,
            "{reason}: {:?}",
            start.elapsed()
        );
        assert_delivers(&link, &late.incoming().await, b"there").await;
    }
}

#[tokio::test(start_paused = true)]
async fn detects_a_killed_peer_immediately_and_reconnects_after_its_restart() {
    let mut pair = Pair::on(Condition::Room, 3).await;
    for n in 0..10 {
        let what = format!("run {n} is killed");
        let (near, far) = pair.link().await;
        let radio: Arc<dyn Radio> = pair.air.radio("sim-far").await.expect("is attached");
        // A killed program sends no goodbye; its kernel closes its channels.
        drop(far);
        let idle = Peer::on(&radio);
        drop(std::mem::replace(&mut pair.far, idle));
        assert_ends(near, IN_ORDER, &what).await;
        pair.far = Peer::on(&radio).listen_as("name=far").await;
        drop(pair.link_again(Instant::now(), &what).await);
        assert_eq!(pair.near.manager.link_counts().links, 0, "{what}");
    }
}

/// The dialling program is killed and dials again before its peer has detected the end.
#[tokio::test(start_paused = true)]
async fn restarted_dialler_replaces_its_earlier_link() {
    let mut pair = Pair::on(Condition::Room, 4).await;
    let radio: Arc<dyn Radio> = pair.air.radio("sim-near").await.expect("is attached");
    for n in 0..10 {
        let (near, far) = pair.link().await;
        let start = Instant::now();
        drop(near);
        pair.near = Peer::on(&radio);
        let what = format!("run {n} of the dialler");
        let detection = assert_ends(far, RECONNECT_LIMIT, &what);
        drop(tokio::join!(pair.link_again(start, &what), detection));
    }
}

/// Half-open link: one side was lost without a termination and is back before the other side has detected it.
#[tokio::test(start_paused = true)]
async fn replaces_a_half_open_link_after_the_supervision_timeout() {
    for away_ms in [1, 40, 500, 1500, 1990] {
        let what = format!("back after {away_ms} ms");
        let pair = Pair::on(Condition::Room, away_ms).await;
        let before = pair.resources();
        let (near, far) = pair.link().await;
        let start = Instant::now();
        pair.air.remove("sim-near").expect("is attached");
        assert_ends(near, AT_ONCE, &what).await;
        sleep(Duration::from_millis(away_ms)).await;
        power(&pair.air, "sim-near", true);
        // The peer's radio keeps the old connection until its supervision timeout, and accepts no other one before.
        let again = async {
            // A connect that the peer does not accept yet may time out; Zenoh tries again.
            loop {
                match pair.near.dial("ble/far").await {
                    Ok(link) => break (link, start.elapsed()),
                    Err(error) => println!("{what}: {error}"),
                }
                sleep(RETRY).await;
            }
        };
        let ((link, took), ()) = tokio::join!(again, assert_ends(far, SILENTLY, &what));
        assert!(
            took <= SUPERVISION + RETRY + RECONNECT_LIMIT,
            "{what}: {took:?}"
        );
        drop((pair.far.incoming().await, link));
        assert!(pair.far.no_more_incoming(), "{what}: a second link");
        assert_eq!(pair.resources_after_cleanup().await, before, "{what}");
    }
}

/// The radio condition becomes very bad for short times, repeatedly, during a conversation.
#[tokio::test(start_paused = true)]
async fn bursts_of_loss_lose_no_batches() {
    for seed in 0..30 {
        let pair = Pair::on(Condition::Room, seed).await;
        let (near, far) = pair.link().await;
        let bursts = async {
            loop {
                pair.air.set_condition(Condition::EdgeOfRange);
                sleep(Duration::from_millis(200 + 10 * seed)).await;
                pair.air.cut();
                sleep(Duration::from_millis(300)).await;
                pair.air.restore();
                pair.air.set_condition(Condition::CrowdedHall);
                sleep(Duration::from_millis(300)).await;
            }
        };
        let outcome = tokio::select! {
            outcome = within("the conversation", converse_on(&near, &far)) => outcome,
            () = bursts => unreachable!("the bursts continue forever"),
        };
        assert!(outcome.is_whole, "seed {seed}: {:?}", outcome.reasons);
    }
}

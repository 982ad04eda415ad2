//! A peer or an adapter goes away, with or without a word, and comes back.
use std::{sync::Arc, time::Duration};

use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble::radio::{
    sim::{Condition, SimAir},
    Radio,
};
use zenoh_link_commons::LinkUnicast;

use super::{conversation::held_on, cuts::EVENTS};
use crate::shared::{
    pair::{Pair, BACK, SUPERVISION},
    peer::{says, within, Peer},
};

/// `config/robot.json5`: when Zenoh dials again.
const RETRY: Duration = Duration::from_millis(200);
/// What an owner is told when the other end, or its own radio, is not there any more.
const DOWN: &str = "is down";

/// One way of going away, and of coming back.
struct Fault {
    name: &'static str,
    strikes: fn(&SimAir),
    mends: fn(&SimAir),
    /// How soon `near` and `far` are told.
    told: [Duration; 2],
}

fn power(air: &SimAir, name: &str, on: bool) {
    air.power(name, on).expect("is on the air");
}

const AT_ONCE: Duration = Duration::ZERO;
const SILENTLY: Duration = Duration::from_millis(2100);
const IN_ORDER: Duration = EVENTS;

const FAULTS: [Fault; 7] = [
    Fault {
        name: "the listener's adapter is switched off",
        strikes: |air| power(air, "sim-far", false),
        mends: |air| power(air, "sim-far", true),
        told: [IN_ORDER, AT_ONCE],
    },
    Fault {
        name: "the dialler's adapter is switched off",
        strikes: |air| power(air, "sim-near", false),
        mends: |air| power(air, "sim-near", true),
        told: [AT_ONCE, IN_ORDER],
    },
    Fault {
        name: "the listener's adapter is pulled out",
        strikes: |air| air.remove("sim-far").expect("is there"),
        mends: |air| power(air, "sim-far", true),
        told: [SILENTLY, AT_ONCE],
    },
    Fault {
        name: "the dialler's adapter is pulled out",
        strikes: |air| air.remove("sim-near").expect("is there"),
        mends: |air| power(air, "sim-near", true),
        told: [AT_ONCE, SILENTLY],
    },
    Fault {
        name: "both adapters are switched off",
        strikes: |air| {
            power(air, "sim-near", false);
            power(air, "sim-far", false);
        },
        mends: |air| {
            power(air, "sim-near", true);
            power(air, "sim-far", true);
        },
        told: [AT_ONCE, AT_ONCE],
    },
    Fault {
        name: "range is lost",
        strikes: SimAir::cut,
        mends: SimAir::restore,
        told: [SILENTLY, SILENTLY],
    },
    Fault {
        name: "range is lost and an adapter is switched off",
        strikes: |air| {
            air.cut();
            power(air, "sim-far", false);
        },
        mends: |air| {
            power(air, "sim-far", true);
            air.restore();
        },
        told: [SILENTLY, AT_ONCE],
    },
];

/// An end is told, while it reads and writes; it lets the link go then, as Zenoh does.
async fn is_told(link: LinkUnicast, limit: Duration, what: &str) {
    let mut buffer = [0; 100];
    let reading = link.read(&mut buffer, None);
    let error = timeout(limit + Duration::from_millis(1), reading)
        .await
        .unwrap_or_else(|_| panic!("{what}: not told within {limit:?}"))
        .expect_err("it is over");
    assert!(error.to_string().contains(DOWN), "{what}: {error}");
    let error = link.write_all(b"?", None).await.expect_err("it is over");
    assert!(error.to_string().contains(DOWN), "{what}: {error}");
}

#[tokio::test(start_paused = true)]
async fn whatever_goes_both_sides_are_told_and_are_linked_again_when_it_is_back() {
    let pair = Pair::on(Condition::Room, 1).await;
    let before = pair.leftovers();
    for (
        Fault {
            name,
            strikes,
            mends,
            told,
        },
        stays_away_ms,
    ) in FAULTS
        .iter()
        .flat_map(|fault| [0, 50, 1000, 4000, 61_000].map(|away_ms| (fault, away_ms)))
    {
        let what = format!("{name}, {stays_away_ms} ms after all know");
        let (near, far) = pair.link().await;
        strikes(&pair.air);
        tokio::join!(is_told(near, told[0], &what), is_told(far, told[1], &what));
        sleep(Duration::from_millis(stays_away_ms)).await;
        mends(&pair.air);
        drop(pair.link_again(Instant::now(), &what).await);
        assert_eq!(pair.leftovers_in_the_end().await, before, "{what}");
    }
}

#[tokio::test(start_paused = true)]
async fn a_reset_of_either_adapter_is_over_in_a_second() {
    let pair = Pair::on(Condition::Room, 2).await;
    for name in ["sim-near", "sim-far"] {
        let (near, far) = pair.link().await;
        let start = Instant::now();
        power(&pair.air, name, false);
        power(&pair.air, name, true);
        let what = format!("{name} is reset");
        tokio::join!(
            is_told(near, IN_ORDER, &what),
            is_told(far, IN_ORDER, &what)
        );
        drop(pair.link_again(start, &what).await);
    }
}

#[tokio::test(start_paused = true)]
async fn a_listener_waits_for_its_adapter_if_it_is_told_to() {
    let pair = Pair::on(Condition::Room, 5).await;
    let radio: Arc<dyn Radio> = pair.air.radio("sim-late").await.expect("attaches");
    for (off, away) in [
        (
            "is switched off",
            (|air| power(air, "sim-late", false)) as fn(&SimAir),
        ),
        ("there is no", |air| {
            air.remove("sim-late").expect("is there")
        }),
    ] {
        let late = Peer::on(&radio);
        away(&pair.air);
        let error = late.try_listen("name=late").await.expect_err(off);
        assert!(error.to_string().contains(off), "{error}");
        late.try_listen("name=late;wait=true").await.expect(off);
        sleep(Duration::from_secs(61)).await;
        power(&pair.air, "sim-late", true);
        let start = Instant::now();
        let link = pair.near.dials("ble/late").await.expect("dials");
        assert!(start.elapsed() <= BACK, "{off}: {:?}", start.elapsed());
        says(&link, &late.incoming().await, b"there").await;
    }
}

#[tokio::test(start_paused = true)]
async fn a_killed_peer_is_noticed_at_once_and_its_next_run_is_linked() {
    let mut pair = Pair::on(Condition::Room, 3).await;
    for n in 0..10 {
        let what = format!("run {n} is killed");
        let (near, far) = pair.link().await;
        let radio: Arc<dyn Radio> = pair.air.radio("sim-far").await.expect("is there");
        // A killed program says nothing; its kernel closes its channels.
        drop(far);
        let idle = Peer::on(&radio);
        drop(std::mem::replace(&mut pair.far, idle));
        is_told(near, IN_ORDER, &what).await;
        pair.far = Peer::on(&radio).listens_as("name=far").await;
        drop(pair.link_again(Instant::now(), &what).await);
        assert_eq!(pair.near.manager.census().links, 0, "{what}");
    }
}

/// The dialler's program is killed and dials anew before its peer knows.
#[tokio::test(start_paused = true)]
async fn a_dialler_that_was_restarted_replaces_its_earlier_link() {
    let mut pair = Pair::on(Condition::Room, 4).await;
    let radio: Arc<dyn Radio> = pair.air.radio("sim-near").await.expect("is there");
    for n in 0..10 {
        let (near, far) = pair.link().await;
        let start = Instant::now();
        drop(near);
        pair.near = Peer::on(&radio);
        let what = format!("run {n} of the dialler");
        let told = is_told(far, BACK, &what);
        drop(tokio::join!(pair.link_again(start, &what), told));
    }
}

/// Half open: one side has gone without a word and is back before the other has noticed.
#[tokio::test(start_paused = true)]
async fn a_half_open_link_is_replaced_as_soon_as_the_radio_lets_go_of_it() {
    for away_ms in [1, 40, 500, 1500, 1990] {
        let what = format!("back after {away_ms} ms");
        let pair = Pair::on(Condition::Room, away_ms).await;
        let before = pair.leftovers();
        let (near, far) = pair.link().await;
        let start = Instant::now();
        pair.air.remove("sim-near").expect("is there");
        is_told(near, AT_ONCE, &what).await;
        sleep(Duration::from_millis(away_ms)).await;
        power(&pair.air, "sim-near", true);
        // The peer's radio holds the old connection until it has heard nothing for so long, and takes no other.
        let again = async {
            // A connect that the peer does not take yet may be given up before; Zenoh tries again.
            loop {
                match pair.near.dials("ble/far").await {
                    Ok(link) => break (link, start.elapsed()),
                    Err(error) => println!("{what}: {error}"),
                }
                sleep(RETRY).await;
            }
        };
        let ((link, took), ()) = tokio::join!(again, is_told(far, SILENTLY, &what));
        assert!(took <= SUPERVISION + RETRY + BACK, "{what}: {took:?}");
        drop((pair.far.incoming().await, link));
        assert!(pair.far.no_more_incoming(), "{what}: a second link");
        assert_eq!(pair.leftovers_in_the_end().await, before, "{what}");
    }
}

/// The air gets as bad as it can be for a moment, again and again, while all is said.
#[tokio::test(start_paused = true)]
async fn bursts_of_loss_cost_nothing_but_time() {
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
            outcome = within("all is said", held_on(&near, &far)) => outcome,
            () = bursts => unreachable!("they go on for ever"),
        };
        assert!(outcome.is_whole, "seed {seed}: {:?}", outcome.reasons);
    }
}

//! Cuts the radio contact after every single packet of a fixed conversation: of the handshake, of batches on several
//! lanes in both directions with their credits, and of the close.
use std::time::Duration;

use tokio::time::{timeout, Instant};
use zenoh_link_ble_air::Condition;

use super::conversation::{converse, sent, Received};
use crate::shared::pair::{Pair, SUPERVISION};

/// Margin besides the supervision timeout: the last connection event before it, and the event that reports the end.
pub const EVENTS: Duration = Duration::from_millis(100);
/// Maximum duration of a conversation, whenever it is cut: it takes less than 2 s itself, plus a dial of 5 s and its
/// incoming link, or an end detected by the supervision timeout.
const ENDED: Duration = Duration::from_secs(8);

fn is_prefix(received: &Received, all: &Received) -> bool {
    received
        .iter()
        .zip(all)
        .all(|(received, all)| all.starts_with(received))
}

/// Runs a conversation that is cut after a number of packets. Returns `false` if the conversation ended before the cut.
async fn cut_after(packets: u64, condition: Condition, seed: u64) -> bool {
    let what = format!("{condition}, seed {seed}, cut after {packets} packets");
    let pair = Pair::on(condition, seed).await;
    let before = pair.resources();
    pair.air.cut_after(packets);
    let outcome = timeout(ENDED, converse(&pair)).await;
    let outcome = outcome.unwrap_or_else(|_| panic!("{what}: a side waits forever"));
    let was_cut = pair.air.status().is_cut;
    for (received, from) in outcome.received.iter().zip([1, 0]) {
        assert!(
            is_prefix(received, &sent(from)),
            "{what}: not sent by {from}: {received:?}"
        );
    }
    assert!(outcome.is_whole || was_cut, "{what}: {:?}", outcome.reasons);
    assert!(
        outcome.is_whole || !outcome.reasons.is_empty(),
        "{what}: no reason was reported"
    );
    pair.air.restore();
    let (near, far) = pair.link_again(Instant::now(), &what).await;
    let mut buffer = [0; 100];
    let (closed, ended) = tokio::join!(near.close(), far.read(&mut buffer, None));
    closed.expect("closes");
    ended.expect_err("the other side detects the end");
    drop((near, far));
    assert_eq!(pair.resources_after_cleanup().await, before, "{what}");
    was_cut
}

async fn cut_everywhere(condition: Condition, seed: u64) {
    let mut packets = 0;
    while cut_after(packets, condition, seed).await {
        packets += 1;
    }
    println!("{condition}, seed {seed}: the conversation has {packets} packets");
    assert!(packets > 50, "{packets} packets are too few");
}

#[tokio::test(start_paused = true)]
async fn reconnects_after_a_cut_at_any_packet() {
    cut_everywhere(Condition::Desk, 1).await;
}

/// With retransmissions, during which the two sides have different information.
#[tokio::test(start_paused = true)]
async fn reconnects_after_a_cut_at_any_packet_with_packet_loss() {
    for seed in 1..=3 {
        cut_everywhere(Condition::Wall, seed).await;
    }
}

#[tokio::test(start_paused = true)]
async fn reconnects_after_two_cuts_during_the_handshake() {
    // The handshake has four packets: the channel request and response, and both hellos. Later cuts hit the first
    // batches.
    for (first, second) in (0..8).flat_map(|first| (0..8).map(move |second| (first, second))) {
        let what = format!("cut after {first} packets, and then after {second}");
        let pair = Pair::on(Condition::Desk, 1).await;
        let before = pair.resources();
        for packets in [first, second] {
            pair.air.cut_after(packets);
            timeout(ENDED, converse(&pair))
                .await
                .unwrap_or_else(|_| panic!("{what}: a side waits forever"));
            assert!(pair.air.status().is_cut, "{what}: too late");
            pair.air.restore();
        }
        drop(pair.link_again(Instant::now(), &what).await);
        assert_eq!(pair.resources_after_cleanup().await, before, "{what}");
    }
}

#[tokio::test(start_paused = true)]
async fn both_sides_detect_a_cut_within_the_supervision_timeout() {
    for seed in 0..20 {
        let pair = Pair::on(Condition::Room, seed).await;
        let (near, far) = pair.link().await;
        tokio::time::sleep(Duration::from_millis(7 * seed)).await;
        let start = Instant::now();
        pair.air.cut();
        for link in [&near, &far] {
            let error = link.read(&mut [0; 100], None).await.expect_err("it ended");
            let took = start.elapsed();
            assert!(took <= SUPERVISION + EVENTS, "seed {seed}: after {took:?}");
            let error = error.to_string();
            assert!(error.contains("is down"), "seed {seed}: {error}");
        }
    }
}

/// As when a robot passes behind a wall for less than the supervision timeout.
#[tokio::test(start_paused = true)]
async fn short_cuts_lose_no_batches() {
    for seed in 0..20 {
        let pair = Pair::on(Condition::Room, seed).await;
        let (near, far) = pair.link().await;
        let gap = Duration::from_millis(1700 + 10 * seed);
        let writing = async {
            for n in 0..40_u8 {
                near.write_all(&[n; 700], None).await.expect("writes");
            }
        };
        let reading = async {
            let mut buffer = [0; 1000];
            for n in 0..40_u8 {
                let size = far.read(&mut buffer, None).await.expect("reads");
                assert_eq!(&buffer[..size], [n; 700], "seed {seed}, gap {gap:?}");
            }
        };
        let cutting = async {
            tokio::time::sleep(Duration::from_millis(100)).await;
            pair.air.cut();
            tokio::time::sleep(gap).await;
            pair.air.restore();
        };
        tokio::join!(writing, reading, cutting);
    }
}

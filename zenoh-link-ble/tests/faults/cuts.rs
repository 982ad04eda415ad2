//! The air is cut after every single packet of a fixed conversation: of the opening, of batches on several lanes both ways
//! with their credits, of the close.
use std::time::Duration;

use tokio::time::{timeout, Instant};
use zenoh_link_ble::radio::sim::Condition;

use super::conversation::{held, sent, Got};
use crate::shared::pair::{Pair, SUPERVISION};

/// Beside the supervision timeout: the last connection event before, and the one in which the end is told.
pub const EVENTS: Duration = Duration::from_millis(100);
/// How long a conversation may take, whenever it is cut: itself less than 2 s; a dial of 5 s and what came in after it, or
/// an end noticed after the supervision timeout.
const ENDED: Duration = Duration::from_secs(8);

fn is_prefix(got: &Got, all: &Got) -> bool {
    got.iter().zip(all).all(|(got, all)| all.starts_with(got))
}

/// `false`: the conversation was over before the cut.
async fn cut_after(packets: u64, condition: Condition, seed: u64) -> bool {
    let what = format!("{condition}, seed {seed}, cut after {packets} packets");
    let pair = Pair::on(condition, seed).await;
    let before = pair.leftovers();
    pair.air.cut_after(packets);
    let outcome = timeout(ENDED, held(&pair)).await;
    let outcome = outcome.unwrap_or_else(|_| panic!("{what}: somebody waits for ever"));
    let was_cut = pair.air.status().is_cut;
    for (got, from) in outcome.got.iter().zip([1, 0]) {
        assert!(
            is_prefix(got, &sent(from)),
            "{what}: {from} did not say that: {got:?}"
        );
    }
    assert!(outcome.is_whole || was_cut, "{what}: {:?}", outcome.reasons);
    assert!(
        outcome.is_whole || !outcome.reasons.is_empty(),
        "{what}: nobody is told why"
    );
    pair.air.restore();
    let (near, far) = pair.link_again(Instant::now(), &what).await;
    let mut buffer = [0; 100];
    let (closed, ended) = tokio::join!(near.close(), far.read(&mut buffer, None));
    closed.expect("closes");
    ended.expect_err("the other side is told");
    drop((near, far));
    assert_eq!(pair.leftovers_in_the_end().await, before, "{what}");
    was_cut
}

async fn cut_everywhere(condition: Condition, seed: u64) {
    let mut packets = 0;
    while cut_after(packets, condition, seed).await {
        packets += 1;
    }
    println!("{condition}, seed {seed}: the conversation has {packets} packets");
    assert!(packets > 50, "{packets} packets are no conversation");
}

#[tokio::test(start_paused = true)]
async fn a_cut_after_any_packet_of_a_conversation_ends_both_sides_and_a_dial_works_again() {
    cut_everywhere(Condition::Desk, 1).await;
}

/// With repeats, in which the two sides do not know the same.
#[tokio::test(start_paused = true)]
async fn the_same_where_packets_are_lost_besides() {
    for seed in 1..=3 {
        cut_everywhere(Condition::Wall, seed).await;
    }
}

#[tokio::test(start_paused = true)]
async fn two_cuts_in_a_row_while_the_link_opens_do_no_more_harm_than_one() {
    // The opening has four packets: asking for a channel, the answer, both hellos. Beyond it the first batches are cut.
    for (first, second) in (0..8).flat_map(|first| (0..8).map(move |second| (first, second))) {
        let what = format!("cut after {first} packets, and then after {second}");
        let pair = Pair::on(Condition::Desk, 1).await;
        let before = pair.leftovers();
        for packets in [first, second] {
            pair.air.cut_after(packets);
            timeout(ENDED, held(&pair))
                .await
                .unwrap_or_else(|_| panic!("{what}: somebody waits for ever"));
            assert!(pair.air.status().is_cut, "{what}: too late");
            pair.air.restore();
        }
        drop(pair.link_again(Instant::now(), &what).await);
        assert_eq!(pair.leftovers_in_the_end().await, before, "{what}");
    }
}

#[tokio::test(start_paused = true)]
async fn both_sides_are_told_of_a_cut_within_the_supervision_timeout() {
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

/// A robot that turns behind a wall for a moment: shorter than the supervision timeout.
#[tokio::test(start_paused = true)]
async fn a_cut_shorter_than_the_supervision_timeout_costs_nothing_but_time() {
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

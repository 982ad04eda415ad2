//! An attacker changes what arrives on a link with a secret.
use std::time::Instant;

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

use super::{lane, sent, Pair};
use crate::{
    lanes::{
        receiver::Violation,
        sdu::{Content, SduError},
        Lane, Lanes,
    },
    seal::NotAuthentic,
};

/// Returns SDUs from a sender with keys, six of them with batches, and SDUs of the other direction.
fn encrypted_run(seed: u64) -> (Vec<Vec<u8>>, Vec<Vec<u8>>) {
    let (mut rng, mut pair) = (Pcg32::seed_from_u64(seed), Pair::encrypted());
    let mut sdus = Vec::new();
    for n in 0..6_u8 {
        let size = 1 + rng.next_u32() as usize % 40;
        assert!(pair.push(n, &vec![n; size]));
        sdus.extend(sent(&mut pair.sender, pair.now));
    }
    pair.sender.send_interval(24);
    pair.sender.close(0);
    sdus.extend(std::iter::from_fn(|| sent(&mut pair.sender, pair.now)));
    // The other side sends at the same time.
    let mut reverse = Vec::new();
    for n in 0..sdus.len() as u8 {
        assert!(pair.receiver.push(lane(5), &[n; 20], pair.now));
        reverse.extend(sent(&mut pair.receiver, pair.now));
    }
    (sdus, reverse)
}

/// At every position of a run, an attacker changes what arrives. Only what was sent before that position is delivered, and the
/// link ends there.
#[test]
fn every_attack_at_every_position_ends_an_encrypted_link() {
    for seed in 0..10 {
        let (sdus, reverse) = encrypted_run(seed);
        let count = sdus.len();
        assert_eq!(count, 8);
        for at in 0..count {
            let original = &sdus[at];
            let mut forged: Vec<(String, Vec<u8>)> = vec![
                ("injected".to_owned(), vec![0; original.len()]),
                (
                    "without a seal".to_owned(),
                    Content::Batch(lane(1), b"stop").encode(),
                ),
                ("direction swapped".to_owned(), reverse[at].clone()),
                ("extended".to_owned(), [&original[..], &[0]].concat()),
            ];
            forged.extend(
                (0..original.len()).map(|n| (format!("cut to {n}"), original[..n].to_vec())),
            );
            forged.extend((0..8 * original.len()).map(|bit| {
                let mut changed = original.clone();
                changed[bit / 8] ^= 1 << (bit % 8);
                (format!("bit {bit}"), changed)
            }));
            forged.extend(
                (0..count)
                    .filter(|other| *other != at)
                    .map(|other| (format!("replaced by {other}"), sdus[other].clone())),
            );
            for (attack, mut sdu) in forged {
                let mut receiver = Pair::encrypted().receiver;
                for honest in &sdus[..at] {
                    let received = receiver.on_sdu(&mut honest.clone(), Instant::now());
                    assert!(received.is_ok(), "seed {seed}");
                }
                let taken_before: Vec<_> = delivered(&mut receiver);
                let attacked = receiver.on_sdu(&mut sdu, Instant::now());
                let expected = Err(Violation::Sdu(SduError::NotAuthentic(NotAuthentic)));
                assert_eq!(attacked, expected, "seed {seed}, SDU {at}: {attack}");
                assert_eq!(delivered(&mut receiver), Vec::<Vec<u8>>::new());
                let sent_before = at.min(6);
                assert_eq!(taken_before.len(), sent_before);
            }
        }
    }
}

/// Takes all received batches.
fn delivered(receiver: &mut Lanes) -> Vec<Vec<u8>> {
    Lane::all()
        .flat_map(|lane| std::iter::from_fn(|| receiver.take(lane)).collect::<Vec<_>>())
        .collect()
}

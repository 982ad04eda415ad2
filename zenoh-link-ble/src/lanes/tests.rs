//! Both sides together, over a way that delivers in order, or does not: `cargo test -p zenoh-link-ble lanes`
use std::time::{Duration, Instant};

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

use super::{
    check::Fault,
    credits::{cost, largest_batch, CreditError, MIN_WINDOW},
    piece::Piece,
    receiver::{Violation, HIGH_MARK},
    scheduler::{Bounds, Next, OWN_BYTES},
    sdu::{self, Content, SduError},
    Change, Lane, Lanes, LANES,
};
use crate::hello::MIN_MTU;

const MTU: usize = 1000;
const WINDOW: u16 = 12_000;
const BOUNDS: Bounds = Bounds {
    bytes: 100_000,
    droppable: Duration::from_millis(100),
};

fn lane(number: u8) -> Lane {
    Lane::new(number).expect("valid")
}

/// The next SDU, which goes out.
fn sent(lanes: &mut Lanes, now: Instant) -> Option<Vec<u8>> {
    let (next, sdu) = lanes.peek()?;
    let sdu = sdu.to_vec();
    lanes.on_sent(next, now);
    Some(sdu)
}

/// A sender, and the receiver at the other end of a way that holds nothing.
struct Pair {
    out: Lanes,
    into: Lanes,
    now: Instant,
}

impl Pair {
    fn new() -> Self {
        Self::with(MTU, WINDOW)
    }

    fn with(mtu: usize, window: u16) -> Self {
        Self {
            out: Lanes::new(BOUNDS, mtu, window, window),
            into: Lanes::new(BOUNDS, mtu, window, window),
            now: Instant::now(),
        }
    }

    fn push(&mut self, number: u8, batch: &[u8]) -> bool {
        self.out.push(lane(number), batch, self.now)
    }

    /// Moves one SDU there; tells what it brought.
    fn step(&mut self) -> Option<Change> {
        let sdu = sent(&mut self.out, self.now)?;
        Some(self.into.on_sdu(&sdu, self.now).expect("all is well"))
    }

    /// Moves one SDU back.
    fn back(&mut self) -> Option<Change> {
        let sdu = sent(&mut self.into, self.now)?;
        Some(self.out.on_sdu(&sdu, self.now).expect("all is well"))
    }

    /// Moves SDUs both ways until nothing more moves.
    fn settle(&mut self) {
        while self.step().is_some() || self.back().is_some() {}
    }

    fn take(&mut self, number: u8) -> Option<Vec<u8>> {
        self.into.take(lane(number))
    }

    fn held(&self, number: u8) -> usize {
        self.into.lane_report(lane(number), self.now).1.held_bytes
    }

    fn waiting(&self, number: u8) -> u64 {
        self.out.lane_report(lane(number), self.now).0.waiting.bytes
    }
}

#[test]
fn the_most_urgent_goes_first_whatever_came_before() {
    let mut pair = Pair::new();
    for number in [7, 5, 5, 1, 0, 5] {
        assert!(pair.push(number, b"x"));
    }
    let order: Vec<_> = std::iter::from_fn(|| pair.step()).collect();
    assert_eq!(order, [0, 1, 5, 5, 5, 7].map(|n| Change::Batch(lane(n))));
}

#[test]
fn what_has_not_gone_out_yet_is_overtaken() {
    let mut pair = Pair::new();
    pair.push(5, b"bulk");
    assert!(matches!(pair.out.peek(), Some((Next::Batch(l), _)) if l == lane(5)));
    pair.push(1, b"stop");
    assert_eq!(pair.step(), Some(Change::Batch(lane(1))));
    assert_eq!(pair.step(), Some(Change::Batch(lane(5))));
}

#[test]
fn bulk_leaves_room_for_what_is_urgent_while_nothing_is_acknowledged() {
    let mut pair = Pair::new();
    while pair.push(5, &[5; MTU]) {}
    let bulk = std::iter::from_fn(|| pair.step()).count();
    assert!((2..=4).contains(&bulk), "{bulk} batches");
    for n in 0..20 {
        assert!(pair.push(1, &[1; 20]));
        assert_eq!(pair.step(), Some(Change::Batch(lane(1))), "message {n}");
    }
}

#[test]
fn bulk_has_a_bound_and_takes_no_room_of_what_is_urgent() {
    let mut pair = Pair::new();
    while pair.push(5, &[5; MTU]) {}
    while pair.push(4, &[4; MTU]) {}
    let waiting: u64 = (0..8).map(|number| pair.waiting(number)).sum();
    let most = (BOUNDS.bytes + OWN_BYTES) as u64;
    assert!((BOUNDS.bytes as u64..=most).contains(&waiting), "{waiting}");
    let mut urgent = 0;
    while pair.push(1, &[1; MTU]) {
        urgent += MTU;
    }
    assert!(
        (OWN_BYTES - 5 * MTU..=OWN_BYTES).contains(&urgent),
        "{urgent}"
    );
}

#[test]
fn the_bound_holds_for_small_batches_too() {
    let mut pair = Pair::new();
    while pair.push(5, b"x") {}
    assert!(pair.out.lane_report(lane(5), pair.now).0.waiting.sdus < 3000);
}

#[test]
fn a_lane_whose_receiver_takes_nothing_stops_alone() {
    let mut pair = Pair::new();
    let mut pushed = 0;
    while pair.push(4, &[4; MTU]) {
        pushed += 1;
    }
    pair.settle();
    let held = pair.held(4);
    assert!((HIGH_MARK..=HIGH_MARK + MTU + usize::from(WINDOW)).contains(&held));
    for n in 0..1000_u32 {
        for other in [1, 6] {
            assert!(pair.push(other, &n.to_le_bytes()));
            pair.settle();
            assert_eq!(pair.take(other), Some(n.to_le_bytes().to_vec()));
        }
    }
    // It wakes up, and everything is there.
    for n in 0..pushed {
        pair.settle();
        assert!(pair.take(4).is_some(), "batch {n} of {pushed}");
    }
    assert_eq!(pair.waiting(4), 0);
}

#[test]
fn a_goodbye_goes_when_everything_else_has_gone() {
    let mut pair = Pair::new();
    pair.push(5, b"first");
    pair.out.close(0);
    assert_eq!(pair.step(), Some(Change::Batch(lane(5))));
    assert_eq!(pair.step(), Some(Change::Bye(0)));
    assert_eq!(pair.step(), None);
    assert_eq!(pair.take(5), Some(b"first".to_vec()));
    let more = pair.into.on_sdu(&[0; 10], pair.now);
    assert_eq!(more, Err(Violation::AfterBye));
    assert!(!pair.push(1, b"too late"));
    assert_eq!(sent(&mut pair.out, pair.now), None, "nothing follows it");
}

/// Without anything else on the link: a keep-alive of Zenoh's would bring the acknowledgement, seconds later.
#[test]
fn a_lane_never_waits_for_an_acknowledgement_that_is_not_due() {
    for mtu in [usize::from(MIN_MTU), 145, 146, 200, MTU] {
        for window in [MIN_WINDOW, 1000, WINDOW] {
            let mtu = mtu.min(usize::from(largest_batch(window)));
            let mut pair = Pair::with(mtu, window);
            for n in 0..200 {
                assert!(pair.push(5, &vec![5; mtu]));
                pair.settle();
                let what = format!("batch {n} of {mtu} bytes, window {window}");
                assert!(pair.take(5).is_some(), "{what}");
                assert_eq!(pair.waiting(5), 0, "{what}");
            }
            for _ in 0..10 {
                assert!(pair.push(5, &vec![5; mtu]));
            }
            pair.settle();
            assert_eq!(pair.waiting(5), 0, "all at once: {mtu}, window {window}");
        }
    }
}

#[test]
fn an_empty_batch_is_no_sdu() {
    let mut pair = Pair::new();
    assert!(pair.push(5, b""));
    assert_eq!(pair.step(), None);
}

#[test]
fn what_is_lost_changed_or_repeated_ends_the_link() {
    let sdus = || {
        let mut pair = Pair::new();
        for n in 0..10 {
            pair.push(n % 8, &[n; 50]);
        }
        std::iter::from_fn(|| sent(&mut pair.out, pair.now)).collect::<Vec<_>>()
    };
    let end = |sdus: &[Vec<u8>]| {
        let mut pair = Pair::new();
        sdus.iter()
            .find_map(|sdu| pair.into.on_sdu(sdu, pair.now).err())
    };
    let fault = |fault| Some(Violation::Sdu(SduError::Fault(fault)));
    assert_eq!(end(&sdus()), None);

    let mut lost = sdus();
    lost.drain(3..7);
    assert_eq!(end(&lost), fault(Fault::Lost(4)));
    let mut twice = sdus();
    twice.insert(4, twice[3].clone());
    assert_eq!(end(&twice), fault(Fault::Damaged));
    let mut swapped = sdus();
    swapped.swap(5, 6);
    assert_eq!(end(&swapped), fault(Fault::Lost(1)));
    let mut changed = sdus();
    changed[8][20] ^= 1;
    assert_eq!(end(&changed), fault(Fault::Damaged));
    let mut cut = sdus();
    cut[8].truncate(40);
    assert_eq!(end(&cut), fault(Fault::Damaged));
}

/// Batches as Zenoh makes them of droppable messages: a whole one of a few bytes, and the pieces of a larger one. (Id,
/// number, QoS extension; then "first fragment"; then a push to a named key with congestion control "drop".)
const PUSH: [u8; 8] = [0xbd, 0x00, 0x01, b'k', 0x21, 0x05, 0x01, 0x00];

fn droppable(kind: Kind, size: usize) -> Vec<u8> {
    let mut batch: Vec<u8> = match kind {
        Kind::Whole => vec![0x25, 0x07],
        Kind::First => vec![0xe6, 0x07, 0x02],
        Kind::Next => vec![0x66, 0x08],
    };
    if !matches!(kind, Kind::Next) {
        batch.extend_from_slice(&PUSH);
    }
    batch.resize(size, 0);
    batch
}

#[derive(Clone, Copy)]
enum Kind {
    Whole,
    First,
    Next,
}

#[test]
fn the_batches_of_these_tests_are_what_zenoh_would_send() {
    let is_droppable = true;
    for (kind, piece) in [
        (Kind::Whole, Piece::Whole { is_droppable }),
        (Kind::First, Piece::First { is_droppable }),
        (Kind::Next, Piece::Next),
    ] {
        assert_eq!(Piece::of(&droppable(kind, 100)), piece);
    }
}

#[test]
fn a_droppable_message_is_begun_only_while_little_waits_and_then_taken_whole() {
    let mut pair = Pair::new();
    assert!(pair.push(5, &droppable(Kind::First, MTU)));
    let mut taken = 1;
    while pair.waiting(5) < 20_000 {
        assert!(
            pair.push(5, &droppable(Kind::Next, MTU)),
            "what was begun is taken"
        );
        taken += 1;
    }
    assert!(!pair.push(5, &droppable(Kind::First, MTU)));
    assert!(!pair.push(5, &droppable(Kind::Whole, 50)));
    assert!(pair.push(5, b"what must arrive is taken all the same"));
    for _ in 0..taken {
        pair.settle();
        assert!(pair.take(5).is_some());
    }
    assert!(pair.push(5, &droppable(Kind::First, MTU)));
}

#[test]
fn what_waits_of_a_message_that_zenoh_gave_up_is_taken_back() {
    let mut pair = Pair::new();
    pair.push(5, b"whole");
    for kind in [Kind::First, Kind::Next, Kind::Next] {
        assert!(pair.push(5, &droppable(kind, 100)));
    }
    assert!(pair.push(5, b""));
    pair.settle();
    assert_eq!(pair.take(5), Some(b"whole".to_vec()));
    assert_eq!(pair.take(5), None);
    assert_eq!(pair.out.lane_report(lane(5), pair.now).0.given_up_sdus, 3);
}

/// A peer that sends what it likes, rightly sealed.
struct Rogue {
    pair: Pair,
    number: u32,
}

impl Rogue {
    fn new() -> Self {
        let (pair, number) = (Pair::new(), 0);
        Self { pair, number }
    }

    fn sends(&mut self, content: Content<'_>) -> Result<Change, Violation> {
        let mut sdu = content.encode();
        sdu::seal(self.number, &mut sdu);
        self.number += 1;
        self.pair.into.on_sdu(&sdu, self.pair.now)
    }
}

#[test]
fn a_peer_that_ignores_its_credits_is_found_out_within_the_window() {
    let mut rogue = Rogue::new();
    let batch = Content::Batch(lane(3), &[0; MTU]);
    let sent = std::iter::from_fn(|| rogue.sends(batch).ok()).count();
    assert_eq!(sent, usize::from(WINDOW / cost(MTU)));
    let found = Err(Violation::Credits(CreditError::Overrun));
    assert_eq!(rogue.sends(batch), found);
}

/// What it has acknowledged counts no more, whether the peer has read that or not. Lanes that are not read have a bound of
/// their own.
#[test]
fn an_overrun_is_not_noticed_by_a_receiver_that_has_acknowledged() {
    let mut rogue = Rogue::new();
    for n in 0..10 * (WINDOW / cost(MTU)) {
        let change = rogue.sends(Content::Batch(lane(3), &[0; MTU]));
        assert_eq!(change, Ok(Change::Batch(lane(3))), "batch {n}");
        assert!(rogue.pair.take(3).is_some());
        while sent(&mut rogue.pair.into, rogue.pair.now).is_some() {}
    }
}

#[test]
fn a_peer_that_goes_on_with_a_stopped_lane_is_found_out() {
    let mut rogue = Rogue::new();
    let batch = Content::Batch(lane(3), &[0; MTU]);
    let mut held = 0;
    let found = loop {
        // It has its acknowledgements, and takes no notice of the rest.
        while sent(&mut rogue.pair.into, rogue.pair.now).is_some() {}
        match rogue.sends(batch) {
            Ok(_) => held += MTU,
            Err(violation) => break violation,
        }
        assert!(held < 100_000, "memory has a bound");
    };
    assert_eq!(found, Violation::Stopped(lane(3)));
}

#[test]
fn a_peer_that_acknowledges_what_was_never_sent_is_found_out() {
    let mut rogue = Rogue::new();
    let found = Err(Violation::Credits(CreditError::NeverSent));
    assert_eq!(rogue.sends(Content::Ack(1)), found);
}

#[test]
fn an_sdu_over_the_mtu_ends_the_link() {
    let mut rogue = Rogue::new();
    let (size, mtu) = (MTU + 1, MTU);
    let found = Err(Violation::TooLarge { size, mtu });
    assert_eq!(rogue.sends(Content::Batch(lane(3), &[0; MTU + 1])), found);
}

/// Any order of pushing, sending, taking and acknowledging, both ways at once: each lane gives out what was put in, in
/// order, and at the end nothing is left.
#[test]
fn every_lane_delivers_all_in_order_whatever_the_order_of_events() {
    for seed in 0..200 {
        let mut dice = Pcg32::seed_from_u64(seed);
        let mut pair = Pair::new();
        let mut pushed = [0_u32; LANES];
        let mut taken = [0_u32; LANES];
        let take = |pair: &mut Pair, number: u8, taken: &mut [u32; LANES]| {
            let at = usize::from(number);
            if let Some(batch) = pair.take(number) {
                assert_eq!(batch[..4], taken[at].to_le_bytes(), "seed {seed}");
                taken[at] += 1;
            }
        };
        for round in 0..6000 {
            let number = (dice.next_u32() % LANES as u32) as u8;
            match dice.next_u32() % if round < 5000 { 5 } else { 3 } {
                0 => drop(pair.step()),
                1 => drop(pair.back()),
                2 => take(&mut pair, number, &mut taken),
                _ => {
                    let at = usize::from(number);
                    let mut batch = vec![0; 4 + dice.next_u32() as usize % (MTU - 3)];
                    batch[..4].copy_from_slice(&pushed[at].to_le_bytes());
                    pushed[at] += u32::from(pair.push(number, &batch));
                }
            }
        }
        for _ in 0..pushed.iter().sum::<u32>() {
            pair.settle();
            for number in 0..LANES as u8 {
                take(&mut pair, number, &mut taken);
            }
        }
        assert_eq!(pushed, taken, "seed {seed}");
    }
}

//! Tests both sides of a link together, over paths with and without faults: `cargo test -p link-lanes lanes`
mod attacks;
mod backlog;
mod misbehaving;
mod vectors;

use std::{
    convert::Infallible,
    time::{Duration, Instant},
};

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

use super::{
    batch_kind::BatchKind,
    check::Fault,
    credits::{largest_batch, MIN_WINDOW},
    receiver::{Violation, HIGH_WATERMARK},
    scheduler::{Bounds, Sent, RESERVED_BYTES_PER_LANE},
    sdu::{Protection, SduError},
    Change, Lane, Lanes, LANES,
};
use crate::{hello::MIN_MTU, seal::LinkKeys};

const MTU: usize = 1000;
const WINDOW: u16 = 12_000;
const BOUNDS: Bounds = Bounds {
    bytes: 100_000,
    // Never reached: the tests with these bounds are about the bound in bytes.
    backlog: Duration::from_secs(600),
    droppable: Duration::from_millis(100),
};

fn lane(number: u8) -> Lane {
    Lane::new(number).expect("valid")
}

/// Takes the next SDU.
fn sent(lanes: &mut Lanes, now: Instant) -> Option<Vec<u8>> {
    let mut taken = None;
    let Ok(_) = lanes.send(now, |sdu| {
        taken = Some(sdu.to_vec());
        Ok::<_, Infallible>(true)
    });
    taken
}

/// A sender and a receiver, without anything in flight between them.
struct Pair {
    sender: Lanes,
    receiver: Lanes,
    now: Instant,
}

impl Pair {
    fn new() -> Self {
        Self::with(BOUNDS, MTU, WINDOW)
    }

    fn with(bounds: Bounds, mtu: usize, window: u16) -> Self {
        let lanes = || Lanes::new(bounds, mtu, window, window, Protection::checks());
        Self {
            sender: lanes(),
            receiver: lanes(),
            now: Instant::now(),
        }
    }

    /// Returns a pair with keys.
    fn encrypted() -> Self {
        let lanes = |own, of_peer| {
            let keys = LinkKeys::new([own; 32], [of_peer; 32]);
            Lanes::new(BOUNDS, MTU, WINDOW, WINDOW, Protection::keys(keys))
        };
        Self {
            sender: lanes(1, 2),
            receiver: lanes(2, 1),
            now: Instant::now(),
        }
    }

    fn push(&mut self, number: u8, batch: &[u8]) -> bool {
        self.sender.push(lane(number), batch, self.now)
    }

    /// Moves one SDU from the sender to the receiver, and returns its effect.
    fn step(&mut self) -> Option<Change> {
        let mut sdu = sent(&mut self.sender, self.now)?;
        Some(
            self.receiver
                .on_sdu(&mut sdu, self.now)
                .expect("a valid SDU"),
        )
    }

    /// Moves one SDU from the receiver to the sender, and returns its effect.
    fn step_back(&mut self) -> Option<Change> {
        let mut sdu = sent(&mut self.receiver, self.now)?;
        Some(self.sender.on_sdu(&mut sdu, self.now).expect("a valid SDU"))
    }

    /// Moves SDUs in both directions until none is left.
    fn settle(&mut self) {
        while self.step().is_some() || self.step_back().is_some() {}
    }

    fn take(&mut self, number: u8) -> Option<Vec<u8>> {
        self.receiver.take(lane(number))
    }

    fn held(&self, number: u8) -> usize {
        self.receiver
            .lane_report(lane(number), self.now)
            .1
            .unread_bytes
    }

    fn waiting(&self, number: u8) -> u64 {
        self.sender
            .lane_report(lane(number), self.now)
            .0
            .waiting
            .bytes
    }
}

#[test]
fn most_urgent_batch_is_sent_first_whatever_was_queued_before() {
    let mut pair = Pair::new();
    for number in [7, 5, 5, 1, 0, 5] {
        assert!(pair.push(number, b"x"));
    }
    let order: Vec<_> = std::iter::from_fn(|| pair.step()).collect();
    assert_eq!(order, [0, 1, 5, 5, 5, 7].map(|n| Change::Batch(lane(n))));
}

#[test]
fn batch_that_was_not_sent_yet_is_overtaken() {
    let mut pair = Pair::new();
    pair.push(5, b"bulk");
    let refused = pair.sender.send(pair.now, |sdu| {
        assert!(sdu.windows(4).any(|part| part == b"bulk"));
        Ok::<_, Infallible>(false)
    });
    assert_eq!(refused, Ok(Sent::NoRoom));
    pair.push(1, b"stop");
    assert_eq!(pair.step(), Some(Change::Batch(lane(1))));
    assert_eq!(pair.step(), Some(Change::Batch(lane(5))));
}

#[test]
fn bulk_leaves_window_for_urgent_batches_while_nothing_is_acknowledged() {
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
fn bulk_is_bounded_and_does_not_use_the_room_of_urgent_lanes() {
    let mut pair = Pair::new();
    while pair.push(5, &[5; MTU]) {}
    while pair.push(4, &[4; MTU]) {}
    let waiting: u64 = (0..8).map(|number| pair.waiting(number)).sum();
    let max_bytes = (BOUNDS.bytes + RESERVED_BYTES_PER_LANE) as u64;
    assert!(
        (BOUNDS.bytes as u64..=max_bytes).contains(&waiting),
        "{waiting}"
    );
    let mut urgent = 0;
    while pair.push(1, &[1; MTU]) {
        urgent += MTU;
    }
    assert!(
        (RESERVED_BYTES_PER_LANE - 5 * MTU..=RESERVED_BYTES_PER_LANE).contains(&urgent),
        "{urgent}"
    );
}

#[test]
fn bound_holds_for_small_batches() {
    let mut pair = Pair::new();
    while pair.push(5, b"x") {}
    assert!(pair.sender.lane_report(lane(5), pair.now).0.waiting.sdus < 3000);
}

#[test]
fn lane_that_is_not_read_stops_without_stopping_others() {
    let mut pair = Pair::new();
    let mut pushed = 0;
    while pair.push(4, &[4; MTU]) {
        pushed += 1;
    }
    pair.settle();
    let held = pair.held(4);
    assert!((HIGH_WATERMARK..=HIGH_WATERMARK + MTU + usize::from(WINDOW)).contains(&held));
    for n in 0..1000_u32 {
        for other in [1, 6] {
            assert!(pair.push(other, &n.to_le_bytes()));
            pair.settle();
            assert_eq!(pair.take(other), Some(n.to_le_bytes().to_vec()));
        }
    }
    // Everything is delivered once the receiver reads again.
    for n in 0..pushed {
        pair.settle();
        assert!(pair.take(4).is_some(), "batch {n} of {pushed}");
    }
    assert_eq!(pair.waiting(4), 0);
}

#[test]
fn goodbye_is_sent_after_all_batches() {
    let mut pair = Pair::new();
    pair.push(5, b"first");
    pair.sender.close(0);
    assert_eq!(pair.step(), Some(Change::Batch(lane(5))));
    assert_eq!(pair.step(), Some(Change::Goodbye(0)));
    assert_eq!(pair.step(), None);
    assert_eq!(pair.take(5), Some(b"first".to_vec()));
    let more = pair.receiver.on_sdu(&mut [0; 10], pair.now);
    assert_eq!(more, Err(Violation::AfterGoodbye));
    assert!(!pair.push(1, b"too late"));
    assert_eq!(
        sent(&mut pair.sender, pair.now),
        None,
        "nothing follows the goodbye"
    );
}

/// Nothing else is sent on the link. Otherwise a keep-alive of Zenoh would cause the acknowledgement, seconds later.
#[test]
fn lane_never_waits_for_an_acknowledgement_that_is_not_due() {
    for mtu in [usize::from(MIN_MTU), 145, 146, 200, MTU] {
        for window in [MIN_WINDOW, 1000, WINDOW] {
            let mtu = mtu.min(usize::from(largest_batch(window)));
            let mut pair = Pair::with(BOUNDS, mtu, window);
            for n in 0..200 {
                assert!(pair.push(5, &vec![5; mtu]));
                pair.settle();
                let case = format!("batch {n} of {mtu} bytes, window {window}");
                assert!(pair.take(5).is_some(), "{case}");
                assert_eq!(pair.waiting(5), 0, "{case}");
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
fn empty_batch_is_not_sent() {
    let mut pair = Pair::new();
    assert!(pair.push(5, b""));
    assert_eq!(pair.step(), None);
}

#[test]
fn lost_changed_or_repeated_sdus_end_the_link() {
    let sdus = || {
        let mut pair = Pair::new();
        for n in 0..10 {
            pair.push(n % 8, &[n; 50]);
        }
        std::iter::from_fn(|| sent(&mut pair.sender, pair.now)).collect::<Vec<_>>()
    };
    let end = |sdus: &[Vec<u8>]| {
        let mut pair = Pair::new();
        sdus.iter()
            .find_map(|sdu| pair.receiver.on_sdu(&mut sdu.clone(), pair.now).err())
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

/// A push to a named key with congestion control `Drop`, as Zenoh encodes it. In front of it, a batch contains an id, a
/// sequence number, a QoS extension and, in a first fragment, the extension that marks it.
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
fn droppable_batches_of_these_tests_have_the_format_of_zenoh() {
    let is_droppable = true;
    for (kind, expected) in [
        (Kind::Whole, BatchKind::Whole { is_droppable }),
        (Kind::First, BatchKind::FirstFragment { is_droppable }),
        (Kind::Next, BatchKind::NextFragment),
    ] {
        assert_eq!(BatchKind::of(&droppable(kind, 100)), expected);
    }
}

#[test]
fn droppable_message_is_accepted_only_while_little_waits_and_then_completely() {
    let mut pair = Pair::new();
    assert!(pair.push(5, &droppable(Kind::First, MTU)));
    let mut accepted = 1;
    while pair.waiting(5) < 20_000 {
        assert!(
            pair.push(5, &droppable(Kind::Next, MTU)),
            "a started message is accepted completely"
        );
        accepted += 1;
    }
    assert!(!pair.push(5, &droppable(Kind::First, MTU)));
    assert!(!pair.push(5, &droppable(Kind::Whole, 50)));
    assert!(pair.push(5, b"a message that must arrive is accepted"));
    for _ in 0..accepted {
        pair.settle();
        assert!(pair.take(5).is_some());
    }
    assert!(pair.push(5, &droppable(Kind::First, MTU)));
}

#[test]
fn waiting_fragments_of_an_abandoned_message_are_withdrawn() {
    let mut pair = Pair::new();
    pair.push(5, b"whole");
    for kind in [Kind::First, Kind::Next, Kind::Next] {
        assert!(pair.push(5, &droppable(kind, 100)));
    }
    assert!(pair.push(5, b""));
    pair.settle();
    assert_eq!(pair.take(5), Some(b"whole".to_vec()));
    assert_eq!(pair.take(5), None);
    assert_eq!(
        pair.sender.lane_report(lane(5), pair.now).0.abandoned_sdus,
        3
    );
}

/// For any order of pushing, sending, taking and acknowledging, each lane delivers in order what was pushed, and nothing is
/// left at the end.
#[test]
fn every_lane_delivers_everything_in_order_for_any_order_of_events() {
    for seed in 0..200 {
        let mut rng = Pcg32::seed_from_u64(seed);
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
            let number = (rng.next_u32() % LANES as u32) as u8;
            match rng.next_u32() % if round < 5000 { 5 } else { 3 } {
                0 => drop(pair.step()),
                1 => drop(pair.step_back()),
                2 => take(&mut pair, number, &mut taken),
                _ => {
                    let at = usize::from(number);
                    let mut batch = vec![0; 4 + rng.next_u32() as usize % (MTU - 3)];
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

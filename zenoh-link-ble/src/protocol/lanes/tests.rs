//! Tests both sides of a link together, over paths with and without faults: `cargo test -p zenoh-link-ble lanes`
use std::{
    convert::Infallible,
    time::{Duration, Instant},
};

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

use super::{
    backlog::BATCH_STALL_TIMEOUT,
    batch_kind::BatchKind,
    check::Fault,
    credits::{cost, largest_batch, CreditError, MIN_WINDOW},
    receiver::{Violation, HIGH_WATERMARK},
    scheduler::{Bounds, Sent, RESERVED_BYTES_PER_LANE},
    sdu::{Content, Protection, SduError, Sealer},
    Change, Lane, Lanes, LANES,
};
use crate::protocol::{
    hello::MIN_MTU,
    seal::{LinkKeys, NotAuthentic},
};

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

/// Bounds with half a second of small messages, and with the same bound in bytes as in the other tests.
const HALF_A_SECOND: Bounds = Bounds {
    backlog: Duration::from_millis(500),
    ..BOUNDS
};

/// Returns a batch of a message that must arrive, as Zenoh encodes it.
fn must_arrive(kind: Kind, size: usize) -> Vec<u8> {
    let mut batch: Vec<u8> = match kind {
        Kind::Whole => vec![0x25, 0x07],
        Kind::First => vec![0xe6, 0x07, 0x02],
        Kind::Next => vec![0x66, 0x08],
    };
    if !matches!(kind, Kind::Next) {
        // Like `PUSH`, but with congestion control `Block`.
        batch.extend_from_slice(&[0xbd, 0x00, 0x01, b'k', 0x21, 0x0d, 0x01, 0x00]);
    }
    batch.resize(size, 0);
    batch
}

impl Pair {
    /// Offers whole messages to a lane until it accepts no more, and returns the number of accepted ones.
    fn fill(&mut self, number: u8) -> usize {
        std::iter::repeat_with(|| self.push(number, &must_arrive(Kind::Whole, MTU)))
            .take_while(|is_accepted| *is_accepted)
            .count()
    }

    /// Offers all fragments of a message at once, and returns whether the lane accepted the first one.
    fn push_message(&mut self, number: u8, fragments: usize) -> bool {
        let is_accepted = self.push(number, &must_arrive(Kind::First, MTU));
        if is_accepted {
            for fragment in 1..fragments {
                let is_accepted = self.push(number, &must_arrive(Kind::Next, MTU));
                assert!(
                    is_accepted,
                    "fragment {fragment} of a message that was started"
                );
            }
        }
        is_accepted
    }

    fn backlog(&self, number: u8) -> usize {
        let (out, _) = self.sender.lane_report(lane(number), self.now);
        usize::try_from(out.backlog_bytes).expect("small")
    }

    /// Sends at that rate for that time to a receiver that reads everything.
    fn run(&mut self, bytes_per_s: f64, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            match self.step() {
                Some(_) => {
                    self.now += Duration::from_secs_f64(MTU as f64 / bytes_per_s);
                    while (0..LANES as u8).any(|number| self.take(number).is_some()) {}
                    while self.step_back().is_some() {}
                }
                None => self.now += Duration::from_millis(1),
            }
        }
    }
}

#[test]
fn batches_of_the_backlog_tests_have_the_format_of_zenoh() {
    let is_droppable = false;
    for (kind, expected) in [
        (Kind::Whole, BatchKind::Whole { is_droppable }),
        (Kind::First, BatchKind::FirstFragment { is_droppable }),
        (Kind::Next, BatchKind::NextFragment),
    ] {
        assert_eq!(BatchKind::of(&must_arrive(kind, 100)), expected);
    }
}

#[test]
fn small_messages_wait_no_longer_than_the_backlog_allows() {
    for bytes_per_s in [34_000.0, 100_000.0] {
        let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
        pair.fill(5);
        // The lane is kept full, like the lane of a program that floods it.
        for _ in 0..3000 {
            pair.run(bytes_per_s, Duration::from_millis(1));
            pair.fill(5);
        }
        let wait_s = pair.backlog(5) as f64 / bytes_per_s;
        assert!(
            (0.4..0.6).contains(&wait_s),
            "{bytes_per_s} B/s: {wait_s} s"
        );
        assert!(!pair.push(5, &must_arrive(Kind::First, MTU)));
        // Each lane has a separate backlog.
        assert!(pair.push(6, &must_arrive(Kind::Whole, MTU)));
        pair.run(bytes_per_s, Duration::from_millis(100));
        assert!(pair.push(5, &must_arrive(Kind::Whole, MTU)));
    }
}

#[test]
fn started_message_is_accepted_completely_and_a_large_one_does_not_delay_the_next() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    // 50 kB: a small message, for which the next one has to wait.
    assert!(pair.push_message(5, 50));
    assert!(!pair.push_message(5, 2));
    assert_eq!(pair.fill(5), 0);
    pair.run(34_000.0, Duration::from_secs(2));
    assert_eq!(pair.backlog(5), 0);
    // 70 kB: a message that does not count once it is known to be large.
    assert!(pair.push_message(5, 70));
    assert_eq!(pair.backlog(5), 0);
    assert!(pair.waiting(5) > 70_000);
    assert!(pair.push(5, &must_arrive(Kind::First, MTU)));
    assert!(pair.backlog(5) > MTU);
}

#[test]
fn bound_in_bytes_holds_for_large_messages() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    assert!(pair.push_message(5, 70));
    assert!(pair.push(5, &must_arrive(Kind::First, MTU)));
    let pushed = std::iter::repeat_with(|| pair.push(5, &must_arrive(Kind::Next, MTU)));
    let accepted = pushed.take_while(|is_accepted| *is_accepted).count();
    assert!(accepted < 30, "{accepted}");
    assert!(pair.waiting(5) <= BOUNDS.bytes as u64);
}

#[test]
fn backlog_of_an_abandoned_message_is_released() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    for fragments in [10, 70] {
        assert!(pair.push(5, &must_arrive(Kind::Whole, MTU)));
        assert!(pair.push_message(5, fragments));
        assert!(pair.push(5, b""));
        assert_eq!(pair.backlog(5), usize::from(cost(MTU)));
        pair.run(34_000.0, Duration::from_secs(3));
        assert_eq!(pair.backlog(5), 0);
    }
}

#[test]
fn lane_without_progress_accepts_one_batch_every_two_seconds() {
    for is_stopped in [true, false] {
        let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
        // No batch that counts can leave the lane: the lane is stopped, or a large message waits before them.
        if is_stopped {
            pair.sender.out.on_stopped(lane(5), true);
        } else {
            assert!(pair.push_message(5, 70));
        }
        pair.fill(5);
        let batch = must_arrive(Kind::Whole, MTU);
        for _ in 0..5 {
            let at = pair.sender.retry_at(lane(5), &batch, pair.now);
            let at = at.expect("a time to retry");
            assert_eq!(at - pair.now, BATCH_STALL_TIMEOUT);
            pair.now = at - Duration::from_millis(1);
            assert!(!pair.push(5, &batch));
            pair.now = at;
            assert!(!pair.push(5, &must_arrive(Kind::First, MTU)));
            assert!(pair.push(5, &batch));
            assert!(!pair.push(5, &batch));
        }
        let first = must_arrive(Kind::First, MTU);
        let at = pair.sender.retry_at(lane(5), &first, pair.now);
        pair.now = at.expect("a time to retry");
        assert!(pair.push(5, &first));
    }
}

#[test]
fn declarations_have_no_backlog() {
    // Zenoh sends declarations on lane 0, and waits for room with its routing tables locked.
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    assert!(pair.fill(0) > 80);
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

/// A peer that sends any content, with correct checks.
struct MisbehavingPeer {
    pair: Pair,
    sealer: Sealer,
}

impl MisbehavingPeer {
    fn new() -> Self {
        Self {
            pair: Pair::new(),
            sealer: Protection::checks().out,
        }
    }

    fn sends(&mut self, content: Content<'_>) -> Result<Change, Violation> {
        let mut sdu = content.encode();
        let Ok(_) = self.sealer.seal(&mut sdu, |_| Ok::<_, Infallible>(true));
        self.pair.receiver.on_sdu(&mut sdu, self.pair.now)
    }
}

#[test]
fn peer_that_ignores_its_credits_is_detected_within_the_window() {
    let mut peer = MisbehavingPeer::new();
    let batch = Content::Batch(lane(3), &[0; MTU]);
    let sent = std::iter::from_fn(|| peer.sends(batch).ok()).count();
    assert_eq!(sent, usize::from(WINDOW / cost(MTU)));
    let expected = Err(Violation::Credits(CreditError::Overrun));
    assert_eq!(peer.sends(batch), expected);
}

/// Batches that the receiver has acknowledged no longer count, even if the peer has not read the acknowledgement. Unread
/// lanes are bounded separately.
#[test]
fn receiver_that_has_acknowledged_cannot_detect_an_overrun() {
    let mut peer = MisbehavingPeer::new();
    for n in 0..10 * (WINDOW / cost(MTU)) {
        let change = peer.sends(Content::Batch(lane(3), &[0; MTU]));
        assert_eq!(change, Ok(Change::Batch(lane(3))), "batch {n}");
        assert!(peer.pair.take(3).is_some());
        while sent(&mut peer.pair.receiver, peer.pair.now).is_some() {}
    }
}

#[test]
fn peer_that_keeps_sending_on_a_stopped_lane_is_detected() {
    let mut peer = MisbehavingPeer::new();
    let batch = Content::Batch(lane(3), &[0; MTU]);
    let mut held = 0;
    let violation = loop {
        // The peer gets its acknowledgements and ignores all other signals.
        while sent(&mut peer.pair.receiver, peer.pair.now).is_some() {}
        match peer.sends(batch) {
            Ok(_) => held += MTU,
            Err(violation) => break violation,
        }
        assert!(held < 100_000, "memory is bounded");
    };
    assert_eq!(violation, Violation::Stopped(lane(3)));
}

#[test]
fn acknowledgement_of_more_than_was_sent_is_detected() {
    let mut peer = MisbehavingPeer::new();
    let expected = Err(Violation::Credits(CreditError::ExceedsSent));
    assert_eq!(peer.sends(Content::Ack(1)), expected);
}

#[test]
fn sdu_over_the_mtu_ends_the_link() {
    let mut peer = MisbehavingPeer::new();
    let (size, mtu) = (MTU + 1, MTU);
    let expected = Err(Violation::TooLarge { size, mtu });
    assert_eq!(peer.sends(Content::Batch(lane(3), &[0; MTU + 1])), expected);
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

//! Both sides together, over a way that delivers in order, or does not: `cargo test -p zenoh-link-ble lanes`
use std::time::{Duration, Instant};

use rand_pcg::{
    rand_core::{RngCore, SeedableRng},
    Pcg32,
};

use super::{
    backlog::BATCH_PATIENCE,
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
    // Never reached: what is tested with these bounds is the bound in bytes.
    backlog: Duration::from_secs(600),
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
        Self::with(BOUNDS, MTU, WINDOW)
    }

    fn with(bounds: Bounds, mtu: usize, window: u16) -> Self {
        Self {
            out: Lanes::new(bounds, mtu, window, window),
            into: Lanes::new(bounds, mtu, window, window),
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
            let mut pair = Pair::with(BOUNDS, mtu, window);
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

/// Bounds of a link on which half a second of messages may wait, and of large ones as much as in the other tests.
const HALF_A_SECOND: Bounds = Bounds {
    backlog: Duration::from_millis(500),
    ..BOUNDS
};

/// A batch as Zenoh makes it of messages that must arrive.
fn must_arrive(kind: Kind, size: usize) -> Vec<u8> {
    let mut batch: Vec<u8> = match kind {
        Kind::Whole => vec![0x25, 0x07],
        Kind::First => vec![0xe6, 0x07, 0x02],
        Kind::Next => vec![0x66, 0x08],
    };
    if !matches!(kind, Kind::Next) {
        // As `PUSH`, with congestion control "block".
        batch.extend_from_slice(&[0xbd, 0x00, 0x01, b'k', 0x21, 0x0d, 0x01, 0x00]);
    }
    batch.resize(size, 0);
    batch
}

impl Pair {
    /// Offers whole messages to a lane until it takes no more, and returns how many it took.
    fn fill(&mut self, number: u8) -> usize {
        std::iter::repeat_with(|| self.push(number, &must_arrive(Kind::Whole, MTU)))
            .take_while(|is_taken| *is_taken)
            .count()
    }

    /// Offers a message of several pieces, all of them at once, and returns whether the lane took its first piece.
    fn push_message(&mut self, number: u8, pieces: usize) -> bool {
        let is_taken = self.push(number, &must_arrive(Kind::First, MTU));
        if is_taken {
            for piece in 1..pieces {
                let is_taken = self.push(number, &must_arrive(Kind::Next, MTU));
                assert!(is_taken, "piece {piece} of a message that was begun");
            }
        }
        is_taken
    }

    fn backlog(&self, number: u8) -> usize {
        let (out, _) = self.out.lane_report(lane(number), self.now);
        usize::try_from(out.backlog_bytes).expect("small")
    }

    /// Sends what waits at that rate, for that time, to a receiver that reads everything.
    fn run(&mut self, bytes_per_s: f64, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            match self.step() {
                Some(_) => {
                    self.now += Duration::from_secs_f64(MTU as f64 / bytes_per_s);
                    while (0..LANES as u8).any(|number| self.take(number).is_some()) {}
                    while self.back().is_some() {}
                }
                None => self.now += Duration::from_millis(1),
            }
        }
    }
}

#[test]
fn the_batches_of_the_backlog_tests_are_what_zenoh_would_send() {
    let is_droppable = false;
    for (kind, piece) in [
        (Kind::Whole, Piece::Whole { is_droppable }),
        (Kind::First, Piece::First { is_droppable }),
        (Kind::Next, Piece::Next),
    ] {
        assert_eq!(Piece::of(&must_arrive(kind, 100)), piece);
    }
}

#[test]
fn small_messages_wait_for_no_longer_than_the_backlog_allows() {
    for bytes_per_s in [34_000.0, 100_000.0] {
        let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
        pair.fill(5);
        // The lane is kept full, as by a program that floods it.
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
        // Other lanes have a backlog of their own.
        assert!(pair.push(6, &must_arrive(Kind::Whole, MTU)));
        pair.run(bytes_per_s, Duration::from_millis(100));
        assert!(pair.push(5, &must_arrive(Kind::Whole, MTU)));
    }
}

#[test]
fn message_that_was_begun_is_taken_whole_and_large_one_does_not_delay_the_next() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    // 50 kB: a small message, which the next one has to wait for.
    assert!(pair.push_message(5, 50));
    assert!(!pair.push_message(5, 2));
    assert_eq!(pair.fill(5), 0);
    pair.run(34_000.0, Duration::from_secs(2));
    assert_eq!(pair.backlog(5), 0);
    // 70 kB: once its size shows, it no longer counts.
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
    let taken = std::iter::repeat_with(|| pair.push(5, &must_arrive(Kind::Next, MTU)));
    let taken = taken.take_while(|is_taken| *is_taken).count();
    assert!(taken < 30, "{taken}");
    assert!(pair.waiting(5) <= BOUNDS.bytes as u64);
}

#[test]
fn backlog_of_a_message_that_zenoh_gave_up_is_given_back() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    for pieces in [10, 70] {
        assert!(pair.push(5, &must_arrive(Kind::Whole, MTU)));
        assert!(pair.push_message(5, pieces));
        assert!(pair.push(5, b""));
        assert_eq!(pair.backlog(5), usize::from(cost(MTU)));
        pair.run(34_000.0, Duration::from_secs(3));
        assert_eq!(pair.backlog(5), 0);
    }
}

#[test]
fn lane_on_which_nothing_moves_takes_one_batch_every_two_seconds() {
    for is_stopped in [true, false] {
        let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
        // Nothing of what counts leaves the lane: it is stopped, or all of it is behind a large message.
        if is_stopped {
            pair.out.out.on_stopped(lane(5), true);
        } else {
            assert!(pair.push_message(5, 70));
        }
        pair.fill(5);
        let batch = must_arrive(Kind::Whole, MTU);
        for _ in 0..5 {
            let at = pair.out.ask_again_at(lane(5), &batch, pair.now);
            let at = at.expect("there is a time to ask again");
            assert_eq!(at - pair.now, BATCH_PATIENCE);
            pair.now = at - Duration::from_millis(1);
            assert!(!pair.push(5, &batch));
            pair.now = at;
            assert!(!pair.push(5, &must_arrive(Kind::First, MTU)));
            assert!(pair.push(5, &batch));
            assert!(!pair.push(5, &batch));
        }
        let first = must_arrive(Kind::First, MTU);
        let at = pair.out.ask_again_at(lane(5), &first, pair.now);
        pair.now = at.expect("there is a time to ask again");
        assert!(pair.push(5, &first));
    }
}

#[test]
fn declarations_have_no_backlog() {
    // Zenoh sends them on lane 0, and waits for room with its routing tables locked.
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    assert!(pair.fill(0) > 80);
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

/// Batches that the receiver has acknowledged no longer count, even if the peer has not read the acknowledgement. Lanes that
/// are not read have a bound of their own.
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

//! How much of a lane may wait.
use std::time::Duration;

use super::{lane, Kind, Pair, BOUNDS, MTU, WINDOW};
use crate::lanes::{
    backlog::{BATCH_STALL_TIMEOUT, MESSAGE_STALL_TIMEOUT},
    batch_kind::BatchKind,
    credits::cost,
    scheduler::Bounds,
    LANES,
};

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
    assert!(pair.push(5, &must_arrive(Kind::Whole, MTU)));
    assert!(pair.backlog(5) >= MTU);
}

#[test]
fn large_message_waits_until_the_one_before_it_is_nearly_sent() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    assert!(pair.push_message(5, 70));
    assert!(!pair.push_message(5, 70));
    // Each lane may have one.
    assert!(pair.push(6, &must_arrive(Kind::First, MTU)));
    pair.run(34_000.0, Duration::from_millis(1700));
    assert!(!pair.push_message(5, 70));
    pair.run(34_000.0, Duration::from_millis(200));
    assert!(pair.waiting(5) > 0, "the radio stays busy");
    assert!(pair.push_message(5, 70));
}

/// Programs that send large messages as fast as the lane accepts them, and then leave.
#[test]
fn flood_of_large_messages_delays_the_next_message_by_at_most_five_seconds() {
    let bytes_per_s = 34_000.0;
    let bounds = Bounds {
        bytes: 16 << 20,
        backlog: Duration::from_millis(1000),
        ..BOUNDS
    };
    for fragments in [9, 31, 60, 65, 66, 100, 150] {
        let mut pair = Pair::with(bounds, MTU, WINDOW);
        let (begin, mut accepted) = (pair.now, 0);
        // Longer than the time after which a lane without progress accepts a message.
        while pair.now < begin + 3 * MESSAGE_STALL_TIMEOUT {
            while pair.push_message(5, fragments) {
                accepted += 1;
            }
            pair.run(bytes_per_s, Duration::from_millis(1));
        }
        assert!(accepted > 10, "{fragments} kB: the link carries the flood");
        let since = pair.now;
        while !pair.push(5, &must_arrive(Kind::Whole, MTU)) {
            pair.run(bytes_per_s, Duration::from_millis(1));
        }
        while pair.waiting(5) > 0 {
            pair.run(bytes_per_s, Duration::from_millis(1));
        }
        let wait = pair.now - since;
        assert!(wait < Duration::from_secs(5), "{fragments} kB: {wait:?}");
    }
}

#[test]
fn bound_in_bytes_holds_for_large_messages() {
    let mut pair = Pair::with(HALF_A_SECOND, MTU, WINDOW);
    assert!(pair.push(5, &must_arrive(Kind::First, MTU)));
    let pushed = std::iter::repeat_with(|| pair.push(5, &must_arrive(Kind::Next, MTU)));
    let accepted = pushed.take_while(|is_accepted| *is_accepted).count();
    assert!(accepted < 100, "{accepted}");
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

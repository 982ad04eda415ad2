//! Two ends of a link, and any order of events: batches put in and taken, SDUs that go either way, a peer that says what
//! it likes. An honest pair delivers each lane in order; whatever a rogue says, what is held has a bound.
#![no_main]
use std::time::{Duration, Instant};

use libfuzzer_sys::fuzz_target;
use zenoh_link_ble::lanes::{
    receiver::HIGH_MARK,
    scheduler::{Bounds, OWN_BYTES},
    sdu::{seal, Content},
    Lane, Lanes, LANES,
};

const MTU: usize = 300;
const WINDOW: u16 = 4000;
const QUEUE: usize = 100_000;

struct Ends {
    out: Lanes,
    into: Lanes,
    now: Instant,
    /// SDUs that went from `out` to `into`.
    number: u32,
    is_rogue: bool,
    is_over: bool,
    pushed: [u32; LANES],
    taken: [u32; LANES],
    /// Lanes of which something was taken back before it went out.
    gave_up: [bool; LANES],
}

impl Ends {
    fn new() -> Self {
        let bounds = Bounds {
            bytes: QUEUE,
            backlog: Duration::from_millis(200),
            droppable: Duration::from_millis(150),
        };
        let lanes = || Lanes::new(bounds, MTU, WINDOW, WINDOW);
        Self {
            out: lanes(),
            into: lanes(),
            now: Instant::now(),
            number: 0,
            is_rogue: false,
            is_over: false,
            pushed: [0; LANES],
            taken: [0; LANES],
            gave_up: [false; LANES],
        }
    }

    fn push(&mut self, lane: Lane, size: usize) {
        let mut batch = vec![0; 4 + size % (MTU - 3)];
        let pushed = &mut self.pushed[lane.index()];
        batch[..4].copy_from_slice(&pushed.to_le_bytes());
        if self.out.push(lane, &batch, self.now) {
            *pushed += 1;
        }
        let waiting = self.out.lane_report(lane, self.now).0.waiting.bytes;
        assert!(waiting <= (QUEUE + OWN_BYTES) as u64);
    }

    fn arrives(&mut self, sdu: &[u8]) {
        self.number += 1;
        if let Err(violation) = self.into.on_sdu(sdu, self.now) {
            assert!(self.is_rogue, "{violation}");
            self.is_over = true;
        }
    }

    fn there(&mut self) {
        if let Some((next, sdu)) = self.out.peek() {
            let sdu = sdu.to_vec();
            self.out.on_sent(next, self.now);
            self.arrives(&sdu);
        }
    }

    fn back(&mut self) {
        if let Some((next, sdu)) = self.into.peek() {
            let sdu = sdu.to_vec();
            self.into.on_sent(next, self.now);
            let done = self.out.on_sdu(&sdu, self.now);
            assert!(done.is_ok() || self.is_rogue, "{done:?}");
        }
    }

    fn take(&mut self, lane: Lane) {
        if let Some(batch) = self.into.take(lane) {
            if self.is_rogue {
                return;
            }
            let taken = &mut self.taken[lane.index()];
            let number = u32::from_le_bytes(batch[..4].try_into().expect("four bytes"));
            assert!(number == *taken || number > *taken && self.gave_up[lane.index()]);
            *taken = number + 1;
        }
    }

    /// Zenoh does this when it gives up a message half-way.
    fn give_up(&mut self, lane: Lane) {
        self.gave_up[lane.index()] = true;
        assert!(self.out.push(lane, b"", self.now));
    }

    /// A rightly sealed SDU that no honest peer would have sent now.
    fn says(&mut self, content: Content<'_>) {
        self.is_rogue = true;
        let mut sdu = content.encode();
        seal(self.number, &mut sdu);
        self.arrives(&sdu);
    }
}

fuzz_target!(|events: &[u8]| {
    let mut ends = Ends::new();
    for event in events.chunks_exact(3) {
        let Some(lane) = Lane::new(event[0] & 7) else {
            continue;
        };
        let (size, sum) = (
            usize::from(event[1]) * 2,
            u16::from_le_bytes([event[1], event[2]]),
        );
        ends.now += Duration::from_millis(u64::from(event[2]));
        match event[0] >> 3 {
            0..=7 => ends.push(lane, size),
            8..=14 => ends.there(),
            15..=20 => ends.back(),
            21..=25 => ends.take(lane),
            26 => ends.says(Content::Ack(sum)),
            27 => ends.says(Content::Stop(lane)),
            28 => ends.says(Content::Go(lane)),
            29 => ends.says(Content::Batch(lane, &vec![event[2]; 1 + size])),
            30 => ends.out.close(event[1]),
            _ => ends.give_up(lane),
        }
        let most = HIGH_MARK + MTU + usize::from(WINDOW);
        let held = |lane| ends.into.lane_report(lane, ends.now).1.held_bytes;
        assert!(Lane::all().all(|lane| held(lane) <= most));
        if ends.is_over {
            return;
        }
    }
});

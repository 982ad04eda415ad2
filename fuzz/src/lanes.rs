//! Runs two ends of a link through any sequence of events: batches are pushed and taken, SDUs are exchanged, and a
//! rogue peer sends anything. An honest pair must deliver each lane in order; the memory in use must be bounded in any
//! case.
use std::{
    convert::Infallible,
    time::{Duration, Instant},
};

use link_lanes::{lanes::{receiver::HIGH_WATERMARK, scheduler::{Bounds, RESERVED_BYTES_PER_LANE}, sdu::{Content, Protection, Sealer}, Lane, Lanes, LANES}, seal::LinkKeys};

/// Largest batch, in bytes.
const MTU: usize = 300;
/// Receive window of both ends, in bytes.
const WINDOW: u16 = 4000;
/// Size of the send queue, in bytes.
const QUEUE: usize = 100_000;

struct Ends {
    out: Lanes,
    into: Lanes,
    now: Instant,
    /// Seals what a rogue sends from `out` to `into` of a link without a secret.
    sealer: Option<Sealer>,
    is_rogue: bool,
    is_finished: bool,
    pushed: [u32; LANES],
    taken: [u32; LANES],
    /// Lanes of which a batch was withdrawn before it was sent.
    aborted: [bool; LANES],
}

impl Ends {
    /// Creates both ends of a link, with a secret or without.
    fn new(is_encrypted: bool) -> Self {
        let bounds = Bounds {
            bytes: QUEUE,
            backlog: Duration::from_millis(200),
            droppable: Duration::from_millis(150),
        };
        let lanes = |own: u8, of_peer: u8| {
            let protection = match is_encrypted {
                true => Protection::keys(LinkKeys::new([own; 32], [of_peer; 32])),
                false => Protection::checks(),
            };
            Lanes::new(bounds, MTU, WINDOW, WINDOW, protection)
        };
        Self {
            out: lanes(1, 2),
            into: lanes(2, 1),
            now: Instant::now(),
            sealer: (!is_encrypted).then(|| Protection::checks().out),
            is_rogue: false,
            is_finished: false,
            pushed: [0; LANES],
            taken: [0; LANES],
            aborted: [false; LANES],
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
        assert!(waiting <= (QUEUE + RESERVED_BYTES_PER_LANE) as u64);
    }

    fn deliver(&mut self, sdu: &mut [u8]) {
        if let Err(violation) = self.into.on_sdu(sdu, self.now) {
            assert!(self.is_rogue, "{violation}");
            self.is_finished = true;
        }
    }

    fn send_forward(&mut self) {
        if let Some(mut sdu) = sent(&mut self.out, self.now) {
            if let Some(Sealer::Check { number }) = &mut self.sealer {
                *number += 1;
            }
            self.deliver(&mut sdu);
        }
    }

    fn send_back(&mut self) {
        if let Some(mut sdu) = sent(&mut self.into, self.now) {
            let done = self.out.on_sdu(&mut sdu, self.now);
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
            assert!(number == *taken || number > *taken && self.aborted[lane.index()]);
            *taken = number + 1;
        }
    }

    /// Aborts a message that was sent in part, as Zenoh does.
    fn abort(&mut self, lane: Lane) {
        self.aborted[lane.index()] = true;
        assert!(self.out.push(lane, b"", self.now));
    }

    /// Delivers an SDU that no honest peer would send now. Without a secret it has a correct check; with one it is forged,
    /// and must end the link.
    fn send_as_rogue(&mut self, content: Content<'_>) {
        self.is_rogue = true;
        let mut sdu = content.encode();
        match &mut self.sealer {
            Some(sealer) => {
                let Ok(_) = sealer.seal(&mut sdu, |_| Ok::<_, Infallible>(true));
                self.deliver(&mut sdu);
            }
            None => {
                sdu.extend_from_slice(&[0; 8]);
                self.deliver(&mut sdu);
                assert!(self.is_finished, "a forged SDU was accepted");
            }
        }
    }
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

/// Runs the target on one input.
pub fn run(events: &[u8]) {
    let (is_encrypted, events) = match events.split_first() {
        Some((first, events)) => (first & 1 == 1, events),
        None => return,
    };
    let mut ends = Ends::new(is_encrypted);
    for event in events.chunks_exact(3) {
        let Some(lane) = Lane::new(event[0] & 7) else {
            continue;
        };
        let (size, total) = (
            usize::from(event[1]) * 2,
            u16::from_le_bytes([event[1], event[2]]),
        );
        ends.now += Duration::from_millis(u64::from(event[2]));
        match event[0] >> 3 {
            0..=7 => ends.push(lane, size),
            8..=14 => ends.send_forward(),
            15..=20 => ends.send_back(),
            21..=25 => ends.take(lane),
            26 => ends.send_as_rogue(Content::Ack(total)),
            27 => ends.send_as_rogue(Content::Stop(lane)),
            28 => ends.send_as_rogue(Content::Go(lane)),
            29 => ends.send_as_rogue(Content::Batch(lane, &vec![event[2]; 1 + size])),
            30 => ends.out.close(event[1]),
            _ => ends.abort(lane),
        }
        let limit = HIGH_WATERMARK + MTU + usize::from(WINDOW);
        let unread = |lane| ends.into.lane_report(lane, ends.now).1.unread_bytes;
        assert!(Lane::all().all(|lane| unread(lane) <= limit));
        if ends.is_finished {
            return;
        }
    }
}

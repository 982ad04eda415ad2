//! Decides how fast the declarations of one session reach Zenoh; logic without I/O.
//!
//! A router forwards the declarations of a program (subscribers, queryables, tokens) over all of its links, before everything else,
//! because messages refer to them. Thousands at once would delay the urgent messages of all programs on a slow link by seconds.
//! Therefore a session that has used up its share waits before its next batch. Other routers do not wait: they forward what the
//! programs of their robots have declared.
//!
//! While a session waits, what it sends is read ahead. Otherwise its program would collect its declarations into batches of 64 kB,
//! and a batch cannot be divided.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use zenoh_buffers::reader::HasReader;
use zenoh_codec::{RCodec, Zenoh080};
use zenoh_protocol::{
    common::imsg,
    core::WhatAmI,
    network::{id as network, Declare, DeclareBody, Interest},
    transport::{id as transport, FrameHeader, InitSyn, KeepAlive},
};

/// Number of declarations that a session may make at once.
pub const BURST: u32 = 200;
/// Number of further declarations that a session may make per second.
pub const PER_S: u32 = 50;
/// Number of bytes that are read ahead of a session that waits.
const MAX_AHEAD_BYTES: usize = 1 << 20;

/// The stream of a session: batches, each behind its length.
#[derive(Debug)]
pub struct Incoming {
    rate: Rate,
    next: Part,
    /// The bytes that were read ahead.
    ahead: VecDeque<u8>,
    has_waited: bool,
}

/// The part of the stream that Zenoh reads next.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Part {
    FirstLength,
    FirstBatch,
    Length,
    Batch,
}

impl Incoming {
    /// Begins a session.
    pub fn new(now: Instant) -> Self {
        Self {
            rate: Rate {
                left: BURST.into(),
                at: now,
            },
            next: Part::FirstLength,
            ahead: VecDeque::new(),
            has_waited: false,
        }
    }

    /// Returns until when the next batch has to wait. Until then, [`on_ahead`](Self::on_ahead) takes what arrives, if there is
    /// [`room`](Self::room).
    pub fn waits_until(&mut self, now: Instant) -> Option<Instant> {
        let until = match self.next {
            Part::Length => self.rate.ready_at(now),
            _ => None,
        };
        self.has_waited |= until.is_some();
        until
    }

    /// Returns how many bytes may be read ahead.
    pub fn room(&self) -> usize {
        MAX_AHEAD_BYTES.saturating_sub(self.ahead.len())
    }

    /// Handles bytes that were read ahead.
    pub fn on_ahead(&mut self, bytes: &[u8]) {
        self.ahead.extend(bytes);
    }

    /// Fills the beginning of `part` with what was read ahead. The rest has to be read from the link.
    pub fn fill(&mut self, part: &mut [u8]) -> usize {
        let count = part.len().min(self.ahead.len());
        for (to, from) in part.iter_mut().zip(self.ahead.drain(..count)) {
            *to = from;
        }
        if self.ahead.is_empty() {
            // A session rarely waits, and the memory is large.
            self.ahead = VecDeque::new();
        }
        count
    }

    /// Handles a length or a batch that Zenoh reads now. Returns the number of its declarations if the batch has waited.
    pub fn on_part(&mut self, part: &[u8], now: Instant) -> Option<u32> {
        self.next = match self.next {
            Part::FirstLength => Part::FirstBatch,
            Part::Length => Part::Batch,
            Part::FirstBatch => {
                if is_of_router(part) {
                    self.rate.left = f64::INFINITY;
                }
                Part::Length
            }
            Part::Batch => {
                let count = declarations(part);
                self.rate.on_declared(count, now);
                let has_waited = std::mem::take(&mut self.has_waited);
                self.next = Part::Length;
                return (has_waited && count > 0).then_some(count);
            }
        };
        None
    }
}

/// How many declarations may be made, and since when.
#[derive(Debug)]
struct Rate {
    /// Negative if there were too many; infinite without a limit.
    left: f64,
    at: Instant,
}

impl Rate {
    fn left(&self, now: Instant) -> f64 {
        if self.left.is_infinite() {
            return self.left;
        }
        let since = now.saturating_duration_since(self.at).as_secs_f64();
        (self.left + since * f64::from(PER_S)).min(BURST.into())
    }

    /// Counts declarations. A batch counts as at most [`BURST`], because the session would expire if it waited for long.
    fn on_declared(&mut self, count: u32, now: Instant) {
        if count > 0 {
            self.left = self.left(now) - f64::from(count.min(BURST));
            self.at = now;
        }
    }

    fn ready_at(&self, now: Instant) -> Option<Instant> {
        let missing = -self.left(now);
        let wait = || Duration::from_secs_f64(missing / f64::from(PER_S));
        (missing > 0.0).then(|| now + wait())
    }
}

/// Returns whether the first batch of a session is the one with which a router begins it.
fn is_of_router(batch: &[u8]) -> bool {
    let init: Result<InitSyn, _> = Zenoh080::new().read(&mut batch.reader());
    init.is_ok_and(|init| init.whatami == WhatAmI::Router)
}

/// Returns the number of declarations at the beginning of a batch. They have a priority, and thereby batches, of their own.
fn declarations(batch: &[u8]) -> u32 {
    let mut reader = batch.reader();
    let next = || next_message(&mut reader);
    std::iter::from_fn(next).map(u32::from).sum()
}

/// Returns whether a router forwards a declaration. The short forms of keys apply to one link only.
fn is_forwarded(body: &DeclareBody) -> bool {
    !matches!(
        body,
        DeclareBody::DeclareKeyExpr(_)
            | DeclareBody::UndeclareKeyExpr(_)
            | DeclareBody::DeclareFinal(_)
    )
}

/// Reads a message, and returns whether it is a declaration that counts. Returns `None` if it is one that is not sent beside declarations.
fn next_message(reader: &mut &[u8]) -> Option<bool> {
    let codec = Zenoh080::new();
    Some(match imsg::mid(*reader.first()?) {
        transport::FRAME => {
            let _: FrameHeader = codec.read(reader).ok()?;
            false
        }
        transport::KEEP_ALIVE => {
            let _: KeepAlive = codec.read(reader).ok()?;
            false
        }
        network::INTEREST => {
            let _: Interest = codec.read(reader).ok()?;
            false
        }
        network::DECLARE => {
            let declare: Declare = codec.read(reader).ok()?;
            is_forwarded(&declare.body)
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use zenoh_codec::WCodec;
    use zenoh_protocol::{
        core::{Priority, Reliability, WireExpr},
        network::{
            declare::{self, DeclareKeyExpr, DeclareToken},
            DeclareFinal,
        },
        transport::frame,
    };

    use super::*;

    fn declare(body: DeclareBody) -> Declare {
        Declare {
            interest_id: None,
            ext_qos: declare::ext::QoSType::DECLARE,
            ext_tstamp: None,
            ext_nodeid: declare::ext::NodeIdType::DEFAULT,
            body,
        }
    }

    /// Returns a batch with a frame of that many tokens and keys, and the end of the answer to an interest.
    fn batch(tokens: u32) -> Vec<u8> {
        let (codec, mut bytes) = (Zenoh080::new(), Vec::new());
        let header = FrameHeader {
            reliability: Reliability::Reliable,
            sn: 300,
            ext_qos: frame::ext::QoSType::new(Priority::Control),
        };
        assert!(codec.write(&mut bytes, &header).is_ok());
        for id in 0..tokens {
            let token = DeclareToken {
                id,
                wire_expr: WireExpr::from("rect/wombat-1/token"),
            };
            let token = declare(DeclareBody::DeclareToken(token));
            assert!(codec.write(&mut bytes, &token).is_ok());
            let key = DeclareKeyExpr {
                id: id as u16,
                wire_expr: WireExpr::from("rect/wombat-1/token"),
            };
            let key = declare(DeclareBody::DeclareKeyExpr(key));
            assert!(codec.write(&mut bytes, &key).is_ok());
        }
        let end = declare(DeclareBody::DeclareFinal(DeclareFinal));
        assert!(codec.write(&mut bytes, &end).is_ok());
        bytes
    }

    /// Returns the first batch of a session: the version, what the other side is with the length of its id, and its id.
    fn init(whatami: WhatAmI) -> Vec<u8> {
        let whatami = match whatami {
            WhatAmI::Router => 0,
            WhatAmI::Peer => 1,
            WhatAmI::Client => 2,
        };
        vec![transport::INIT, 9, whatami, 1]
    }

    /// A session that sends batches, and the time.
    struct Session {
        incoming: Incoming,
        start: Instant,
        now: Instant,
        waited: u32,
    }

    impl Session {
        fn of(whatami: WhatAmI) -> Self {
            let start = Instant::now();
            let mut session = Self {
                incoming: Incoming::new(start),
                start,
                now: start,
                waited: 0,
            };
            session.send(&init(whatami));
            session
        }

        /// Lets Zenoh read a batch as soon as it may.
        fn send(&mut self, batch: &[u8]) {
            while let Some(until) = self.incoming.waits_until(self.now) {
                assert!(
                    until - self.now <= Duration::from_secs(4),
                    "it would expire"
                );
                self.now = until + Duration::from_nanos(1);
            }
            let length = u16::try_from(batch.len()).expect("short").to_le_bytes();
            assert_eq!(self.incoming.on_part(&length, self.now), None);
            let waited = self.incoming.on_part(batch, self.now);
            self.waited += waited.unwrap_or_default();
        }

        fn elapsed_s(&self) -> f64 {
            (self.now - self.start).as_secs_f64()
        }
    }

    #[test]
    fn program_that_declares_much_waits_after_a_burst() {
        for whatami in [WhatAmI::Client, WhatAmI::Peer] {
            let mut session = Session::of(whatami);
            for declared in 0..2500 {
                session.send(&batch(1));
                let most = f64::from(BURST) + session.elapsed_s() * f64::from(PER_S) + 1.0;
                assert!(
                    f64::from(declared) <= most,
                    "{declared} at {}",
                    session.elapsed_s()
                );
            }
            assert!((45.0..47.0).contains(&session.elapsed_s()));
            assert_eq!(session.waited, 2500 - BURST - 1);
        }
    }

    #[test]
    fn batches_of_many_declarations_count_as_a_burst_at_most() {
        let mut session = Session::of(WhatAmI::Client);
        for _ in 0..5 {
            session.send(&batch(1000));
        }
        // None waits for the first one, and each of the others for 200.
        assert!((11.0..17.0).contains(&session.elapsed_s()));
    }

    #[test]
    fn usual_programs_and_other_routers_do_not_wait() {
        let mut program = Session::of(WhatAmI::Client);
        for _ in 0..100 {
            program.send(&batch(2));
        }
        assert_eq!((program.elapsed_s(), program.waited), (0.0, 0));
        let mut router = Session::of(WhatAmI::Router);
        for _ in 0..100 {
            router.send(&batch(1000));
        }
        assert_eq!((router.elapsed_s(), router.waited), (0.0, 0));
    }

    #[test]
    fn share_is_available_again_after_some_time() {
        let mut session = Session::of(WhatAmI::Client);
        session.send(&batch(BURST));
        session.now += Duration::from_secs(1000);
        let begin = session.elapsed_s();
        for _ in 0..BURST {
            session.send(&batch(1));
        }
        assert_eq!(session.elapsed_s(), begin);
    }

    #[test]
    fn only_declarations_count() {
        assert_eq!(declarations(&batch(0)), 0);
        assert_eq!(declarations(&batch(7)), 7);
        let mut with_keep_alive = Vec::new();
        assert!(Zenoh080::new()
            .write(&mut with_keep_alive, &KeepAlive)
            .is_ok());
        with_keep_alive.extend(batch(3));
        assert_eq!(declarations(&with_keep_alive), 3);
        let whole = batch(20);
        for end in 0..whole.len() {
            assert!(declarations(&whole[..end]) <= 20);
        }
        assert_eq!(declarations(&[0xff; 100]), 0);
    }

    #[test]
    fn what_is_read_ahead_is_read_in_order() {
        let mut incoming = Incoming::new(Instant::now());
        incoming.on_ahead(&[1, 2, 3]);
        assert_eq!(incoming.room(), MAX_AHEAD_BYTES - 3);
        let mut part = [0; 2];
        assert_eq!((incoming.fill(&mut part), part), (2, [1, 2]));
        let mut part = [0; 2];
        assert_eq!((incoming.fill(&mut part), part), (1, [3, 0]));
        assert_eq!(incoming.fill(&mut part), 0);
    }
}

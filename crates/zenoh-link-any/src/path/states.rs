//! Tests every state of a path with every event.
use super::*;

const FRAME: Range<u64> = 100..600;

#[derive(Clone, Copy, Debug)]
enum Event {
    /// An acknowledgement of everything in flight.
    Acked,
    /// A repeated acknowledgement.
    AckedAgain,
    /// An acknowledgement of more than was sent.
    AckedTooMuch,
    /// No acknowledgement for a long time.
    Silence,
    /// A frame of the peer.
    Received,
    /// The pause before a ping has passed, and the ping was sent.
    PingSent,
    /// Another path has failed, and this is the only one.
    OnlyOne,
}

use Event::{Acked, AckedAgain, AckedTooMuch, OnlyOne, PingSent, Received, Silence};
use PathState::{Live, Suspected, Untried};

fn data() -> Option<(Lane, Range<u64>)> {
    Some((Lane::first(), FRAME))
}

/// Returns a path in that state with one frame in flight: data if it is used, otherwise a ping.
fn path_in(state: PathState, now: Instant) -> Path {
    let mut path = Path::new(Medium::Network, 1000, state != Untried, now);
    match state {
        Untried => path.on_ping_sent(1, now),
        Live => path.on_sent(data(), 500, false, now),
        Suspected => {
            path.on_sent(data(), 500, false, now);
            path.suspect(now);
            assert_eq!(path.give_up(), [data().expect("data")]);
            path.on_ping_sent(1, now);
        }
    }
    assert_eq!(path.state(), state);
    path
}

/// Does what [`Multipath`](crate::multipath::Multipath) does for that event.
fn happen(path: &mut Path, event: Event, now: Instant) -> Result<(), AckError> {
    let in_flight = u16::try_from(path.in_flight.len()).expect("few");
    let all = path.acked_frames.wrapping_add(in_flight);
    match event {
        Acked => path.on_ack(all, now).map(drop),
        AckedAgain => path.on_ack(path.acked_frames, now).map(drop),
        AckedTooMuch => path.on_ack(all.wrapping_add(1), now).map(drop),
        Silence => {
            if path.suspect_at().is_some_and(|at| at <= now) {
                path.suspect(now);
            }
            Ok(())
        }
        Received => {
            path.on_received(500, false, now);
            Ok(())
        }
        PingSent => {
            path.on_ping_sent(1, now);
            Ok(())
        }
        OnlyOne => {
            if path.has_answered() {
                path.recover();
            }
            Ok(())
        }
    }
}

#[test]
fn every_state_handles_every_event() {
    for (state, event, next) in [
        (Untried, Acked, Live),
        (Untried, AckedAgain, Untried),
        (Untried, AckedTooMuch, Untried),
        (Untried, Silence, Untried),
        (Untried, Received, Untried),
        (Untried, PingSent, Untried),
        (Untried, OnlyOne, Untried),
        (Live, Acked, Live),
        (Live, AckedAgain, Live),
        (Live, AckedTooMuch, Live),
        (Live, Silence, Suspected),
        (Live, Received, Live),
        (Live, PingSent, Live),
        (Live, OnlyOne, Live),
        (Suspected, Acked, Suspected),
        (Suspected, AckedAgain, Suspected),
        (Suspected, AckedTooMuch, Suspected),
        (Suspected, Silence, Suspected),
        (Suspected, Received, Suspected),
        (Suspected, PingSent, Suspected),
        (Suspected, OnlyOne, Suspected),
    ] {
        let start = Instant::now();
        let mut path = path_in(state, start);
        let later = start + Duration::from_secs(60);
        let happened = happen(&mut path, event, later);
        assert_eq!(path.state(), next, "{state:?}, {event:?}");
        let is_violation = matches!(event, AckedTooMuch);
        assert_eq!(happened.is_err(), is_violation, "{state:?}, {event:?}");
        // Only a path that is used can become suspect; only one that is not asks for answers.
        let can_become_suspect = path.suspect_at().is_some();
        assert!(next == Live || !can_become_suspect, "{state:?}, {event:?}");
        let is_used_without_ping = next == Live && !matches!(event, PingSent);
        assert_eq!(
            path.ping_at().is_none(),
            is_used_without_ping,
            "{state:?}, {event:?}"
        );
    }
}

#[test]
fn suspected_path_is_used_after_four_answers_or_one_if_it_is_the_only_one() {
    let now = Instant::now();
    let mut path = path_in(Suspected, now);
    for answer in 1..=ANSWERS_TO_RECOVER {
        assert_eq!(path.state(), Suspected, "before answer {answer}");
        happen(&mut path, Acked, now).expect("an acknowledgement");
        path.on_ping_sent(1, now);
    }
    assert_eq!(path.state(), Live);
    let mut path = path_in(Suspected, now);
    happen(&mut path, Acked, now).expect("an acknowledgement");
    happen(&mut path, OnlyOne, now).expect("used");
    assert_eq!(path.state(), Live);
}

#[test]
fn pings_become_rarer_until_there_is_an_answer() {
    let mut now = Instant::now();
    let mut path = path_in(Suspected, now);
    let mut pauses = Vec::new();
    for _ in 0..8 {
        let at = path.ping_at().expect("a ping is due");
        pauses.push(at - now);
        now = at;
        path.on_ping_sent(1, now);
    }
    assert_eq!(pauses[0], PING_INTERVAL);
    assert!(pauses.windows(2).all(|pair| pair[0] <= pair[1]));
    assert_eq!(pauses.last(), Some(&MAX_PING_INTERVAL));
    happen(&mut path, Acked, now).expect("an acknowledgement");
    assert_eq!(path.ping_at(), Some(now + PING_INTERVAL));
}

#[test]
fn data_is_given_up_once() {
    let now = Instant::now();
    let mut path = path_in(Live, now);
    path.suspect(now);
    assert_eq!(path.give_up(), [data().expect("data")]);
    assert_eq!(path.give_up(), []);
}

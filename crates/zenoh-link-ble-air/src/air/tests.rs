//! Tests of the model alone, with simulated time: `cargo test -p zenoh-link-ble-air --lib air`.
mod collisions;
mod day;
mod drift;
mod network;

use std::time::Duration;
use zenoh_link_ble_radio::{address::Psm, advertisement::Advertisement};

use super::*;

use crate::message::{Command, ConnectFailure, RequestId};

const A: AdapterId = AdapterId(1);
const B: AdapterId = AdapterId(2);

fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn psm() -> Psm {
    Psm::new(0x80).expect("valid")
}

fn request(number: u32) -> RequestId {
    RequestId(number)
}

/// Returns an air on which `sim-a` dials `sim-b`, which listens and advertises.
fn dialling(seed: u64, condition: Condition) -> Air {
    let mut air = Air::new(AirOptions {
        seed,
        condition,
        ..AirOptions::default()
    });
    assert_eq!(air.attach("sim-a", ms(0)), Ok(A));
    assert_eq!(air.attach("sim-b", ms(0)), Ok(B));
    let listen = Command::Listen {
        request: request(1),
        psm: Some(psm()),
        recv_mtu: 2000,
    };
    let advertise = Command::Advertise {
        request: request(2),
        advertisement: Advertisement {
            psm: psm(),
            plain: false,
            name_hash: 0,
            fleet_hash: 0,
            incarnation: 0,
        },
        name: "b".to_owned(),
    };
    for command in [listen, advertise] {
        air.command(B, command, ms(0)).expect("accepts the command");
    }
    air.command(A, connect(air.adapters[&B].address), ms(0))
        .expect("accepts the command");
    air
}

fn connect(peer: zenoh_link_ble_radio::address::DeviceAddress) -> Command {
    Command::Connect {
        request: request(7),
        peer,
        psm: psm(),
        recv_mtu: 2000,
    }
}

/// Polls until an event matches, and returns it.
fn until(air: &mut Air, limit: Duration, matches: impl Fn(&TimedEvent) -> bool) -> TimedEvent {
    loop {
        if let Some(event) = air.drain().into_iter().find(|event| matches(event)) {
            return event;
        }
        let next = air.next_wakeup().expect("a timer is set");
        assert!(next < limit, "no matching event within {limit:?}");
        air.poll(next);
    }
}

fn connected(seed: u64, condition: Condition) -> (Air, ChannelId) {
    let mut air = dialling(seed, condition);
    loop {
        let answer = until(&mut air, ms(20_000), |timed| {
            matches!(
                timed.event,
                Event::Connected { .. } | Event::ConnectFailed { .. }
            )
        });
        if let Event::Connected { channel, .. } = answer.event {
            return (air, channel);
        }
        // The connect request was lost.
        let (peer, now) = (air.adapters[&B].address, air.now);
        air.command(A, connect(peer), now)
            .expect("accepts the command");
    }
}

/// Returns the time of the next poll.
type Step = fn(&mut Air) -> Option<Duration>;

/// Polls at every timer.
fn every_step(air: &mut Air) -> Option<Duration> {
    air.next_timer().map(|(at, _)| at)
}

fn trace(seed: u64, condition: Condition) -> Vec<TimedEvent> {
    trace_by(|air| air.next_wakeup(), seed, condition)
}

/// Returns all events while A sends as fast as possible for five seconds and B reads immediately, followed by a cut.
fn trace_by(step: Step, seed: u64, condition: Condition) -> Vec<TimedEvent> {
    let (mut air, channel) = connected(seed, condition);
    let mut trace = Vec::new();
    let limit = AirOptions::default().ahead_bytes();
    let mut queued = 0;
    let mut fill = |air: &mut Air, now, sent: usize| {
        queued -= sent;
        while queued <= limit {
            queued += 700;
            let sdu = vec![1; 700];
            air.command(A, Command::Send { channel, sdu }, now)
                .expect("room");
        }
    };
    let now = air.now;
    fill(&mut air, now, 0);
    while let Some(next) = step(&mut air).filter(|next| *next < ms(9000)) {
        if next > ms(6000) && !air.is_cut {
            air.cut(ms(6000));
            continue;
        }
        air.poll(next);
        for event in air.drain() {
            assert_eq!(event.at, next, "event reported late");
            match event.event {
                _ if next > ms(5000) => {}
                Event::Sent { bytes, .. } => fill(&mut air, next, bytes),
                Event::Received { .. } => {
                    air.command(B, Command::SduRead { channel }, next)
                        .expect("accepts the command");
                }
                _ => {}
            }
            trace.push(event);
        }
    }
    trace
}

#[test]
fn produces_the_same_events_for_the_same_seed_only() {
    let first = trace(1, Condition::EdgeOfRange);
    assert!(first.len() > 100, "{} events", first.len());
    assert_eq!(first, trace(1, Condition::EdgeOfRange));
    assert_ne!(first, trace(2, Condition::EdgeOfRange));
}

#[test]
fn reports_every_event_on_time_if_polled_at_wakeups() {
    for condition in Condition::ALL {
        let all = trace_by(every_step, 5, condition);
        assert!(trace(5, condition) == all, "{condition}");
        let is_end = |timed: &TimedEvent| matches!(timed.event, Event::Closed { .. });
        let ends = all.iter().filter(|timed| is_end(timed)).count();
        assert_eq!(ends, 2, "{condition}: both sides receive the end");
    }
}

#[test]
fn wakes_up_once_per_supervision_timeout_for_an_idle_link() {
    let (mut air, _) = connected(1, Condition::Room);
    air.poll(ms(1000));
    let mut wakeups = 0;
    while let Some(next) = air.next_wakeup().filter(|next| *next <= ms(61_000)) {
        air.poll(next);
        wakeups += 1;
    }
    assert!((30..=62).contains(&wakeups), "{wakeups} in a minute");
}

#[test]
fn produces_the_same_events_after_a_late_poll() {
    let (mut exact, _) = connected(3, Condition::Wall);
    let (mut late, _) = connected(3, Condition::Wall);
    while let Some(next) = every_step(&mut exact).filter(|next| *next <= ms(10_000)) {
        exact.poll(next);
    }
    late.poll(ms(10_000));
    assert_eq!(late.drain(), exact.drain());
    assert_eq!(late.stats("sim-a"), exact.stats("sim-a"));
}

#[test]
fn connect_includes_advertisement_setup_and_channel_request() {
    let mut air = dialling(1, Condition::Desk);
    let incoming = until(&mut air, ms(1000), |timed| {
        matches!(timed.event, Event::Incoming { .. })
    });
    let connected = until(&mut air, ms(1000), |timed| {
        matches!(timed.event, Event::Connected { .. })
    });
    assert!(
        incoming.at > ms(90),
        "three set-up events of 30 ms: {:?}",
        incoming.at
    );
    assert!(connected.at > incoming.at);
    assert!(connected.at < ms(200), "{:?}", connected.at);
}

#[test]
fn keeps_links_at_the_edge_of_range() {
    for seed in 0..20 {
        let (mut air, _) = connected(seed, Condition::EdgeOfRange);
        air.drain();
        air.poll(ms(120_000));
        assert_eq!(air.drain(), [], "seed {seed}");
    }
}

#[test]
fn reports_an_orderly_detach_at_the_next_event() {
    let (mut air, channel) = connected(1, Condition::Desk);
    let now = air.now;
    air.detach(B, now);
    let closed = until(&mut air, now + ms(100), |timed| {
        timed.event == Event::Closed { channel }
    });
    assert_eq!(closed.adapter, A);
    assert!(closed.at <= now + ms(30));
}

#[test]
fn reports_a_removed_peer_after_the_supervision_timeout() {
    let (mut air, channel) = connected(1, Condition::Desk);
    let now = air.now;
    air.remove("sim-b", now).expect("is attached");
    let closed = until(&mut air, now + ms(3000), |timed| {
        timed.event == Event::Closed { channel }
    });
    assert_eq!(closed.adapter, A);
    assert!(closed.at > now + ms(1900), "{:?}", closed.at - now);
}

#[test]
fn fails_a_connect_if_the_link_is_lost_during_setup() {
    let mut air = dialling(1, Condition::Desk);
    while air.connections.is_empty() {
        let next = air.next_wakeup().expect("advertising");
        air.poll(next);
    }
    let now = air.now;
    air.cut(now);
    let failed = until(&mut air, now + ms(1000), |timed| timed.adapter == A);
    let why = ConnectFailure::LinkLost;
    let request = request(7);
    assert_eq!(failed.event, Event::ConnectFailed { request, why });
}

#[test]
fn delivers_exactly_the_packets_before_a_scheduled_cut() {
    let received_sdus = |packets| {
        let (mut air, channel) = connected(1, Condition::Room);
        let now = air.now;
        air.cut_after(packets, now);
        for (from, sdu) in [(A, vec![1; 700]), (B, vec![2; 20]), (A, vec![3; 20])] {
            air.command(from, Command::Send { channel, sdu }, now)
                .expect("room");
        }
        air.poll(now + ms(1000));
        let received = |timed: TimedEvent| match timed.event {
            Event::Received { sdu, .. } => Some(sdu[0]),
            _ => None,
        };
        air.drain()
            .into_iter()
            .filter_map(received)
            .collect::<Vec<_>>()
    };
    // An SDU of 700 bytes takes three packets; the peripheral's answer comes after the first of them.
    let by_packets: Vec<_> = (0..=6).map(received_sdus).collect();
    let expected: [&[u8]; 7] = [&[], &[], &[2], &[2], &[2, 1], &[2, 1, 3], &[2, 1, 3]];
    assert_eq!(by_packets, expected);
}

#[test]
fn does_not_report_a_detach_to_a_peer_out_of_range() {
    let (mut air, channel) = connected(1, Condition::Desk);
    let now = air.now;
    air.cut_between("sim-b", "sim-a", now);
    air.power("sim-b", false, now).expect("is attached");
    let closed = until(&mut air, now + ms(3000), |timed| {
        timed.event == Event::Closed { channel }
    });
    assert!(closed.at > now + ms(1900), "{:?}", closed.at - now);
}

#[test]
fn cutting_one_pair_does_not_affect_a_third_adapter() {
    let (mut air, _) = connected(1, Condition::Desk);
    let now = air.now;
    let c = air.attach("sim-c", now).expect("attaches");
    air.cut_between("sim-b", "sim-a", now);
    let peer = air.adapters[&B].address;
    air.command(c, connect(peer), now)
        .expect("accepts the command");
    until(&mut air, now + ms(1000), |timed| timed.adapter == c);
    air.restore(now);
}

#[test]
fn reports_a_scanned_device_a_few_times_per_second() {
    let mut air = dialling(1, Condition::Desk);
    let c = air.attach("sim-c", ms(0)).expect("attaches");
    air.command(c, Command::Scan(true), ms(0))
        .expect("accepts the command");
    air.poll(ms(10_000));
    let events = air.drain();
    let count = events
        .iter()
        .filter(|timed| {
            timed.adapter == c && matches!(timed.event, Event::AdvertisementReceived(_))
        })
        .count();
    assert!((30..=50).contains(&count), "{count} in ten seconds");
}

#[test]
fn rejects_commands_that_violate_the_protocol() {
    let (mut air, channel) = connected(1, Condition::Desk);
    let now = air.now;
    let sdu = vec![0; 2001];
    assert_eq!(
        air.command(A, Command::Send { channel, sdu }, now),
        Err(crate::message::Violation::SduSize)
    );
    assert_eq!(
        air.command(A, Command::SduRead { channel }, now),
        Err(crate::message::Violation::NothingToRead)
    );
    // Commands for a channel of another adapter are ignored.
    let c = air.attach("sim-c", now).expect("attaches");
    assert_eq!(air.command(c, Command::SduRead { channel }, now), Ok(()));
    assert_eq!(air.command(c, Command::Close { channel }, now), Ok(()));
    assert_eq!(air.connections.len(), 1);
}

#[test]
fn attaches_a_name_only_once() {
    let mut air = Air::new(AirOptions::default());
    let first = air.attach("sim-a", ms(0)).expect("attaches");
    assert_eq!(
        air.attach("sim-a", ms(0)),
        Err(AttachError::InUse("sim-a".to_owned()))
    );
    air.detach(first, ms(1));
    assert!(air.attach("sim-a", ms(2)).is_ok());
}

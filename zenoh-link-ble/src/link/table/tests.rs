//! Tests the table of links: `cargo test -p zenoh-link-ble --lib link::table`
use link_lanes::hello::HandshakeMessage;
use serde::Deserialize;
use zenoh_link_ble_radio::address::{Address, AddressType};

use super::*;

const LOW: NodeId = NodeId(1);
const HIGH: NodeId = NodeId(2);

fn device(last: u8) -> DeviceAddress {
    DeviceAddress {
        address: Address([0xc0, 0, 0, 0, 0, last]),
        kind: AddressType::Random,
    }
}

fn hello(node: NodeId, name: &str) -> Hello {
    Hello {
        version: 1,
        node,
        mtu: 1000,
        window: 12_000,
        name: name.to_owned(),
        intervals: None,
        path: None,
        accepts_compressed: false,
    }
}

fn to(name: &str) -> Target {
    Target::Name(name.to_owned())
}

fn token() -> CancellationToken {
    CancellationToken::new()
}

fn receive_hello(
    links: &mut LinkTable,
    peer: &Hello,
    sender: DeviceAddress,
    now: Instant,
) -> Verdict {
    links.on_hello("me", Some(peer), sender, 7, now, token()).0
}

#[test]
fn lower_node_id_refuses_a_crossing_dial_and_keeps_its_own() {
    let mut links = LinkTable::new(LOW);
    let cancel = token();
    let dial = links.on_dial(&to("peer"), cancel.clone()).expect("free");
    assert!(links.on_sending_hello(dial));
    let verdict = receive_hello(&mut links, &hello(HIGH, "peer"), device(2), Instant::now());
    assert_eq!(verdict, Verdict::Refuse(Refusal::Crossing));
    assert!(!cancel.is_cancelled());
}

#[test]
fn higher_node_id_accepts_a_crossing_dial_and_cancels_its_own() {
    for target in [to("peer"), Target::Address(device(2).address)] {
        let mut links = LinkTable::new(HIGH);
        let cancel = token();
        let dial = links.on_dial(&target, cancel.clone()).expect("free");
        assert!(links.on_sending_hello(dial));
        let verdict = receive_hello(&mut links, &hello(LOW, "peer"), device(2), Instant::now());
        assert_eq!(verdict, Verdict::Accept);
        assert!(cancel.is_cancelled());
    }
}

#[test]
fn dial_without_a_sent_hello_yields_for_any_node_id() {
    for (own, other) in [(LOW, HIGH), (HIGH, LOW)] {
        let (mut links, cancel) = (LinkTable::new(own), token());
        let dial = links.on_dial(&to("peer"), cancel.clone()).expect("free");
        let verdict = receive_hello(&mut links, &hello(other, "peer"), device(2), Instant::now());
        assert_eq!(verdict, Verdict::Accept);
        assert!(cancel.is_cancelled());
        assert!(!links.on_sending_hello(dial), "too late");
    }
}

#[test]
fn hello_that_crosses_an_accepted_dial_is_refused_for_a_while() {
    let mut links = LinkTable::new(LOW);
    let start = Instant::now();
    let dial = links.on_dial(&to("peer"), token()).expect("free");
    let peer = hello(HIGH, "peer");
    links
        .on_accepted(dial, Some(&peer), device(2), start, token())
        .expect("first");
    assert_eq!(
        receive_hello(
            &mut links,
            &peer,
            device(2),
            start + CROSSING - Duration::from_millis(1)
        ),
        Verdict::Refuse(Refusal::AlreadyLinked)
    );
    assert_eq!(
        receive_hello(&mut links, &peer, device(2), start + CROSSING),
        Verdict::Accept
    );
}

#[test]
fn link_of_a_peer_that_dials_again_is_replaced() {
    let mut links = LinkTable::new(LOW);
    let now = Instant::now();
    let old = token();
    let peer = hello(HIGH, "peer");
    links.on_hello("me", Some(&peer), device(2), 7, now, old.clone());
    assert_eq!(
        receive_hello(&mut links, &peer, device(2), now),
        Verdict::Accept
    );
    assert!(old.is_cancelled());
    assert_eq!(links.established.len(), 1);
}

#[test]
fn restarted_peer_replaces_its_earlier_run() {
    let mut links = LinkTable::new(LOW);
    let now = Instant::now();
    let old = token();
    links.on_hello(
        "me",
        Some(&hello(HIGH, "peer")),
        device(2),
        7,
        now,
        old.clone(),
    );
    let again = hello(NodeId(99), "peer");
    assert_eq!(
        receive_hello(&mut links, &again, device(2), now),
        Verdict::Accept
    );
    assert!(old.is_cancelled());
}

#[test]
fn second_robot_with_the_same_name_is_refused() {
    let mut links = LinkTable::new(LOW);
    let now = Instant::now();
    receive_hello(&mut links, &hello(HIGH, "peer"), device(2), now);
    assert_eq!(
        receive_hello(&mut links, &hello(NodeId(3), "peer"), device(3), now),
        Verdict::Refuse(Refusal::NameTaken)
    );
    assert_eq!(
        receive_hello(&mut links, &hello(NodeId(4), "me"), device(4), now),
        Verdict::Refuse(Refusal::NameTaken)
    );
}

#[test]
fn limit_of_links_counts_only_other_peers() {
    let mut links = LinkTable::new(LOW);
    let now = Instant::now();
    let mut receive_hello_with_limit = |node: u64, last: u8| {
        let peer = hello(NodeId(node), &format!("peer-{node}"));
        links
            .on_hello("me", Some(&peer), device(last), 2, now, token())
            .0
    };
    assert_eq!(receive_hello_with_limit(10, 10), Verdict::Accept);
    assert_eq!(receive_hello_with_limit(11, 11), Verdict::Accept);
    assert_eq!(
        receive_hello_with_limit(12, 12),
        Verdict::Refuse(Refusal::Full)
    );
    assert_eq!(receive_hello_with_limit(11, 11), Verdict::Accept);
    assert_eq!(links.free_places(Some(NodeId(12)), device(12), 2), 0);
    assert_eq!(links.free_places(Some(NodeId(11)), device(11), 2), 1);
}

#[test]
fn linked_or_dialled_target_is_not_dialled_again() {
    let mut links = LinkTable::new(LOW);
    let dial = links.on_dial(&to("peer"), token()).expect("free");
    assert_eq!(links.on_dial(&to("peer"), token()), None);
    let peer = hello(HIGH, "peer");
    links
        .on_accepted(dial, Some(&peer), device(2), Instant::now(), token())
        .expect("first");
    assert_eq!(links.on_dial(&to("peer"), token()), None);
    assert_eq!(
        links.on_dial(&Target::Address(device(2).address), token()),
        None
    );
    links.on_closed(dial);
    assert!(links.on_dial(&to("peer"), token()).is_some());
}

#[test]
fn plain_peers_are_identified_by_their_address() {
    let mut links = LinkTable::new(LOW);
    let now = Instant::now();
    let old = token();
    let (verdict, _) = links.on_hello("me", None, device(5), 7, now, old.clone());
    assert_eq!(verdict, Verdict::Accept);
    let (verdict, _) = links.on_hello("me", None, device(5), 7, now, token());
    assert_eq!(verdict, Verdict::Accept);
    assert!(old.is_cancelled());
}

/// A hello and the decision about it: a case of `vectors/pair.json`, which an independent implementation
/// (`tests/protocol/link_messages.py`) has written from `PROTOCOL.md`.
#[derive(Deserialize)]
struct Case {
    case: String,
    own: Peer,
    max_links: usize,
    links: Vec<Peer>,
    dials: Vec<OwnDial>,
    peer: Peer,
    /// The code of the refusal.
    answer: Option<u8>,
    /// The links that end.
    ended: Vec<usize>,
    /// The dials that are cancelled.
    cancelled: Vec<usize>,
}

/// A peer, or a link with it.
#[derive(Deserialize)]
struct Peer {
    node: u64,
    name: String,
    address: u8,
    /// Whether this node has dialled the link.
    is_dialled: bool,
    age_ms: u64,
}

#[derive(Deserialize)]
struct OwnDial {
    name: String,
    is_hello_sent: bool,
}

impl Peer {
    fn hello(&self) -> Hello {
        hello(NodeId(self.node), &self.name)
    }
}

fn indices(cancelled: &[CancellationToken]) -> Vec<usize> {
    let cancelled = cancelled.iter().enumerate();
    let cancelled = cancelled.filter(|(_, token)| token.is_cancelled());
    cancelled.map(|(index, _)| index).collect()
}

#[test]
fn hellos_are_decided_as_documented() {
    let text = include_str!("../../../vectors/pair.json");
    let cases: Vec<Case> = serde_json::from_str(text).expect("valid");
    let now = Instant::now() + Duration::from_secs(3600);
    for case in cases {
        let mut table = LinkTable::new(NodeId(case.own.node));
        let (mut ends, mut cancels) = (Vec::new(), Vec::new());
        for link in &case.links {
            let since = now - Duration::from_millis(link.age_ms);
            let (peer, sender, end) = (link.hello(), device(link.address), token());
            ends.push(end.clone());
            if link.is_dialled {
                let dial = table.on_dial(&to(&link.name), token()).expect("free");
                let accepted = table.on_accepted(dial, Some(&peer), sender, since, end);
                accepted.expect("the first link with it");
            } else {
                table.on_hello("", Some(&peer), sender, 99, since, end);
            }
        }
        for dial in &case.dials {
            cancels.push(token());
            let cancel = cancels.last().expect("one").clone();
            let number = table.on_dial(&to(&dial.name), cancel).expect("free");
            if dial.is_hello_sent {
                assert!(table.on_sending_hello(number));
            }
        }
        let (verdict, _) = table.on_hello(
            &case.own.name,
            Some(&case.peer.hello()),
            device(case.peer.address),
            case.max_links,
            now,
            token(),
        );
        let answer = match verdict {
            Verdict::Accept => None,
            Verdict::Refuse(refusal) => HandshakeMessage::Refuse(refusal).encode().pop(),
        };
        assert_eq!(answer, case.answer, "{}", case.case);
        assert_eq!(indices(&ends), case.ended, "{}", case.case);
        assert_eq!(indices(&cancels), case.cancelled, "{}", case.case);
    }
}

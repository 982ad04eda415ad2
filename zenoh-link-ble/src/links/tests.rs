//! `cargo test -p zenoh-link-ble --lib links`
use super::*;
use crate::address::{Address, AddressType};

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
        nonce: None,
    }
}

fn to(name: &str) -> Target {
    Target::Name(name.to_owned())
}

fn token() -> CancellationToken {
    CancellationToken::new()
}

fn greet(links: &mut Links, peer: &Hello, from: DeviceAddress, now: Instant) -> Verdict {
    links.on_hello("me", Some(peer), from, 7, now, token()).0
}

#[test]
fn the_lower_node_refuses_a_crossing_dial_and_keeps_its_own() {
    let mut links = Links::new(LOW);
    let mine = token();
    let dial = links.on_dial(&to("peer"), mine.clone()).expect("free");
    assert!(links.on_hello_said(dial));
    let verdict = greet(&mut links, &hello(HIGH, "peer"), device(2), Instant::now());
    assert_eq!(verdict, Verdict::Refuse(Refusal::Crossing));
    assert!(!mine.is_cancelled());
}

#[test]
fn the_higher_node_accepts_a_crossing_dial_and_gives_up_its_own() {
    for target in [to("peer"), Target::Address(device(2).address)] {
        let mut links = Links::new(HIGH);
        let mine = token();
        let dial = links.on_dial(&target, mine.clone()).expect("free");
        assert!(links.on_hello_said(dial));
        let verdict = greet(&mut links, &hello(LOW, "peer"), device(2), Instant::now());
        assert_eq!(verdict, Verdict::Accept);
        assert!(mine.is_cancelled());
    }
}

#[test]
fn a_dial_that_has_not_said_hello_gives_way_whoever_is_lower() {
    for (own, other) in [(LOW, HIGH), (HIGH, LOW)] {
        let (mut links, mine) = (Links::new(own), token());
        let dial = links.on_dial(&to("peer"), mine.clone()).expect("free");
        let verdict = greet(&mut links, &hello(other, "peer"), device(2), Instant::now());
        assert_eq!(verdict, Verdict::Accept);
        assert!(mine.is_cancelled());
        assert!(!links.on_hello_said(dial), "too late");
    }
}

#[test]
fn a_hello_that_crossed_an_accepted_dial_is_refused_for_a_while() {
    let mut links = Links::new(LOW);
    let start = Instant::now();
    let dial = links.on_dial(&to("peer"), token()).expect("free");
    let peer = hello(HIGH, "peer");
    links
        .on_accepted(dial, Some(&peer), device(2), start, token())
        .expect("first");
    assert_eq!(
        greet(
            &mut links,
            &peer,
            device(2),
            start + CROSSING - Duration::from_millis(1)
        ),
        Verdict::Refuse(Refusal::AlreadyLinked)
    );
    assert_eq!(
        greet(&mut links, &peer, device(2), start + CROSSING),
        Verdict::Accept
    );
}

#[test]
fn a_peer_that_dials_again_has_lost_its_link_so_the_old_one_ends() {
    let mut links = Links::new(LOW);
    let now = Instant::now();
    let old = token();
    let peer = hello(HIGH, "peer");
    links.on_hello("me", Some(&peer), device(2), 7, now, old.clone());
    assert_eq!(greet(&mut links, &peer, device(2), now), Verdict::Accept);
    assert!(old.is_cancelled());
    assert_eq!(links.established.len(), 1);
}

#[test]
fn a_restarted_peer_replaces_its_earlier_run() {
    let mut links = Links::new(LOW);
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
    assert_eq!(greet(&mut links, &again, device(2), now), Verdict::Accept);
    assert!(old.is_cancelled());
}

#[test]
fn two_robots_of_one_name_are_told_apart_and_the_second_refused() {
    let mut links = Links::new(LOW);
    let now = Instant::now();
    greet(&mut links, &hello(HIGH, "peer"), device(2), now);
    assert_eq!(
        greet(&mut links, &hello(NodeId(3), "peer"), device(3), now),
        Verdict::Refuse(Refusal::NameTaken)
    );
    assert_eq!(
        greet(&mut links, &hello(NodeId(4), "me"), device(4), now),
        Verdict::Refuse(Refusal::NameTaken)
    );
}

#[test]
fn the_bound_on_links_counts_other_peers_only() {
    let mut links = Links::new(LOW);
    let now = Instant::now();
    let mut greet_with_bound = |node: u64, last: u8| {
        let peer = hello(NodeId(node), &format!("peer-{node}"));
        links
            .on_hello("me", Some(&peer), device(last), 2, now, token())
            .0
    };
    assert_eq!(greet_with_bound(10, 10), Verdict::Accept);
    assert_eq!(greet_with_bound(11, 11), Verdict::Accept);
    assert_eq!(greet_with_bound(12, 12), Verdict::Refuse(Refusal::Full));
    assert_eq!(greet_with_bound(11, 11), Verdict::Accept);
}

#[test]
fn a_linked_or_dialled_target_is_not_dialled_again_until_it_ends() {
    let mut links = Links::new(LOW);
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
fn plain_peers_are_known_by_their_address() {
    let mut links = Links::new(LOW);
    let now = Instant::now();
    let old = token();
    let (verdict, _) = links.on_hello("me", None, device(5), 7, now, old.clone());
    assert_eq!(verdict, Verdict::Accept);
    let (verdict, _) = links.on_hello("me", None, device(5), 7, now, token());
    assert_eq!(verdict, Verdict::Accept);
    assert!(old.is_cancelled());
}

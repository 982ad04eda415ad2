//! Tests the choice of connection intervals: `cargo test -p zenoh-link-ble --lib link::intervals`
use super::*;
use crate::address::{Address, AddressType};

fn units(units: u16) -> ConnectionInterval {
    ConnectionInterval::from_units(units).expect("valid")
}

fn device(n: u8) -> DeviceAddress {
    DeviceAddress {
        address: Address([0xc0, 0, 0, 0, 0, n]),
        kind: AddressType::Random,
    }
}

fn link(peer: u8, is_central: bool, interval: u16) -> LinkInterval {
    LinkInterval {
        device: device(peer),
        is_central,
        interval: units(interval),
        peer_avoids: Some(Vec::new()),
        changes: 0,
    }
}

fn table(links: &[LinkInterval]) -> IntervalTable {
    let mut table = IntervalTable::default();
    for (number, link) in (1..).zip(links) {
        table.on_linked(LinkNumber(number), link.clone());
    }
    table
}

#[test]
fn links_of_one_central_keep_the_default() {
    let mut table = table(&[link(1, true, 24), link(2, true, 24)]);
    assert_eq!(table.for_dial(device(3), units(24)), units(24));
    assert_eq!(table.next_action(), None);
}

#[test]
fn dial_avoids_the_intervals_of_other_clocks() {
    let table = table(&[link(1, false, 24), link(2, true, 25)]);
    assert_eq!(table.for_dial(device(3), units(24)), units(25));
}

#[test]
fn both_sides_agree_on_an_interval_that_suits_both() {
    assert_eq!(agreed(units(24), &[], &[units(25)]), units(24));
    assert_eq!(agreed(units(24), &[units(25)], &[units(24)]), units(23));
}

#[test]
fn lost_link_gets_another_interval() {
    let mut table = table(&[link(1, true, 24)]);
    table.on_lost(LinkNumber(1));
    table.on_ended(LinkNumber(1));
    assert_eq!(table.for_dial(device(1), units(24)), units(25));
    assert_eq!(table.for_dial(device(2), units(24)), units(24));
}

#[test]
fn number_of_counted_peers_is_bounded() {
    let mut table = IntervalTable::default();
    for peer in 0..=u8::MAX {
        table.on_linked(LinkNumber(1), link(peer, true, 24));
        table.on_lost(LinkNumber(1));
    }
    assert_eq!(table.losses.len(), MAX_PEERS);
}

#[test]
fn central_resolves_a_conflict_by_itself() {
    let mut table = table(&[link(1, true, 24), link(2, false, 24)]);
    assert_eq!(
        table.next_action(),
        Some(Action::Change(LinkNumber(1), units(25)))
    );
    assert_eq!(table.next_action(), None);
}

#[test]
fn peripheral_requests_another_interval_for_the_latest_link() {
    let mut table = table(&[link(1, false, 24), link(2, false, 24)]);
    let action = table.next_action();
    assert_eq!(action, Some(Action::Request(LinkNumber(2), units(25))));
    // The central announces its choice.
    assert_eq!(table.on_message(LinkNumber(2), units(23)), None);
    assert_eq!(table.all(), [units(24), units(23)]);
}

#[test]
fn central_grants_a_request_unless_it_conflicts() {
    let mut table = table(&[link(1, true, 24), link(2, false, 25)]);
    let changed = |interval| Some(Action::Change(LinkNumber(1), units(interval)));
    assert_eq!(table.on_message(LinkNumber(1), units(23)), changed(23));
    // 25 is taken here, and 23 was not good for the peer.
    assert_eq!(table.on_message(LinkNumber(1), units(25)), changed(26));
}

#[test]
fn number_of_changes_is_limited() {
    let mut table = table(&[link(1, true, 24)]);
    let changes = (0..100).filter_map(|_| table.on_message(LinkNumber(1), units(25)));
    assert_eq!(changes.count(), usize::from(MAX_CHANGES));
}

#[test]
fn interval_that_cannot_be_changed_is_left_alone() {
    let fixed = |peer, is_central| LinkInterval {
        peer_avoids: None,
        ..link(peer, is_central, 24)
    };
    let mut table = table(&[fixed(1, true), fixed(2, false)]);
    assert_eq!(table.next_action(), None);
    assert_eq!(table.on_message(LinkNumber(1), units(25)), None);
}

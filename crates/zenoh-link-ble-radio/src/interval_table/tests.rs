//! Tests the choice of connection intervals: `cargo test -p zenoh-link-ble-radio interval_table`
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
        can_change: true,
        is_unannounced: false,
        is_requested: false,
    }
}

fn table(links: &[LinkInterval]) -> IntervalTable<u64> {
    let mut table = IntervalTable::default();
    for (number, link) in (1..).zip(links) {
        table.links.insert(number, link.clone());
    }
    table
}

fn new_link(peer: u8, is_central: bool) -> NewLink {
    NewLink {
        device: device(peer),
        default: units(24),
        is_central,
        can_change: true,
    }
}

/// Returns a link of which this node is the central, and whose interval it cannot change while the link is open.
fn fixed_link(peer: u8) -> NewLink {
    NewLink {
        can_change: false,
        ..new_link(peer, true)
    }
}

/// Returns the interval with which the node dials a peer.
fn dialled(table: &IntervalTable<u64>, peer: u8) -> ConnectionInterval {
    let offered = table.for_dial(device(peer), units(24));
    offered.requested.expect("a dialler requests one")
}

#[test]
fn links_of_one_central_keep_the_default() {
    let mut table = table(&[link(1, true, 24), link(2, true, 24)]);
    assert_eq!(dialled(&table, 3), units(24));
    assert_eq!(table.next_action(), None);
}

#[test]
fn dial_avoids_the_intervals_of_other_clocks() {
    let table = table(&[link(1, false, 24), link(2, true, 25)]);
    assert_eq!(dialled(&table, 3), units(25));
}

#[test]
fn both_sides_agree_on_an_interval_that_suits_both() {
    assert_eq!(agreed(units(24), &[], &[units(25)]), units(24));
    assert_eq!(agreed(units(24), &[units(25)], &[units(24)]), units(23));
}

#[test]
fn handshake_leads_to_the_same_interval_on_both_sides() {
    let mut dialler = table(&[link(1, false, 25)]);
    let mut listener = table(&[link(2, true, 24), link(3, false, 23)]);
    let (new, default) = (9, units(24));
    let offered = Some(dialler.for_dial(device(5), default));
    let answered = listener.on_dialled(new, new_link(4, false), None, offered.clone());
    let interval = dialler.on_accepted(new, new_link(5, true), offered, Some(answered));
    assert_eq!(interval, units(26));
    assert_eq!(dialler.links[&new].interval, units(26));
    assert_eq!(listener.links[&new].interval, units(26));
}

#[test]
fn listener_chooses_if_it_is_the_central() {
    let mut dialler = table(&[link(1, true, 24)]);
    let mut listener = table(&[link(2, false, 25), link(3, true, 30)]);
    let (new, default) = (9, units(24));
    let offered = dialler.for_peripheral();
    let own = Some(listener.for_dial(device(4), default));
    let answered = listener.on_dialled(new, new_link(4, true), own, Some(offered.clone()));
    assert_eq!(answered.requested, Some(units(23)));
    let interval = dialler.on_accepted(new, new_link(5, false), Some(offered), Some(answered));
    assert_eq!(interval, units(23));
    assert_eq!(listener.links[&new].interval, units(23));
    assert!(dialler.next_action().is_none() && listener.next_action().is_none());
}

#[test]
fn link_without_a_choice_has_the_default() {
    let (mut dialler, mut listener) = (table(&[]), table(&[link(2, true, 24)]));
    let (new, default) = (9, units(24));
    let answered = listener.on_dialled(new, new_link(4, false), None, None);
    let interval = dialler.on_accepted(new, new_link(5, true), None, Some(answered));
    assert_eq!(interval, default);
    for table in [&mut dialler, &mut listener] {
        assert_eq!(table.links[&new].interval, default);
        assert_eq!(table.links[&new].peer_avoids, None);
    }
    // The listener changes the link of which it is the central only if that one's peer takes part.
    assert_eq!(listener.next_action(), Some(Action::Change(1, units(25))));
}

#[test]
fn lost_link_gets_another_interval() {
    let mut table = table(&[link(1, true, 24)]);
    table.on_lost(1);
    table.on_ended(1);
    assert_eq!(dialled(&table, 1), units(25));
    assert_eq!(dialled(&table, 2), units(24));
}

#[test]
fn number_of_counted_peers_is_bounded() {
    let mut table = IntervalTable::default();
    for peer in 0..=u8::MAX {
        table.links.insert(1, link(peer, true, 24));
        table.on_lost(1);
    }
    assert_eq!(table.losses.len(), MAX_PEERS);
}

#[test]
fn central_resolves_a_conflict_by_itself() {
    let mut table = table(&[link(1, true, 24), link(2, false, 24)]);
    assert_eq!(table.next_action(), Some(Action::Change(1, units(25))));
    assert_eq!(table.next_action(), None);
}

#[test]
fn peripheral_requests_another_interval_for_the_latest_link() {
    let mut table = table(&[link(1, false, 24), link(2, false, 24)]);
    let action = table.next_action();
    assert_eq!(action, Some(Action::Request(2, units(25))));
    // The central announces its choice.
    assert_eq!(table.on_message(2, units(23)), None);
    assert_eq!(table.all(), [units(24), units(23)]);
}

#[test]
fn central_grants_a_request_unless_it_conflicts() {
    let mut table = table(&[link(1, true, 24), link(2, false, 25)]);
    let changed = |interval| Some(Action::Change(1, units(interval)));
    assert_eq!(table.on_message(1, units(23)), changed(23));
    // 25 is taken here, and 23 was not good for the peer.
    assert_eq!(table.on_message(1, units(25)), changed(26));
}

#[test]
fn starved_link_gets_another_interval() {
    let mut table = table(&[link(1, true, 24), link(2, false, 25)]);
    let action = table.on_starved(1);
    assert_eq!(action, Some(Action::Change(1, units(23))));
    let action = table.on_starved(2);
    assert_eq!(action, Some(Action::Request(2, units(26))));
    assert_eq!(table.on_starved(3), None);
}

#[test]
fn number_of_changes_is_limited() {
    let mut table = table(&[link(1, true, 24)]);
    let changes = (0..100).filter_map(|_| table.on_message(1, units(25)));
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
    assert_eq!(table.on_message(1, units(25)), None);
}

#[test]
fn central_that_cannot_change_a_link_announces_the_interval_in_force() {
    let (mut dialler, mut listener) = (table(&[]), table(&[link(2, true, 24)]));
    let (new, default) = (9, units(24));
    let offered = Some(dialler.for_dial(device(5), default));
    let answered = listener.on_dialled(new, new_link(4, false), None, offered.clone());
    assert_eq!(listener.links[&new].interval, units(25), "as computed");
    let in_force = dialler.on_accepted(new, fixed_link(5), offered, Some(answered));
    assert_eq!(in_force, default);
    let announced = Some(Action::Announce(new, default));
    assert_eq!(dialler.next_action(), announced);
    assert_eq!(dialler.next_action(), None, "once");
    // The listener changes the link of which it is the central. If it could not, it would request another interval.
    assert_eq!(
        listener.on_message(new, default),
        Some(Action::Change(1, units(25)))
    );
    // The next dial requests what the two have computed, unless it conflicts by then.
    dialler.on_ended(new);
    assert_eq!(dialled(&dialler, 5), units(25));
    assert_eq!(dialled(&dialler, 6), default);
    dialler.links.insert(10, link(7, false, 25));
    assert_eq!(dialled(&dialler, 5), default);
}

#[test]
fn central_that_cannot_change_a_link_answers_a_request_with_the_interval_in_force() {
    let (mut central, mut peripheral) = (table(&[]), table(&[link(1, false, 24)]));
    let fixed = LinkInterval {
        can_change: false,
        ..link(2, true, 24)
    };
    central.links.insert(9, fixed);
    peripheral.links.insert(9, link(3, false, 24));
    let Some(Action::Request(9, requested)) = peripheral.next_action() else {
        panic!("the two links conflict");
    };
    let answer = central.on_message(9, requested);
    assert_eq!(answer, Some(Action::Announce(9, units(24))));
    assert_eq!(
        peripheral.on_message(9, units(24)),
        Some(Action::Request(1, units(25))),
        "the peripheral tries the other link, and not this one again"
    );
    assert_eq!(peripheral.on_starved(9), None);
    central.on_ended(9);
    assert_eq!(dialled(&central, 2), requested);
    // A link that the radio loses gets another interval.
    central.links.insert(9, link(2, true, 25));
    central.on_lost(9);
    central.on_ended(9);
    assert_eq!(dialled(&central, 2), units(25));
    assert!(central.preferred.is_empty());
}

#[test]
fn dialler_takes_the_interval_that_a_central_has_answered() {
    let mut dialler = table(&[link(1, true, 24)]);
    let offered = dialler.for_peripheral();
    let answered = Intervals {
        requested: Some(units(24)),
        avoid: vec![],
    };
    let link = new_link(5, false);
    let interval = dialler.on_accepted(9, link, Some(offered), Some(answered));
    assert_eq!(interval, units(24), "although another one would be better");
}

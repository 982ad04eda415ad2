//! Chooses the connection intervals of a node's links, so that links whose events come from different clocks do not
//! repeatedly need the radio at the same time. This is plain logic: the caller reports events and performs the actions.
//!
//! The central's clock determines when the events of a link take place; the dialler is the central. Links of which this
//! node is the central have one clock, and its controller places their events side by side: they may have equal intervals.
//! All other pairs of links of a node must have intervals that do not conflict ([`ConnectionInterval::conflicts_with`]).
//!
//! The dialler prefers the default interval of its radio. In the handshake, both sides exchange the intervals that the new
//! link must avoid, and both compute the same result ([`agreed`]). Handshakes with several peers at the same time may still
//! lead to a conflict. The node that has it then changes the interval of a link of which it is the central, or requests
//! another one from the central. A link that the radio has lost gets another interval when it is dialled again, because
//! the cause may be a device that does not report its intervals.
use std::collections::{BTreeMap, VecDeque};

use crate::{address::DeviceAddress, interval::ConnectionInterval, link::table::LinkNumber};

/// Largest number of peers whose lost links are counted.
const MAX_PEERS: usize = 64;
/// Largest number of changes of a link's interval by this node, so that two nodes cannot disagree forever.
const MAX_CHANGES: u8 = 8;

/// The intervals of a node's links.
#[derive(Debug, Default)]
pub struct IntervalTable {
    links: BTreeMap<LinkNumber, LinkInterval>,
    /// Number of lost links by peer. The peer with the latest loss is at the end.
    losses: VecDeque<(DeviceAddress, usize)>,
}

/// The interval of one link.
#[derive(Clone, Debug)]
pub struct LinkInterval {
    /// Address of the peer.
    pub device: DeviceAddress,
    /// Whether this node's clock determines the time of the link's events.
    pub is_central: bool,
    /// The interval.
    pub interval: ConnectionInterval,
    /// Intervals that the link must avoid for the peer's sake. `None` if the interval cannot be changed: the peer did not
    /// report them, or the central's radio does not permit it.
    pub peer_avoids: Option<Vec<ConnectionInterval>>,
    /// Number of changes by this node.
    pub changes: u8,
}

/// An action that the caller performs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Set the interval of a link of which this node is the central, and announce it to the peer.
    Change(LinkNumber, ConnectionInterval),
    /// Request another interval from the central of a link.
    Request(LinkNumber, ConnectionInterval),
}

/// Returns the interval of a new link. `requested` is the dialler's choice, `dialler_avoids` and `listener_avoids` are the
/// intervals that each side has reported.
pub fn agreed(
    requested: ConnectionInterval,
    dialler_avoids: &[ConnectionInterval],
    listener_avoids: &[ConnectionInterval],
) -> ConnectionInterval {
    if !listener_avoids
        .iter()
        .any(|other| requested.conflicts_with(*other))
    {
        return requested;
    }
    requested.choose(&[dialler_avoids, listener_avoids].concat(), 0)
}

impl IntervalTable {
    /// Returns the interval with which this node dials a peer. `default` is the default interval of the radio.
    pub fn for_dial(&self, peer: DeviceAddress, default: ConnectionInterval) -> ConnectionInterval {
        let losses = self.losses.iter().find(|(device, _)| *device == peer);
        default.choose(
            &self.of_other_clocks(),
            losses.map_or(0, |(_, count)| *count),
        )
    }

    /// Returns the intervals that a link must avoid of which this node is the central.
    pub fn of_other_clocks(&self) -> Vec<ConnectionInterval> {
        let links = self.links.values().filter(|link| !link.is_central);
        links.map(|link| link.interval).collect()
    }

    /// Returns the intervals of all links: a link must avoid them of which this node is not the central.
    pub fn all(&self) -> Vec<ConnectionInterval> {
        self.links.values().map(|link| link.interval).collect()
    }

    /// Adds a new link.
    pub fn on_linked(&mut self, number: LinkNumber, link: LinkInterval) {
        self.links.insert(number, link);
    }

    /// Removes a link that has ended.
    pub fn on_ended(&mut self, number: LinkNumber) {
        self.links.remove(&number);
    }

    /// Records that the radio has lost a link. The next link with that peer gets another interval.
    pub fn on_lost(&mut self, number: LinkNumber) {
        let Some(link) = self.links.get(&number) else {
            return;
        };
        let device = link.device;
        let at = self.losses.iter().position(|(other, _)| *other == device);
        let before = at.and_then(|at| self.losses.remove(at));
        if self.losses.len() == MAX_PEERS {
            self.losses.pop_front();
        }
        let count = before.map_or(0, |(_, count)| count);
        self.losses.push_back((device, count.saturating_add(1)));
    }

    /// Handles the message of a peer: the central has changed the interval, or the peer of this central requests another
    /// one. Returns the next action, if there is one.
    pub fn on_message(
        &mut self,
        number: LinkNumber,
        interval: ConnectionInterval,
    ) -> Option<Action> {
        let own = self.of_other_clocks();
        let link = self.links.get_mut(&number)?;
        if !link.is_central {
            link.interval = interval;
            return self.next_action();
        }
        let peer_avoids = link.peer_avoids.as_mut()?;
        if link.changes >= MAX_CHANGES {
            return None;
        }
        // The peer does not say why. It is most likely another link with the present interval.
        peer_avoids.push(link.interval);
        if peer_avoids.len() > usize::from(MAX_CHANGES) + crate::hello::MAX_INTERVALS {
            peer_avoids.remove(0);
        }
        link.interval = match own.iter().any(|other| interval.conflicts_with(*other)) {
            false => interval,
            true => interval.choose(&[&own[..], &peer_avoids[..]].concat(), 0),
        };
        link.changes += 1;
        Some(Action::Change(number, link.interval))
    }

    /// Returns the action that resolves a conflict between two links of this node, if there is one. The caller performs it.
    pub fn next_action(&mut self) -> Option<Action> {
        let conflicts = self.conflicts();
        let (number, _) = conflicts
            .iter()
            .flat_map(|(a, b)| [*b, *a])
            .filter_map(|number| Some((number, self.links.get(&number)?)))
            .filter(|(_, link)| link.peer_avoids.is_some() && link.changes < MAX_CHANGES)
            // A link of which this node is the central can be changed at once. Otherwise, the latest one gives way.
            .max_by_key(|(number, link)| (link.is_central, *number))?;
        let others = self.others(number);
        let link = self.links.get_mut(&number)?;
        let own: Vec<_> = others
            .into_iter()
            .filter(|(is_central, _)| !(*is_central && link.is_central))
            .map(|(_, interval)| interval)
            .collect();
        let peer_avoids = link.peer_avoids.as_deref().unwrap_or_default();
        let interval = link.interval.choose(&[&own[..], peer_avoids].concat(), 0);
        link.changes += 1;
        if link.is_central {
            link.interval = interval;
            return Some(Action::Change(number, interval));
        }
        Some(Action::Request(number, interval))
    }

    /// Returns the pairs of links that conflict, the earlier link of each pair first.
    fn conflicts(&self) -> Vec<(LinkNumber, LinkNumber)> {
        let mut conflicts = Vec::new();
        for (a, one) in &self.links {
            for (b, other) in self.links.range(..a) {
                let is_one_clock = one.is_central && other.is_central;
                if !is_one_clock && one.interval.conflicts_with(other.interval) {
                    conflicts.push((*b, *a));
                }
            }
        }
        conflicts
    }

    fn others(&self, number: LinkNumber) -> Vec<(bool, ConnectionInterval)> {
        let others = self.links.iter().filter(|(other, _)| **other != number);
        others
            .map(|(_, link)| (link.is_central, link.interval))
            .collect()
    }
}

#[cfg(test)]
mod tests;

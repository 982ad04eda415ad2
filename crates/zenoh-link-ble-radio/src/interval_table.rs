//! Chooses the connection intervals of a node's links, so that links whose events come from different clocks do not
//! repeatedly need the radio at the same time. This is plain logic: the caller reports events and performs the actions.
//!
//! The central's clock determines when the events of a link take place. The central is usually the dialler, or the listener
//! if both dialled at the same time and the BLE connection is the listener's. Links of which this
//! node is the central have one clock, and its controller places their events side by side: they may have equal intervals.
//! All other pairs of links of a node must have intervals that do not conflict ([`ConnectionInterval::conflicts_with`]).
//!
//! The central prefers the default interval of its radio. In the handshake, both sides exchange the intervals that the new
//! link must avoid, and both compute the same result. A central whose radio cannot change the interval of an open connection
//! announces the one in force, and requests the other one when it dials that peer again.
//!
//! Handshakes with several peers at the same time may still lead to a conflict. The node that has it then changes the interval of a link of which it is the central, or requests
//! another one from the central. A link that the radio neglects gets another interval at once, and one that it has lost when
//! it is dialled again, because the cause may be a device that does not report its intervals.
use std::collections::{BTreeMap, VecDeque};

use crate::{
    address::DeviceAddress,
    interval::{ConnectionInterval, SPREAD},
};

/// Largest number of peers whose lost links are counted, and with which a later link should have a certain interval.
const MAX_PEERS: usize = 64;
/// Largest number of changes of a link's interval by this node, so that two nodes cannot disagree forever.
const MAX_CHANGES: u8 = 8;
/// Largest number of intervals that a link avoids for the peer's sake: those of the handshake, and one for each change.
const MAX_PEER_AVOIDS: usize = 24 + MAX_CHANGES as usize;

/// The connection intervals that one side reports in a handshake.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Intervals {
    /// The interval that the central requests. The peripheral requests none.
    pub requested: Option<ConnectionInterval>,
    /// The intervals that the link must avoid because of other links of the sender.
    pub avoid: Vec<ConnectionInterval>,
}

/// The intervals of a node's links, which `K` identifies: a later link has a greater key.
#[derive(Debug)]
pub struct IntervalTable<K> {
    links: BTreeMap<K, LinkInterval>,
    /// Number of lost links by peer. The peer with the latest loss is at the end.
    losses: VecDeque<(DeviceAddress, usize)>,
    /// The intervals that the next link with a peer should have, because that of an open link could not be changed.
    preferred: VecDeque<(DeviceAddress, ConnectionInterval)>,
}

/// The interval of one link.
#[derive(Clone, Debug)]
struct LinkInterval {
    device: DeviceAddress,
    /// Whether this node's clock determines the time of the link's events.
    is_central: bool,
    interval: ConnectionInterval,
    /// Intervals that the link must avoid for the peer's sake. `None` if the interval cannot be changed: the peer did not
    /// report them, or the central's radio does not permit it.
    peer_avoids: Option<Vec<ConnectionInterval>>,
    /// Number of changes by this node.
    changes: u8,
    /// Whether this node, as the central, can change the interval of the open link.
    can_change: bool,
    /// Whether the interval in force differs from the one that the peer has computed, and has to be announced.
    is_unannounced: bool,
    /// Whether this node, as the peripheral, has requested another interval and has no answer yet.
    is_requested: bool,
}

impl LinkInterval {
    /// Returns whether this node can change the interval, or request another one.
    fn is_changeable(&self) -> bool {
        let can_change = self.can_change || !self.is_central;
        self.peer_avoids.is_some() && self.changes < MAX_CHANGES && can_change
    }
}

/// A link after its handshake.
#[derive(Clone, Copy, Debug)]
pub struct NewLink {
    /// Address of the peer.
    pub device: DeviceAddress,
    /// Default interval of this node's radio.
    pub default: ConnectionInterval,
    /// Whether this node's clock determines the time of the link's events.
    pub is_central: bool,
    /// Whether this node's radio can change the interval of an open connection.
    pub can_change: bool,
}

/// An action that the caller performs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action<K> {
    /// Set the interval of a link of which this node is the central, and announce it to the peer.
    Change(K, ConnectionInterval),
    /// Announce the interval of a link of which this node is the central, without a change.
    Announce(K, ConnectionInterval),
    /// Request another interval from the central of a link.
    Request(K, ConnectionInterval),
}

/// Returns the interval of a new link. `requested` is the central's choice, `central_avoids` and `peripheral_avoids` are the
/// intervals that each side has reported.
pub(crate) fn agreed(
    requested: ConnectionInterval,
    central_avoids: &[ConnectionInterval],
    peripheral_avoids: &[ConnectionInterval],
) -> ConnectionInterval {
    if !peripheral_avoids
        .iter()
        .any(|other| requested.conflicts_with(*other))
    {
        return requested;
    }
    requested.choose(&[central_avoids, peripheral_avoids].concat(), 0)
}

impl<K> Default for IntervalTable<K> {
    fn default() -> Self {
        Self {
            links: BTreeMap::new(),
            losses: VecDeque::new(),
            preferred: VecDeque::new(),
        }
    }
}

impl<K: Copy + Ord> IntervalTable<K> {
    /// Returns the intervals for the hello with which this node dials a peer. `default` is the default interval of the
    /// radio.
    pub fn for_dial(&self, peer: DeviceAddress, default: ConnectionInterval) -> Intervals {
        let losses = self.losses.iter().find(|(device, _)| *device == peer);
        let avoid = self.of_other_clocks();
        let preferred = self.preferred.iter().find(|(device, _)| *device == peer);
        let preferred = preferred.map(|(_, interval)| *interval).filter(|interval| {
            let is_near = interval.units().abs_diff(default.units()) <= SPREAD;
            is_near && !avoid.iter().any(|other| interval.conflicts_with(*other))
        });
        let skip = losses.map_or(0, |(_, count)| *count);
        Intervals {
            requested: Some(preferred.unwrap_or_else(|| default.choose(&avoid, skip))),
            avoid,
        }
    }

    /// Returns the intervals for the hello of a dialler that is not the central after all.
    pub fn for_peripheral(&self) -> Intervals {
        Intervals {
            requested: None,
            avoid: self.all(),
        }
    }

    /// Adds a link that a peer has dialled, and returns the intervals for the answer. `own` are the intervals of
    /// [`IntervalTable::for_dial`] if this node is the central and its radio permits the choice; `offered` are those in the
    /// peer's hello.
    pub fn on_dialled(
        &mut self,
        number: K,
        link: NewLink,
        own: Option<Intervals>,
        offered: Option<Intervals>,
    ) -> Intervals {
        if !link.is_central {
            let answer = self.for_peripheral();
            self.add(number, link, offered, Some(answer.clone()));
            return answer;
        }
        let avoid = self.of_other_clocks();
        let can_choose = own.as_ref().is_some_and(|own| own.requested.is_some());
        let interval = self.add(number, link, own, offered);
        if let Some(added) = self.links.get_mut(&number) {
            added.is_unannounced = false;
        }
        Intervals {
            requested: Some(interval).filter(|_| can_choose),
            avoid,
        }
    }

    /// Adds a link that this node has dialled, and returns its interval. `offered` are the intervals in this node's hello,
    /// and `answered` those of the peer's answer.
    pub fn on_accepted(
        &mut self,
        number: K,
        link: NewLink,
        offered: Option<Intervals>,
        answered: Option<Intervals>,
    ) -> ConnectionInterval {
        if link.is_central {
            return self.add(number, link, offered, answered);
        }
        // The central has considered this node's intervals before it answered, and has answered with the result.
        let [answered, offered] = [answered, offered].map(|side| {
            side.map(|side| Intervals {
                avoid: Vec::new(),
                ..side
            })
        });
        self.add(number, link, answered, offered)
    }

    /// Adds a link, and returns its interval: the same at both ends, unless this node has to announce it.
    fn add(
        &mut self,
        number: K,
        link: NewLink,
        central: Option<Intervals>,
        peripheral: Option<Intervals>,
    ) -> ConnectionInterval {
        let NewLink {
            device,
            default,
            is_central,
            can_change,
        } = link;
        let requested = central.as_ref().and_then(|central| central.requested);
        let avoids = [&central, &peripheral].map(|side| side.as_ref().map(|side| &side.avoid));
        let result = match (requested, avoids) {
            (Some(requested), [Some(central), Some(peripheral)]) => {
                agreed(requested, central, peripheral)
            }
            (requested, _) => requested.unwrap_or(default),
        };
        let interval = match requested {
            Some(requested) if is_central && !can_change => requested,
            _ => result,
        };
        if interval != result {
            replace(&mut self.preferred, device, result);
        }
        let peer = if is_central { peripheral } else { central };
        let link = LinkInterval {
            device,
            is_central,
            interval,
            peer_avoids: peer.filter(|_| requested.is_some()).map(|peer| peer.avoid),
            changes: 0,
            can_change,
            is_unannounced: interval != result,
            is_requested: false,
        };
        self.links.insert(number, link);
        interval
    }

    /// Returns the intervals that a link must avoid of which this node is the central.
    fn of_other_clocks(&self) -> Vec<ConnectionInterval> {
        let links = self.links.values().filter(|link| !link.is_central);
        links.map(|link| link.interval).collect()
    }

    /// Returns the intervals of all links: a link must avoid them of which this node is not the central.
    fn all(&self) -> Vec<ConnectionInterval> {
        self.links.values().map(|link| link.interval).collect()
    }

    /// Removes a link that has ended.
    pub fn on_ended(&mut self, number: K) {
        self.links.remove(&number);
    }

    /// Records that the radio has lost a link. The next link with that peer gets another interval.
    pub fn on_lost(&mut self, number: K) {
        let Some(link) = self.links.get(&number) else {
            return;
        };
        let device = link.device;
        self.preferred.retain(|(other, _)| *other != device);
        let before = self.losses.iter().find(|(other, _)| *other == device);
        let count = before.map_or(0, |(_, count)| *count);
        replace(&mut self.losses, device, count.saturating_add(1));
    }

    /// Records that the radio has sent nothing for a long time, although there was data to send: it may have served a link
    /// with a conflicting interval instead. Returns the action that gives the link another interval, if it can be changed.
    pub fn on_starved(&mut self, number: K) -> Option<Action<K>> {
        let current = self.links.get(&number)?.interval;
        self.change(number, Some(current))
    }

    /// Handles the message of a peer: the central has changed the interval, or the peer of this central requests another
    /// one. Returns the next action, if there is one.
    pub fn on_message(&mut self, number: K, interval: ConnectionInterval) -> Option<Action<K>> {
        let own = self.of_other_clocks();
        let link = self.links.get_mut(&number)?;
        if !link.is_central {
            // The central cannot change the interval, or has no better one.
            if link.is_requested && interval == link.interval {
                link.peer_avoids = None;
            }
            link.is_requested = false;
            link.interval = interval;
            return self.next_action();
        }
        let peer_avoids = link.peer_avoids.as_mut()?;
        if link.changes >= MAX_CHANGES {
            return None;
        }
        // The peer does not say why. It is most likely another link with the present interval.
        peer_avoids.push(link.interval);
        if peer_avoids.len() > MAX_PEER_AVOIDS {
            peer_avoids.remove(0);
        }
        let chosen = match own.iter().any(|other| interval.conflicts_with(*other)) {
            false => interval,
            true => interval.choose(&[&own[..], &peer_avoids[..]].concat(), 0),
        };
        link.changes += 1;
        if !link.can_change {
            replace(&mut self.preferred, link.device, chosen);
            return Some(Action::Announce(number, link.interval));
        }
        link.interval = chosen;
        Some(Action::Change(number, chosen))
    }

    /// Returns the next action: an interval that has to be announced, or one that resolves a conflict between two links of this
    /// node, if there is one. The caller performs it.
    pub fn next_action(&mut self) -> Option<Action<K>> {
        let unannounced = self.links.iter_mut().find(|(_, link)| link.is_unannounced);
        if let Some((number, link)) = unannounced {
            link.is_unannounced = false;
            return Some(Action::Announce(*number, link.interval));
        }
        let conflicts = self.conflicts();
        let (number, _) = conflicts
            .iter()
            .flat_map(|(a, b)| [*b, *a])
            .filter_map(|number| Some((number, self.links.get(&number)?)))
            .filter(|(_, link)| link.is_changeable())
            // A link of which this node is the central can be changed at once. Otherwise, the latest one gives way.
            .max_by_key(|(number, link)| (link.is_central, *number))?;
        self.change(number, None)
    }

    /// Chooses another interval for a link, which avoids those of the other links and `avoid`.
    fn change(&mut self, number: K, avoid: Option<ConnectionInterval>) -> Option<Action<K>> {
        let others = self.others(number);
        let link = self.links.get_mut(&number)?;
        let peer_avoids = link.peer_avoids.as_ref()?;
        if !link.is_changeable() {
            return None;
        }
        let own = others
            .into_iter()
            .filter(|(is_central, _)| !(*is_central && link.is_central))
            .map(|(_, interval)| interval);
        let avoid: Vec<_> = own
            .chain(peer_avoids.iter().copied())
            .chain(avoid)
            .collect();
        let interval = link.interval.choose(&avoid, 0);
        link.changes += 1;
        if link.is_central {
            link.interval = interval;
            return Some(Action::Change(number, interval));
        }
        link.is_requested = true;
        Some(Action::Request(number, interval))
    }

    /// Returns the pairs of links that conflict, the earlier link of each pair first.
    fn conflicts(&self) -> Vec<(K, K)> {
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

    fn others(&self, number: K) -> Vec<(bool, ConnectionInterval)> {
        let others = self.links.iter().filter(|(other, _)| **other != number);
        others
            .map(|(_, link)| (link.is_central, link.interval))
            .collect()
    }
}

/// Sets the value of a peer, which becomes the latest one. The number of peers is bounded.
fn replace<T>(values: &mut VecDeque<(DeviceAddress, T)>, device: DeviceAddress, value: T) {
    values.retain(|(other, _)| *other != device);
    if values.len() == MAX_PEERS {
        values.pop_front();
    }
    values.push_back((device, value));
}

#[cfg(test)]
mod tests;

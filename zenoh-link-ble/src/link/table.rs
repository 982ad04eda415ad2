//! Keeps the table of a node's links and dials, and ensures that a pair of nodes has one link. This is plain logic: the
//! caller reports events and acts on the answers.
//!
//! If the hellos of two nodes cross, the dial of the node with the lower id proceeds and the other one is refused. A
//! dial that has not sent its hello yet yields. A peer dials only if it has no link with this node, so a link that this
//! side still has with that peer is stale.
use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use link_lanes::hello::{Hello, NodeId, Refusal};
use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::address::DeviceAddress;

use crate::locator::Target;

pub use crate::link::number::LinkNumber;

/// Time after a successful dial during which a hello of the same peer counts as crossing it.
const CROSSING: Duration = Duration::from_secs(5);

/// A link that carries batches.
#[derive(Debug)]
struct EstablishedLink {
    node: Option<NodeId>,
    name: String,
    device: DeviceAddress,
    dialled_here: bool,
    since: Instant,
    end: CancellationToken,
}

/// A dial in progress.
#[derive(Debug)]
struct Dial {
    target: Target,
    device: Option<DeviceAddress>,
    /// Whether the peer may have received the hello of this dial.
    hello_sent: bool,
    cancel: CancellationToken,
}

/// The number of links and dials of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkCounts {
    /// Number of links that carry batches.
    pub links: usize,
    /// Number of dials in progress.
    pub dials: usize,
}

/// The decision about an incoming hello.
#[derive(Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Accept the link.
    Accept,
    /// Send this refusal.
    Refuse(Refusal),
}

/// The table of a node's links and dials.
#[derive(Debug)]
pub struct LinkTable {
    node: NodeId,
    next: u64,
    established: HashMap<LinkNumber, EstablishedLink>,
    dials: HashMap<LinkNumber, Dial>,
}

impl LinkTable {
    /// Creates an empty table for the node with that id.
    pub fn new(node: NodeId) -> Self {
        Self {
            node,
            next: 1,
            established: HashMap::new(),
            dials: HashMap::new(),
        }
    }

    /// Adds a dial to `target`, which is cancelled through `cancel`. Returns `None` if there is a link with that target or a
    /// dial to it already.
    pub fn on_dial(&mut self, target: &Target, cancel: CancellationToken) -> Option<LinkNumber> {
        let is_dialled = self.dials.values().any(|dial| dial.target == *target);
        if is_dialled || self.is_linked(target) {
            return None;
        }
        let number = self.next_number();
        let dial = Dial {
            target: target.clone(),
            device: None,
            hello_sent: false,
            cancel,
        };
        self.dials.insert(number, dial);
        Some(number)
    }

    /// Records the address under which the target of a dial was discovered.
    pub fn on_discovered(&mut self, dial: LinkNumber, device: DeviceAddress) {
        if let Some(dial) = self.dials.get_mut(&dial) {
            dial.device = Some(device);
        }
    }

    /// Records that a dial is about to send its hello. Returns `false` if it must not do so, because it has yielded to
    /// the dial of the peer.
    pub fn on_sending_hello(&mut self, dial: LinkNumber) -> bool {
        match self.dials.get_mut(&dial) {
            Some(dial) if !dial.cancel.is_cancelled() => {
                dial.hello_sent = true;
                true
            }
            _ => false,
        }
    }

    /// Cancels the dials to a device whose answer arrived on the wrong channel: they would wait in vain.
    pub fn on_misdirected(&mut self, device: DeviceAddress) {
        let is_to_device = |dial: &&Dial| dial.device == Some(device);
        (self.dials.values().filter(is_to_device)).for_each(|dial| dial.cancel.cancel());
    }

    /// Removes a dial that ended without a link.
    pub fn on_dial_ended(&mut self, dial: LinkNumber) {
        self.dials.remove(&dial);
    }

    /// Turns a dial into a link after the peer accepted it. `end` is cancelled if another link replaces this one.
    ///
    /// # Errors
    /// Fails if there is a link with that peer by now. The caller then closes the new channel.
    pub fn on_accepted(
        &mut self,
        dial: LinkNumber,
        peer: Option<&Hello>,
        device: DeviceAddress,
        now: Instant,
        end: CancellationToken,
    ) -> Result<(), Refusal> {
        self.dials.remove(&dial);
        let node = peer.map(|hello| hello.node);
        let is_duplicate = |link: &EstablishedLink| node.is_some() && link.node == node;
        if self.established.values().any(is_duplicate) {
            return Err(Refusal::AlreadyLinked);
        }
        let name = peer.map_or_else(String::new, |hello| hello.name.clone());
        self.replace_stale(node, &name, device);
        let link = EstablishedLink {
            node,
            name,
            device,
            dialled_here: true,
            since: now,
            end,
        };
        self.established.insert(dial, link);
        Ok(())
    }

    /// Decides about the hello of a peer that has dialled this node, and adds the link if it is accepted. `peer` is `None`
    /// for a plain peer, which is identified by its address. `end` is cancelled if another link replaces this one.
    pub fn on_hello(
        &mut self,
        own_name: &str,
        peer: Option<&Hello>,
        device: DeviceAddress,
        max_links: usize,
        now: Instant,
        end: CancellationToken,
    ) -> (Verdict, Option<LinkNumber>) {
        if let Some(refusal) = self.refusal(own_name, peer, device, max_links, now) {
            return (Verdict::Refuse(refusal), None);
        }
        let node = peer.map(|hello| hello.node);
        let name = peer.map_or_else(String::new, |hello| hello.name.clone());
        for dial in self.dials.values() {
            if dial.is_to(&name, device) {
                dial.cancel.cancel();
            }
        }
        self.replace_stale(node, &name, device);
        let number = self.next_number();
        let link = EstablishedLink {
            node,
            name,
            device,
            dialled_here: false,
            since: now,
            end,
        };
        self.established.insert(number, link);
        (Verdict::Accept, Some(number))
    }

    /// Removes a link that has ended.
    pub fn on_closed(&mut self, link: LinkNumber) {
        self.established.remove(&link);
    }

    /// Returns whether there is a link with that target.
    pub fn is_linked(&self, target: &Target) -> bool {
        self.established.values().any(|link| match target {
            Target::Address(address) => link.device.address == *address,
            Target::Name(name) => link.name == *name,
            Target::Fleet(_) => false,
        })
    }

    /// Returns whether there is a link with that device, or a dial to it.
    pub fn is_linked_or_dialled(&self, device: DeviceAddress) -> bool {
        let is_linked = self.established.values().any(|link| link.device == device);
        is_linked || self.dials.values().any(|dial| dial.device == Some(device))
    }

    /// Returns the number of links and dials.
    pub fn link_counts(&self) -> LinkCounts {
        LinkCounts {
            links: self.established.len(),
            dials: self.dials.len(),
        }
    }

    /// Returns how many links `max_links` still allows beside those that a new link with this peer would replace.
    pub fn free_places(
        &self,
        node: Option<NodeId>,
        device: DeviceAddress,
        max_links: usize,
    ) -> usize {
        let takes_place =
            |link: &&EstablishedLink| !link.dialled_here && !link.is_with(node, device);
        let taken = self.established.values().filter(takes_place).count();
        max_links.saturating_sub(taken)
    }

    /// Returns why an incoming hello is refused, if it is.
    fn refusal(
        &self,
        own_name: &str,
        peer: Option<&Hello>,
        device: DeviceAddress,
        max_links: usize,
        now: Instant,
    ) -> Option<Refusal> {
        if let Some(peer) = peer {
            let has_same_name = |link: &EstablishedLink| {
                link.name == peer.name && link.device != device && link.node != Some(peer.node)
            };
            let has_name = !peer.name.is_empty();
            if has_name && (peer.name == own_name || self.established.values().any(has_same_name)) {
                return Some(Refusal::NameTaken);
            }
            // A dial that has not sent its hello yields. It may have no channel yet and wait for a long time, because
            // the kernel does not notice that the BLE connection of the peer would serve it as well.
            let is_crossing = |dial: &Dial| dial.hello_sent && dial.is_to(&peer.name, device);
            if self.node < peer.node && self.dials.values().any(is_crossing) {
                return Some(Refusal::Crossing);
            }
            let was_crossed = |link: &EstablishedLink| {
                link.node == Some(peer.node)
                    && link.dialled_here
                    && now.saturating_duration_since(link.since) < CROSSING
            };
            if self.established.values().any(was_crossed) {
                return Some(Refusal::AlreadyLinked);
            }
        }
        let free = self.free_places(peer.map(|peer| peer.node), device, max_links);
        (free == 0).then_some(Refusal::Full)
    }

    /// Ends links with an earlier run of the same peer, and links that the peer has evidently lost.
    fn replace_stale(&mut self, node: Option<NodeId>, name: &str, device: DeviceAddress) {
        self.established.retain(|_, link| {
            let same_name = !name.is_empty() && link.name == name && link.device == device;
            let is_stale = same_name || link.is_with(node, device);
            if is_stale {
                link.end.cancel();
            }
            !is_stale
        });
    }

    fn next_number(&mut self) -> LinkNumber {
        let number = LinkNumber(self.next);
        self.next += 1;
        number
    }
}

impl EstablishedLink {
    /// Returns whether the link is with that node or, if both are plain peers, with that device.
    fn is_with(&self, node: Option<NodeId>, device: DeviceAddress) -> bool {
        match (self.node, node) {
            (Some(own), Some(other)) => own == other,
            (None, None) => self.device == device,
            _ => false,
        }
    }
}

impl Dial {
    fn is_to(&self, name: &str, device: DeviceAddress) -> bool {
        let by_target = match &self.target {
            Target::Name(target) => !name.is_empty() && target == name,
            Target::Address(address) => *address == device.address,
            Target::Fleet(_) => false,
        };
        by_target || self.device == Some(device)
    }
}

#[cfg(test)]
mod tests;

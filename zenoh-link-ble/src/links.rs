//! Owns who is linked with whom, and the one rule that keeps a pair of robots to one link. Plain logic: it is told
//! what happens and answers what to do; nothing here waits or sends.
//!
//! The rule: when the hellos of two nodes cross, the dial of the node with the lower id goes through and the
//! other is refused; a dial that has not said hello yet gives way. A node that dials has no link (it would not dial), so what this side still holds is stale.
use std::{
    collections::HashMap,
    time::{Duration, Instant},
};

use tokio_util::sync::CancellationToken;

use crate::{
    address::DeviceAddress,
    hello::{Hello, NodeId, Refusal},
    locator::Target,
    pause::{Pause, Pauses},
};

/// How long after this side's own dial went through a hello of the same peer still counts as crossing it.
const CROSSING: Duration = Duration::from_secs(5);

/// Names one link or dial of this process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkNumber(pub u64);

/// A link that carries batches.
#[derive(Debug)]
struct Established {
    node: Option<NodeId>,
    name: String,
    device: DeviceAddress,
    dialled_here: bool,
    since: Instant,
    end: CancellationToken,
}

/// A dial that has not become a link yet.
#[derive(Debug)]
struct Dial {
    target: Target,
    device: Option<DeviceAddress>,
    /// The peer may have its hello by now.
    said_hello: bool,
    cancel: CancellationToken,
}

/// How much is in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Census {
    /// Links that carry batches.
    pub links: usize,
    /// Dials that have not become a link yet.
    pub dials: usize,
}

/// What to do with an incoming hello.
#[derive(Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Make the link.
    Accept,
    /// Answer with this refusal.
    Refuse(Refusal),
}

/// The table of a node's links and dials.
#[derive(Debug)]
pub struct Links {
    node: NodeId,
    next: u64,
    established: HashMap<LinkNumber, Established>,
    dials: HashMap<LinkNumber, Dial>,
    pauses: Pauses,
}

impl Links {
    /// An empty table of that node.
    pub fn new(node: NodeId) -> Self {
        Self {
            node,
            next: 1,
            established: HashMap::new(),
            dials: HashMap::new(),
            pauses: Pauses::default(),
        }
    }

    /// Starts a dial, unless there is a link or a dial to that target.
    pub fn on_dial(&mut self, target: &Target, cancel: CancellationToken) -> Option<LinkNumber> {
        let dialling = self.dials.values().any(|dial| dial.target == *target);
        if dialling || self.is_linked(target) {
            return None;
        }
        let number = self.number();
        let dial = Dial {
            target: target.clone(),
            device: None,
            said_hello: false,
            cancel,
        };
        self.dials.insert(number, dial);
        Some(number)
    }

    /// The dial's target was seen under that address.
    pub fn on_seen(&mut self, dial: LinkNumber, device: DeviceAddress) {
        if let Some(dial) = self.dials.get_mut(&dial) {
            dial.device = Some(device);
        }
    }

    /// The dial is about to say hello; `false`: it has given way to the peer's own.
    pub fn on_hello_said(&mut self, dial: LinkNumber) -> bool {
        match self.dials.get_mut(&dial) {
            Some(dial) if !dial.cancel.is_cancelled() => {
                dial.said_hello = true;
                true
            }
            _ => false,
        }
    }

    /// What the peer sends does not arrive where it should: dials to it wait for nothing.
    pub fn on_astray(&mut self, device: DeviceAddress) {
        let to_it = |dial: &&Dial| dial.device == Some(device);
        (self.dials.values().filter(to_it)).for_each(|dial| dial.cancel.cancel());
    }

    /// The dial ended without a link.
    pub fn on_dial_ended(&mut self, dial: LinkNumber) {
        self.dials.remove(&dial);
    }

    /// The dialled peer accepted. `Err` if that peer has got a link meanwhile: close the new channel.
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
        let twice = |link: &Established| node.is_some() && link.node == node;
        if self.established.values().any(twice) {
            return Err(Refusal::AlreadyLinked);
        }
        let name = peer.map_or_else(String::new, |hello| hello.name.clone());
        self.replace_stale(node, &name, device);
        let link = Established {
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

    /// A peer that dialled this node said hello (`None`: a plain peer, known by its address only).
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
        let number = self.number();
        let link = Established {
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

    /// A link ended.
    pub fn on_closed(&mut self, link: LinkNumber) {
        self.established.remove(&link);
        self.pauses.on_ended(link);
    }

    /// A link is ready for Zenoh: what it has to wait for. Zenoh has it once that is [`Pause::Over`].
    pub fn on_ready(&mut self, link: LinkNumber, now: Instant) -> Pause {
        let pause = self.pauses.now(now);
        if pause == Pause::Over {
            self.pauses.on_given(link);
        }
        pause
    }

    /// Zenoh has a link, however long it should have waited.
    pub fn on_given(&mut self, link: LinkNumber) {
        self.pauses.on_given(link);
    }

    /// Zenoh let a link go.
    pub fn on_released(&mut self, link: LinkNumber, now: Instant) {
        self.pauses.on_released(link, now);
    }

    /// Whether there is a link to that target.
    pub fn is_linked(&self, target: &Target) -> bool {
        self.established.values().any(|link| match target {
            Target::Address(address) => link.device.address == *address,
            Target::Name(name) => link.name == *name,
            Target::Fleet(_) => false,
        })
    }

    /// Whether there is a link with that device, or a dial to it.
    pub fn knows(&self, device: DeviceAddress) -> bool {
        let is_linked = self.established.values().any(|link| link.device == device);
        is_linked || self.dials.values().any(|dial| dial.device == Some(device))
    }

    /// How many links and dials there are.
    pub fn census(&self) -> Census {
        Census {
            links: self.established.len(),
            dials: self.dials.len(),
        }
    }

    fn refusal(
        &self,
        own_name: &str,
        peer: Option<&Hello>,
        device: DeviceAddress,
        max_links: usize,
        now: Instant,
    ) -> Option<Refusal> {
        if let Some(peer) = peer {
            let name_clash = |link: &Established| {
                link.name == peer.name && link.device != device && link.node != Some(peer.node)
            };
            let named = !peer.name.is_empty();
            if named && (peer.name == own_name || self.established.values().any(name_clash)) {
                return Some(Refusal::NameTaken);
            }
            // A dial without a channel may wait for long: the kernel does not see that the peer's connection serves it, too.
            let crossing_dial = |dial: &Dial| dial.said_hello && dial.is_to(&peer.name, device);
            if self.node < peer.node && self.dials.values().any(crossing_dial) {
                return Some(Refusal::Crossing);
            }
            let crossed = |link: &Established| {
                link.node == Some(peer.node)
                    && link.dialled_here
                    && now.saturating_duration_since(link.since) < CROSSING
            };
            if self.established.values().any(crossed) {
                return Some(Refusal::AlreadyLinked);
            }
        }
        let taken = |link: &&Established| !link.is_of(peer.map(|p| p.node), device);
        let accepted = |link: &&Established| !link.dialled_here;
        let links = self.established.values().filter(taken).filter(accepted);
        (links.count() >= max_links).then_some(Refusal::Full)
    }

    /// Ends links to an earlier run of the same peer, or ones the peer has evidently lost.
    fn replace_stale(&mut self, node: Option<NodeId>, name: &str, device: DeviceAddress) {
        self.established.retain(|number, link| {
            let same_name = !name.is_empty() && link.name == name && link.device == device;
            let stale = same_name || link.is_of(node, device);
            if stale {
                link.end.cancel();
                self.pauses.on_ended(*number);
            }
            !stale
        });
    }

    fn number(&mut self) -> LinkNumber {
        let number = LinkNumber(self.next);
        self.next += 1;
        number
    }
}

impl Established {
    /// Whether it is with that node, or (plain peers) with that device.
    fn is_of(&self, node: Option<NodeId>, device: DeviceAddress) -> bool {
        match (self.node, node) {
            (Some(mine), Some(other)) => mine == other,
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

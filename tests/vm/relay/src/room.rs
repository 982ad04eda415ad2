//! What the relay does with each packet, without I/O: which links exist, how fast data goes, which faults are on.
//!
//! A controller sends one packet at a time; the packet arrives when its airtime at the set pace is over. The kernel
//! learns only then that the buffer is free, so its own flow control follows the pace. Other packets pass at once.

mod advertising;
mod controller;
mod links;
#[cfg(test)]
mod tests;
mod transmission;

use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use self::controller::Controller;
use crate::hci::{self, ControllerEvent, Handle, HostCommand, Role};

/// After a pause of the machine a sender may catch up on this much, so that the mean stays at the pace.
const CATCH_UP: Duration = Duration::from_millis(10);
/// btvirt counts a controller's handles from here and gives out the lowest free one.
const FIRST_HANDLE: Handle = 42;

/// One controller, for as long as it exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Id(pub u32);

/// What the shell has to send.
#[derive(Debug, PartialEq, Eq)]
pub enum Output {
    /// To the kernel.
    Host(Id, Vec<u8>),
    /// To the emulated controller.
    Controller(Id, Vec<u8>),
}

/// Buffers that the kernel is told of, instead of btvirt's one of 192 bytes. 0: leave the figure alone.
#[derive(Debug, Clone, Copy)]
pub struct Buffers {
    pub count: u8,
    pub acl_bytes: u16,
}

/// All controllers that hear each other.
#[derive(Debug)]
pub struct Room {
    controllers: BTreeMap<Id, Controller>,
    buffers: Buffers,
    outputs: VecDeque<Output>,
    /// Advertising reports on their way, with the time each is heard, in order.
    reports: VecDeque<(Instant, Id, Vec<u8>)>,
    next_id: u32,
}

impl Room {
    pub fn new(buffers: Buffers) -> Self {
        Self {
            controllers: BTreeMap::new(),
            buffers,
            outputs: VecDeque::new(),
            reports: VecDeque::new(),
            next_id: 0,
        }
    }

    pub fn add(&mut self, bytes_per_s: u32) -> Id {
        let id = Id(self.next_id);
        self.next_id += 1;
        self.controllers.insert(id, Controller::new(bytes_per_s));
        id
    }

    /// The controller is gone. Its peers hear no more of it, which btvirt does not tell them.
    pub fn remove(&mut self, id: Id) {
        self.forget_links(id);
        self.controllers.remove(&id);
    }

    pub fn set_pace(&mut self, id: Id, bytes_per_s: u32, now: Instant) {
        if let Some(controller) = self.controllers.get_mut(&id) {
            controller.bytes_per_s = bytes_per_s;
        }
        self.on_time(now);
    }

    /// Radio silence: nothing is heard of this controller and it hears nothing; nothing is lost either, as a radio
    /// repeats until the supervision timeout. That is `drop_links`, for whoever models it.
    pub fn freeze(&mut self, id: Id) {
        if let Some(controller) = self.controllers.get_mut(&id) {
            controller.frozen = true;
        }
    }

    pub fn thaw(&mut self, id: Id, now: Instant) {
        if let Some(controller) = self.controllers.get_mut(&id) {
            controller.frozen = false;
        }
        self.on_time(now);
    }

    /// All links of this controller end with a supervision timeout, at both ends. Returns how many there were.
    pub fn drop_links(&mut self, id: Id) -> usize {
        let Some(controller) = self.controllers.get_mut(&id) else {
            return 0;
        };
        for handle in controller.links.keys() {
            controller.disconnects.push_back(true);
            self.outputs.push_back(Output::Controller(
                id,
                hci::disconnect(*handle, hci::CONNECTION_TIMEOUT),
            ));
        }
        controller.links.len()
    }

    /// For people: links, data sent, faults.
    pub fn describe(&self, id: Id) -> String {
        let Some(c) = self.controllers.get(&id) else {
            return String::new();
        };
        let state = if c.frozen { "frozen" } else { "on the air" };
        format!(
            "{state}, {} links, {} bytes sent, pace {}",
            c.links.len(),
            c.sent_bytes,
            c.bytes_per_s
        )
    }

    /// The kernel sent this.
    pub fn on_host_packet(&mut self, id: Id, packet: Vec<u8>, now: Instant) {
        let Some(controller) = self.controllers.get_mut(&id) else {
            return;
        };
        if packet.first() == Some(&hci::ACL) {
            // The kernel sends for known links and no more than there are buffers, so this queue is bounded by it.
            controller.waiting.push_back(packet);
            self.on_time(now);
            return;
        }
        match hci::host_command(&packet) {
            HostCommand::Reset => {
                controller.disconnects.clear();
                self.forget_links(id);
            }
            HostCommand::Disconnect => controller.disconnects.push_back(false),
            HostCommand::SetRandomAddress(address) => controller.random_address = Some(address),
            HostCommand::SetAdvertisingInterval(interval) => {
                controller.advertising_interval = interval;
            }
            HostCommand::Other => {}
        }
        self.outputs.push_back(Output::Controller(id, packet));
    }

    /// The emulated controller sent this.
    pub fn on_controller_packet(&mut self, id: Id, mut packet: Vec<u8>, now: Instant) {
        if !self.controllers.contains_key(&id) {
            return;
        }
        let mut pass = true;
        match hci::controller_event(&packet) {
            ControllerEvent::OwnAddress(address) => {
                self.edit(id, |c| c.public_address = Some(address))
            }
            ControllerEvent::BufferSize => {
                hci::set_buffer_size(&mut packet, self.buffers.acl_bytes, self.buffers.count);
            }
            ControllerEvent::DisconnectStatus => {
                self.edit(id, |c| pass = c.disconnects.pop_front() != Some(true));
            }
            ControllerEvent::Connected { handle, role, peer } => {
                // btvirt tells the dialled end the dialler's handle, not its own; they differ once one has two links.
                let handle = match role {
                    Role::Central => handle,
                    Role::Peripheral => self.lowest_free_handle(id),
                };
                hci::set_connected_handle(&mut packet, handle);
                self.on_connected(id, handle, peer);
            }
            ControllerEvent::Disconnected { handle } => self.on_disconnected(id, handle),
            ControllerEvent::AdvertisingReport { from } => {
                pass = false;
                self.on_advertising_report(id, from, std::mem::take(&mut packet), now);
            }
            ControllerEvent::Other => {}
        }
        if pass {
            self.outputs.push_back(Output::Host(id, packet));
        }
        self.on_time(now);
    }

    /// Sends on what is due.
    pub fn on_time(&mut self, now: Instant) {
        self.hear_reports(now);
        let ids: Vec<Id> = self.controllers.keys().copied().collect();
        for id in ids {
            self.transmit_next(id, now);
            while self.deliver_due(id, now) {
                self.transmit_next(id, now);
            }
        }
    }

    /// When `on_time` has something to do again.
    pub fn deadline(&self) -> Option<Instant> {
        let speaking = self.controllers.values().filter(|c| !c.frozen);
        let data = speaking.filter_map(|c| c.on_air.as_ref().map(|t| t.ends));
        data.chain(self.reports.front().map(|(heard, ..)| *heard))
            .min()
    }

    pub fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    fn edit(&mut self, id: Id, change: impl FnOnce(&mut Controller)) {
        if let Some(controller) = self.controllers.get_mut(&id) {
            change(controller);
        }
    }
}

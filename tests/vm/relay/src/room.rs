//! Decides what happens to each packet, without I/O: keeps track of the links, the rate limits and the injected faults.
//!
//! A controller sends one packet at a time. The packet arrives when its airtime at the configured rate has elapsed.
//! Only then does the kernel learn that the buffer is free, so its own flow control follows the rate. Commands and
//! events are forwarded immediately, except advertising reports (`advertising.rs`).

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

/// Amount of time that a sender may catch up after a pause of the machine, so that the mean rate stays at the limit.
const CATCH_UP: Duration = Duration::from_millis(10);
/// First handle that btvirt assigns to a controller; it assigns the lowest free handle.
const FIRST_HANDLE: Handle = 42;

/// Identifies a controller while it exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Id(pub u32);

/// Packets to be sent.
#[derive(Debug, PartialEq, Eq)]
pub enum Output {
    /// To the kernel.
    Host(Id, Vec<u8>),
    /// To the emulated controller.
    Controller(Id, Vec<u8>),
}

/// Buffers that are reported to the kernel, instead of btvirt's one buffer of 192 bytes. 0 keeps the value of btvirt.
#[derive(Debug, Clone, Copy)]
pub struct Buffers {
    pub count: u8,
    pub acl_bytes: u16,
}

/// Controllers in range of each other.
#[derive(Debug)]
pub struct Room {
    controllers: BTreeMap<Id, Controller>,
    buffers: Buffers,
    outputs: VecDeque<Output>,
    /// Advertising reports in flight with the times of their delivery, in order.
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

    /// Removes a controller. Its peers receive supervision timeouts, because btvirt does not report the loss.
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

    /// Silences the radio of a controller: it neither sends nor receives. No data is lost, because a radio retransmits
    /// until the supervision timeout; use `drop_links` to model the timeout.
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

    /// Ends all links of this controller with a supervision timeout at both ends. Returns their number.
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

    /// Returns a readable description: links, bytes sent, faults.
    pub fn describe(&self, id: Id) -> String {
        let Some(c) = self.controllers.get(&id) else {
            return String::new();
        };
        let state = if c.frozen { "frozen" } else { "on the air" };
        let intervals: Vec<_> = c
            .links
            .values()
            .map(|link| link.interval.to_string())
            .collect();
        format!(
            "{state}, {} links with intervals [{}], {} bytes sent, pace {}",
            c.links.len(),
            intervals.join(" "),
            c.sent_bytes,
            c.bytes_per_s
        )
    }

    /// Handles a packet of the kernel.
    pub fn on_host_packet(&mut self, id: Id, packet: Vec<u8>, now: Instant) {
        let Some(controller) = self.controllers.get_mut(&id) else {
            return;
        };
        if packet.first() == Some(&hci::ACL) {
            // The kernel sends only on known links and only as many packets as there are buffers, which bounds this
            // queue.
            controller.waiting.push_back(packet);
            self.on_time(now);
            return;
        }
        match hci::host_command(&packet) {
            HostCommand::Reset => {
                controller.disconnects.clear();
                controller.updates.clear();
                self.forget_links(id);
            }
            HostCommand::Disconnect => controller.disconnects.push_back(false),
            HostCommand::UpdateConnection { handle, interval } => {
                controller.updates.push_back((handle, interval));
            }
            HostCommand::SetRandomAddress(address) => controller.random_address = Some(address),
            HostCommand::SetAdvertisingInterval(interval) => {
                controller.advertising_interval = interval;
            }
            HostCommand::Other => {}
        }
        self.outputs.push_back(Output::Controller(id, packet));
    }

    /// Handles a packet of the emulated controller.
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
            ControllerEvent::UpdateConnectionStatus => {
                // btvirt accepts the command and does not report its completion.
                self.outputs
                    .push_back(Output::Host(id, std::mem::take(&mut packet)));
                pass = false;
                self.complete_update(id);
            }
            ControllerEvent::DisconnectStatus => {
                self.edit(id, |c| pass = c.disconnects.pop_front() != Some(true));
            }
            ControllerEvent::Connected {
                handle,
                role,
                peer,
                interval,
            } => {
                // btvirt reports the dialler's handle to the dialled end. The handles differ as soon as one end has two
                // links.
                let handle = match role {
                    Role::Central => handle,
                    Role::Peripheral => self.lowest_free_handle(id),
                };
                hci::set_connected_handle(&mut packet, handle);
                self.on_connected(id, handle, peer);
                self.set_interval(id, handle, interval);
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

    /// Delivers everything that is due.
    pub fn on_time(&mut self, now: Instant) {
        self.deliver_reports(now);
        let ids: Vec<Id> = self.controllers.keys().copied().collect();
        for id in ids {
            self.transmit_next(id, now);
            while self.deliver_due(id, now) {
                self.transmit_next(id, now);
            }
        }
    }

    /// Returns the next time at which `on_time` must be called.
    pub fn deadline(&self) -> Option<Instant> {
        let active = self.controllers.values().filter(|c| !c.frozen);
        let data = active.filter_map(|c| c.on_air.as_ref().map(|t| t.ends));
        data.chain(self.reports.front().map(|(delivery, ..)| *delivery))
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

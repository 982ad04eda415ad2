//! What the relay does with each packet, without I/O: which links exist, how fast data goes, which faults are on.
//!
//! A controller sends one packet at a time; the packet arrives when its airtime at the set pace is over. The kernel
//! learns only then that the buffer is free, so its own flow control follows the pace. Other packets pass at once.

use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use crate::hci::{self, Address, ControllerEvent, Handle, HostCommand, Role};

/// After a pause of the machine a sender may catch up on this much, so that the mean stays at the pace.
const CATCH_UP: Duration = Duration::from_millis(10);
/// btvirt counts a controller's handles from here and gives out the lowest free one.
const FIRST_HANDLE: Handle = 42;

/// A real controller hears an advertiser at the next advertising event, btvirt's within microseconds of the command to
/// scan: before the kernel takes reports at all, and, as the controller filters repetitions, never again.
const ADVERTISING_DELAY: Duration = Duration::from_millis(50);

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

#[derive(Debug)]
struct Link {
    peer: Address,
    /// Known when both ends have reported the connection.
    other_end: Option<(Id, Handle)>,
}

#[derive(Debug)]
struct Transmission {
    packet: Vec<u8>,
    ends: Instant,
}

#[derive(Debug, Default)]
struct Controller {
    public_address: Option<Address>,
    random_address: Option<Address>,
    links: BTreeMap<Handle, Link>,
    waiting: VecDeque<Vec<u8>>,
    bytes_per_s: u32,
    on_air: Option<Transmission>,
    frozen: bool,
    /// One entry per Disconnect command under way: whether the relay sent it, and not the kernel.
    disconnects: VecDeque<bool>,
    sent_bytes: u64,
}

impl Controller {
    fn is_at(&self, address: &Address) -> bool {
        self.public_address.as_ref() == Some(address)
            || self.random_address.as_ref() == Some(address)
    }

    fn airtime(&self, packet: &[u8]) -> Duration {
        match self.bytes_per_s {
            0 => Duration::ZERO,
            rate => Duration::from_secs_f64(
                (packet.len() - hci::ACL_HEADER_BYTES) as f64 / f64::from(rate),
            ),
        }
    }
}

/// All controllers that hear each other.
#[derive(Debug)]
pub struct Room {
    controllers: BTreeMap<Id, Controller>,
    buffers: Buffers,
    outputs: VecDeque<Output>,
    /// Advertising reports on their way, with the time each is heard: in order, as the delay is the same for all.
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
        self.controllers.insert(
            id,
            Controller {
                bytes_per_s,
                ..Controller::default()
            },
        );
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
                if !self
                    .controllers
                    .iter()
                    .any(|(i, c)| c.frozen && (*i == id || c.is_at(&from)))
                {
                    self.reports.push_back((
                        now + ADVERTISING_DELAY,
                        id,
                        std::mem::take(&mut packet),
                    ));
                }
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
        while self
            .reports
            .front()
            .is_some_and(|(heard, ..)| *heard <= now)
        {
            let Some((_, id, report)) = self.reports.pop_front() else {
                break;
            };
            if self.controllers.contains_key(&id) {
                self.outputs.push_back(Output::Host(id, report));
            }
        }
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

    fn lowest_free_handle(&self, id: Id) -> Handle {
        let Some(controller) = self.controllers.get(&id) else {
            return FIRST_HANDLE;
        };
        (FIRST_HANDLE..)
            .find(|handle| !controller.links.contains_key(handle))
            .unwrap_or(FIRST_HANDLE)
    }

    /// The controller has no links any more and has told nobody: its peers wait out their supervision timeout.
    fn forget_links(&mut self, id: Id) {
        let handles: Vec<Handle> = self
            .controllers
            .get(&id)
            .into_iter()
            .flat_map(|c| c.links.keys().copied())
            .collect();
        for handle in handles {
            let other_end = self
                .controllers
                .get(&id)
                .and_then(|c| c.links.get(&handle))
                .and_then(|l| l.other_end);
            self.on_disconnected(id, handle);
            if let Some((other, other_handle)) = other_end {
                self.on_disconnected(other, other_handle);
                let event = hci::disconnection_complete(other_handle, hci::CONNECTION_TIMEOUT);
                self.outputs.push_back(Output::Host(other, event));
            }
        }
    }

    fn on_connected(&mut self, id: Id, handle: Handle, peer: Address) {
        let other_end = self
            .controllers
            .iter()
            .filter(|(i, c)| **i != id && c.is_at(&peer))
            .find_map(|(i, c)| {
                let mine = self.controllers.get(&id)?;
                c.links
                    .iter()
                    .find(|(_, link)| link.other_end.is_none() && mine.is_at(&link.peer))
                    .map(|(other_handle, _)| (*i, *other_handle))
            });
        self.edit(id, |c| {
            c.links.insert(handle, Link { peer, other_end });
        });
        if let Some((other, other_handle)) = other_end {
            self.edit(other, |c| {
                if let Some(link) = c.links.get_mut(&other_handle) {
                    link.other_end = Some((id, handle));
                }
            });
        }
    }

    fn on_disconnected(&mut self, id: Id, handle: Handle) {
        let mut other_end = None;
        self.edit(id, |c| {
            other_end = c.links.remove(&handle).and_then(|link| link.other_end);
            c.waiting
                .retain(|packet| hci::acl_handle(packet) != Some(handle));
            c.on_air
                .take_if(|t| hci::acl_handle(&t.packet) == Some(handle));
        });
        if let Some((other, other_handle)) = other_end {
            self.edit(other, |c| {
                if let Some(link) = c.links.get_mut(&other_handle) {
                    link.other_end = None;
                }
            });
        }
    }

    /// Where this packet goes, if its link is up and neither end is frozen.
    fn destination(&self, id: Id, packet: &[u8]) -> Option<(Handle, Id, Handle)> {
        let controller = self.controllers.get(&id).filter(|c| !c.frozen)?;
        let handle = hci::acl_handle(packet)?;
        let (to, to_handle) = controller.links.get(&handle)?.other_end?;
        self.controllers.get(&to).filter(|c| !c.frozen)?;
        Some((handle, to, to_handle))
    }

    /// Puts the first packet that can go on the air, unless one is there. A link that is silent does not hold up others.
    fn transmit_next(&mut self, id: Id, from: Instant) {
        let Some(controller) = self.controllers.get(&id).filter(|c| c.on_air.is_none()) else {
            return;
        };
        let Some(index) = controller
            .waiting
            .iter()
            .position(|p| self.destination(id, p).is_some())
        else {
            return;
        };
        self.edit(id, |c| {
            c.on_air = c.waiting.remove(index).map(|packet| Transmission {
                ends: from + c.airtime(&packet),
                packet,
            });
        });
    }

    /// Ends the transmission that is due; whether there was one.
    fn deliver_due(&mut self, id: Id, now: Instant) -> bool {
        let Some(controller) = self.controllers.get_mut(&id).filter(|c| !c.frozen) else {
            return false;
        };
        let Some(Transmission { packet, ends }) = controller.on_air.take_if(|t| t.ends <= now)
        else {
            return false;
        };
        let Some((handle, to, to_handle)) = self.destination(id, &packet) else {
            // The peer fell silent meanwhile: it will be repeated.
            self.edit(id, |c| c.waiting.push_front(packet));
            return true;
        };
        self.edit(id, |c| {
            c.sent_bytes += (packet.len() - hci::ACL_HEADER_BYTES) as u64
        });
        self.outputs
            .push_back(Output::Host(to, hci::acl_for_peer(packet, to_handle)));
        self.outputs
            .push_back(Output::Host(id, hci::one_packet_completed(handle)));
        let late_at_most = now.checked_sub(CATCH_UP).unwrap_or(now);
        self.transmit_next(id, ends.max(late_at_most));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BUFFERS: Buffers = Buffers {
        count: 8,
        acl_bytes: 251,
    };

    fn address(n: u8) -> Address {
        [n, 0, 0, 0, 0, 0]
    }

    fn own_address(n: u8) -> Vec<u8> {
        [&[hci::EVENT, 0x0e, 10, 1, 0x09, 0x10, 0][..], &address(n)].concat()
    }

    fn connected(handle: u8, role: u8, peer: u8) -> Vec<u8> {
        [
            &[hci::EVENT, 0x3e, 19, 1, 0, handle, 0, role, 0][..],
            &address(peer),
            &[0; 7],
        ]
        .concat()
    }

    fn disconnected(handle: u8) -> Vec<u8> {
        vec![hci::EVENT, 0x05, 4, 0, handle, 0, 0x13]
    }

    fn acl(handle: u8, payload: usize) -> Vec<u8> {
        let [low, high] = (payload as u16).to_le_bytes();
        [&[hci::ACL, handle, 0, low, high][..], &vec![7; payload]].concat()
    }

    struct Bed {
        room: Room,
        ids: Vec<Id>,
        now: Instant,
    }

    impl Bed {
        fn new(controllers: u8, bytes_per_s: u32) -> Self {
            let mut room = Room::new(BUFFERS);
            let now = Instant::now();
            let ids: Vec<Id> = (0..controllers).map(|_| room.add(bytes_per_s)).collect();
            for (n, id) in ids.iter().enumerate() {
                room.on_controller_packet(*id, own_address(n as u8), now);
            }
            Self { room, ids, now }
        }

        /// a, under whose handle btvirt reports the link to both ends, has dialled b.
        fn connect(&mut self, (a, handle): (usize, u8), b: usize) {
            self.room
                .on_controller_packet(self.ids[b], connected(handle, 1, a as u8), self.now);
            self.room
                .on_controller_packet(self.ids[a], connected(handle, 0, b as u8), self.now);
            self.outputs();
        }

        fn send(&mut self, from: usize, packet: Vec<u8>) {
            self.room.on_host_packet(self.ids[from], packet, self.now);
        }

        fn outputs(&mut self) -> Vec<Output> {
            std::iter::from_fn(|| self.room.poll_output()).collect()
        }

        /// The payload bytes that arrive at each controller until nothing is left to wait for.
        fn run(&mut self) -> BTreeMap<(Id, Handle), usize> {
            let mut arrived = BTreeMap::new();
            loop {
                for output in self.outputs() {
                    if let Output::Host(id, packet) = output {
                        if let Some(handle) = hci::acl_handle(&packet) {
                            *arrived.entry((id, handle)).or_default() +=
                                packet.len() - hci::ACL_HEADER_BYTES;
                        }
                    }
                }
                let Some(deadline) = self.room.deadline() else {
                    return arrived;
                };
                self.now = self.now.max(deadline);
                self.room.on_time(self.now);
            }
        }
    }

    #[test]
    fn data_arrives_at_the_set_pace() {
        let mut bed = Bed::new(2, 34_000);
        bed.connect((0, 42), 1);
        let start = bed.now;
        for _ in 0..100 {
            bed.send(0, acl(42, 251));
        }
        assert_eq!(bed.run(), BTreeMap::from([((bed.ids[1], 42), 25_100)]));
        let expected = Duration::from_secs_f64(25_100.0 / 34_000.0);
        assert!(
            (bed.now - start).abs_diff(expected) < Duration::from_millis(1),
            "{:?}",
            bed.now - start
        );
    }

    #[test]
    fn a_packet_after_a_pause_takes_its_whole_airtime() {
        let mut bed = Bed::new(2, 1000);
        bed.connect((0, 42), 1);
        bed.now += Duration::from_secs(5);
        bed.send(0, acl(42, 100));
        assert_eq!(
            bed.room.deadline(),
            Some(bed.now + Duration::from_millis(100))
        );
    }

    #[test]
    fn a_late_timer_does_not_lower_the_pace() {
        let mut bed = Bed::new(2, 100_000);
        bed.connect((0, 42), 1);
        let start = bed.now;
        for _ in 0..100 {
            bed.send(0, acl(42, 250));
        }
        while let Some(deadline) = bed.room.deadline() {
            bed.now = bed.now.max(deadline) + Duration::from_millis(3);
            bed.room.on_time(bed.now);
        }
        assert!(
            bed.now - start < Duration::from_millis(256),
            "{:?}",
            bed.now - start
        );
    }

    #[test]
    fn the_links_of_a_hub_are_kept_apart_though_the_handles_at_its_ends_differ() {
        let mut bed = Bed::new(4, 0);
        for robot in 1..4 {
            bed.connect((0, 41 + robot as u8), robot);
        }
        for robot in 1..4 {
            bed.send(0, acl(41 + robot as u8, 10 * robot));
            bed.send(robot, acl(42, robot));
        }
        let expected = (1..4).flat_map(|robot| {
            [
                ((bed.ids[robot], 42), 10 * robot),
                ((bed.ids[0], 41 + robot as Handle), robot),
            ]
        });
        let expected = expected.collect();
        assert_eq!(bed.run(), expected);
    }

    #[test]
    fn the_kernel_learns_of_a_free_buffer_when_the_packet_has_left() {
        let mut bed = Bed::new(2, 1000);
        bed.connect((0, 42), 1);
        bed.send(0, acl(42, 1));
        assert_eq!(bed.outputs(), []);
        bed.now += Duration::from_millis(1);
        bed.room.on_time(bed.now);
        let completed = vec![hci::EVENT, 0x13, 5, 1, 42, 0, 1, 0];
        let arrived = vec![hci::ACL, 42, 0x20, 1, 0, 7];
        assert_eq!(
            bed.outputs(),
            [
                Output::Host(bed.ids[1], arrived),
                Output::Host(bed.ids[0], completed)
            ]
        );
    }

    #[test]
    fn a_frozen_controller_is_silent_and_loses_nothing() {
        let mut bed = Bed::new(3, 1000);
        bed.connect((0, 42), 1);
        bed.connect((0, 43), 2);
        bed.send(0, acl(42, 100));
        bed.room.freeze(bed.ids[1]);
        bed.send(1, acl(42, 50));
        bed.send(0, acl(43, 20));
        assert_eq!(
            bed.run(),
            BTreeMap::from([((bed.ids[2], 42), 20)]),
            "the other link goes on"
        );
        bed.room.thaw(bed.ids[1], bed.now);
        assert_eq!(
            bed.run(),
            BTreeMap::from([((bed.ids[1], 42), 100), ((bed.ids[0], 42), 50)])
        );
    }

    #[test]
    fn a_frozen_controller_s_advertising_is_not_heard() {
        let mut bed = Bed::new(2, 0);
        bed.outputs();
        let report = [
            &[hci::EVENT, 0x3e, 12, 2, 1, 0, 0][..],
            &address(1),
            &[0, 0],
        ]
        .concat();
        bed.room.freeze(bed.ids[1]);
        bed.room
            .on_controller_packet(bed.ids[0], report.clone(), bed.now);
        assert_eq!(bed.outputs(), []);
        bed.room.thaw(bed.ids[1], bed.now);
        bed.room
            .on_controller_packet(bed.ids[0], report.clone(), bed.now);
        assert_eq!(
            bed.outputs(),
            [],
            "an advertisement is heard at its next interval"
        );
        bed.room.on_time(bed.now + ADVERTISING_DELAY);
        assert_eq!(bed.outputs(), [Output::Host(bed.ids[0], report)]);
    }

    #[test]
    fn dropped_links_end_with_a_supervision_timeout_and_the_kernel_sees_no_answer_to_a_command_it_did_not_send(
    ) {
        let mut bed = Bed::new(2, 0);
        bed.connect((0, 42), 1);
        bed.send(0, vec![hci::COMMAND, 0x06, 0x04, 3, 99, 0, 0x13]);
        bed.outputs();
        assert_eq!(bed.room.drop_links(bed.ids[0]), 1);
        assert_eq!(
            bed.outputs(),
            [Output::Controller(
                bed.ids[0],
                vec![hci::COMMAND, 0x06, 0x04, 3, 42, 0, 0x08]
            )]
        );
        let status = vec![hci::EVENT, 0x0f, 4, 0, 1, 0x06, 0x04];
        bed.room
            .on_controller_packet(bed.ids[0], status.clone(), bed.now);
        assert_eq!(
            bed.outputs(),
            [Output::Host(bed.ids[0], status.clone())],
            "the kernel's own"
        );
        bed.room.on_controller_packet(bed.ids[0], status, bed.now);
        assert_eq!(bed.outputs(), [], "the relay's");
    }

    #[test]
    fn what_waits_for_a_lost_link_is_dropped() {
        let mut bed = Bed::new(2, 1000);
        bed.connect((0, 42), 1);
        bed.send(0, acl(42, 100));
        bed.send(0, acl(42, 100));
        bed.room
            .on_controller_packet(bed.ids[0], disconnected(42), bed.now);
        assert_eq!(bed.run(), BTreeMap::new());
        assert_eq!(bed.room.deadline(), None);
    }

    #[test]
    fn data_sent_before_the_peer_has_reported_the_link_waits_for_it() {
        let mut bed = Bed::new(2, 0);
        bed.room
            .on_controller_packet(bed.ids[0], connected(42, 0, 1), bed.now);
        bed.send(0, acl(42, 5));
        assert_eq!(bed.run(), BTreeMap::new());
        bed.room
            .on_controller_packet(bed.ids[1], connected(42, 1, 0), bed.now);
        assert_eq!(bed.run(), BTreeMap::from([((bed.ids[1], 42), 5)]));
    }

    #[test]
    fn a_controller_that_is_pulled_out_takes_nobody_with_it() {
        let mut bed = Bed::new(3, 1000);
        bed.connect((0, 42), 1);
        bed.connect((0, 43), 2);
        bed.send(0, acl(42, 100));
        bed.room.remove(bed.ids[1]);
        bed.send(0, acl(43, 20));
        assert_eq!(bed.run(), BTreeMap::from([((bed.ids[2], 42), 20)]));
    }

    #[test]
    fn the_dialled_end_gets_its_own_handle_and_not_the_dialler_s() {
        let mut bed = Bed::new(3, 0);
        bed.connect((0, 42), 1);
        bed.room
            .on_controller_packet(bed.ids[2], connected(43, 1, 0), bed.now);
        assert!(bed
            .outputs()
            .contains(&Output::Host(bed.ids[2], connected(42, 1, 0))));
    }

    #[test]
    fn the_peers_of_a_controller_that_is_reset_see_a_supervision_timeout() {
        let mut bed = Bed::new(2, 0);
        bed.connect((0, 42), 1);
        bed.send(0, hci::RESET.to_vec());
        let lost = vec![hci::EVENT, 0x05, 4, 0, 42, 0, 0x08];
        let expected = [
            Output::Host(bed.ids[1], lost),
            Output::Controller(bed.ids[0], hci::RESET.to_vec()),
        ];
        assert_eq!(bed.outputs(), expected);
    }
}

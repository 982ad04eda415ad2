//! Builds a network of robots on an air without traffic, counts the links that are lost, and opens them again.
use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};
use zenoh_link_ble_radio::{
    advertisement::Advertisement,
    interval::ConnectionInterval,
    interval_table::{IntervalTable, NewLink},
};

use super::{psm, request, Air, AirOptions, ChannelId, Event};

use crate::{id::AdapterId, message::Command};

/// Time between two polls while all links are up.
const STEP: Duration = Duration::from_secs(1);

/// How the robots of a network choose the intervals of their links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Intervals {
    /// All links have the default interval.
    Equal,
    /// The robots choose as in a handshake.
    Chosen,
}

/// A network of which every link is kept open.
pub(super) struct Network {
    pub(super) air: Air,
    intervals: Intervals,
    tables: Vec<IntervalTable<usize>>,
    /// Central and peripheral of each link.
    links: Vec<(usize, usize)>,
    channels: BTreeMap<ChannelId, usize>,
    now: Duration,
    last_request: u32,
    /// Time of each loss.
    pub(super) dropped_at: Vec<Duration>,
}

impl Network {
    /// Returns a network with these links, of which each is given by its central and its peripheral.
    pub(super) fn new(options: AirOptions, links: &[(usize, usize)], intervals: Intervals) -> Self {
        let robots = 1 + links.iter().map(|(a, b)| *a.max(b)).max().unwrap_or(0);
        let mut air = Air::new(options);
        for robot in 0..robots {
            let id = air.attach(&format!("sim-{robot}"), Duration::ZERO);
            let id = id.expect("attaches");
            let listen = Command::Listen {
                request: request(1),
                psm: Some(psm()),
                recv_mtu: 2000,
            };
            air.command(id, listen, Duration::ZERO).expect("listens");
        }
        let mut network = Self {
            air,
            intervals,
            tables: (0..robots).map(|_| IntervalTable::default()).collect(),
            links: links.to_vec(),
            channels: BTreeMap::new(),
            now: Duration::ZERO,
            last_request: 1,
            dropped_at: Vec::new(),
        };
        network.open_missing();
        network
    }

    /// Lets time pass, and opens lost links again.
    pub(super) fn run(&mut self, until: Duration) {
        while self.now < until {
            self.now = (self.now + STEP).min(until);
            self.air.poll(self.now);
            for timed in self.air.drain() {
                if let Event::Closed { channel } = timed.event {
                    self.on_closed(channel, timed.at);
                }
            }
            self.open_missing();
        }
    }

    /// Returns how often a link was lost.
    pub(super) fn drops(&self) -> usize {
        self.dropped_at.len()
    }

    /// Returns the number of different intervals.
    pub(super) fn interval_count(&self) -> usize {
        let intervals = self.air.connections.values().map(|c| c.interval);
        intervals.collect::<BTreeSet<_>>().len()
    }

    /// Returns the time for which no event was received, for the link for which it is the longest.
    pub(super) fn longest_silence(&self) -> Duration {
        let connections = self.air.connections.values();
        let sides = connections.flat_map(|connection| &connection.sides);
        let received = sides.filter_map(|side| side.last_received);
        received
            .map(|at| self.now.saturating_sub(at))
            .max()
            .unwrap_or_default()
    }

    fn open_missing(&mut self) {
        for (index, (central, peripheral)) in self.links.clone().into_iter().enumerate() {
            while !self.channels.values().any(|open| *open == index) {
                if self.intervals == Intervals::Chosen {
                    self.choose_interval(index, central, peripheral);
                }
                self.open(index, adapter(central), adapter(peripheral));
            }
        }
    }

    /// Chooses the interval of a link as the handshake of two nodes does.
    fn choose_interval(&mut self, index: usize, central: usize, peripheral: usize) {
        let device = |robot: usize| self.air.adapters[&adapter(robot)].address;
        let devices = [device(central), device(peripheral)];
        let default = ConnectionInterval::nearest(self.air.options.interval);
        let link = |device, is_central| NewLink {
            device,
            default,
            is_central,
            can_change: true,
        };
        let offered = Some(self.tables[central].for_dial(devices[1], default));
        let listener = &mut self.tables[peripheral];
        let answered = listener.on_dialled(index, link(devices[0], false), None, offered.clone());
        let dialler = &mut self.tables[central];
        let interval = dialler.on_accepted(index, link(devices[1], true), offered, Some(answered));
        let (peer, units) = (devices[1], interval.units());
        self.command(adapter(central), Command::SetInterval { peer, units });
    }

    /// Counts a lost link, whose loss both sides report.
    fn on_closed(&mut self, channel: ChannelId, at: Duration) {
        let Some(index) = self.channels.remove(&channel) else {
            return;
        };
        self.dropped_at.push(at);
        let (central, peripheral) = self.links[index];
        for robot in [central, peripheral] {
            self.tables[robot].on_lost(index);
            self.tables[robot].on_ended(index);
        }
    }

    /// Opens a link. A failed attempt leaves the network as it was.
    fn open(&mut self, index: usize, central: AdapterId, peripheral: AdapterId) {
        self.last_request += 2;
        let (advertised, dialled) = (request(self.last_request), request(self.last_request + 1));
        let advertise = Command::Advertise {
            request: advertised,
            advertisement: Advertisement {
                psm: psm(),
                plain: false,
                name_hash: 0,
                fleet_hash: 0,
                incarnation: 0,
            },
            name: "robot".to_owned(),
        };
        let connect = Command::Connect {
            request: dialled,
            peer: self.air.adapters[&peripheral].address,
            psm: psm(),
            recv_mtu: 2000,
        };
        let cancel = Command::CancelConnect { request: dialled };
        let stop = Command::StopAdvertising {
            request: advertised,
        };
        self.command(peripheral, advertise);
        self.command(central, connect);
        let limit = self.now + 3 * STEP;
        let mut is_pending = true;
        while is_pending && self.now < limit {
            self.now = self.air.next_wakeup().unwrap_or(limit).min(limit);
            self.air.poll(self.now);
            for timed in self.air.drain() {
                match timed.event {
                    Event::Connected {
                        request, channel, ..
                    } if request == dialled => {
                        self.channels.insert(channel, index);
                        is_pending = false;
                    }
                    Event::ConnectFailed { request, .. } if request == dialled => {
                        is_pending = false
                    }
                    Event::Closed { channel } => self.on_closed(channel, timed.at),
                    _ => {}
                }
            }
        }
        self.command(central, cancel);
        self.command(peripheral, stop);
    }

    fn command(&mut self, adapter: AdapterId, command: Command) {
        let accepted = self.air.command(adapter, command, self.now);
        accepted.expect("a valid command");
    }
}

fn adapter(robot: usize) -> AdapterId {
    AdapterId(1 + u32::try_from(robot).expect("few"))
}

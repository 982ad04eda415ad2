//! Tests of the relay logic, packet by packet, with simulated time.
use super::*;
use crate::hci::Address;

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

/// A room whose controllers have the addresses 0, 1, ..., and a simulated clock.
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

    /// Connects `a` to `b`. btvirt reports the link to both ends under the handle of `a`.
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

    /// Runs until nothing is pending. Returns the payload bytes that arrived at each controller.
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
fn delivers_data_at_the_rate_limit() {
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
fn packet_after_a_pause_takes_its_full_airtime() {
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
fn late_timer_does_not_lower_the_rate() {
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
fn keeps_links_of_a_hub_separate_if_handles_differ() {
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
fn reports_a_free_buffer_after_the_transmission() {
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
fn frozen_controller_is_silent_and_loses_no_data() {
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
        "the other link is not affected"
    );
    bed.room.thaw(bed.ids[1], bed.now);
    assert_eq!(
        bed.run(),
        BTreeMap::from([((bed.ids[1], 42), 100), ((bed.ids[0], 42), 50)])
    );
}

#[test]
fn drops_advertising_reports_of_a_frozen_controller() {
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
        "an advertisement is received at its next interval"
    );
    bed.room.on_time(bed.now + Duration::from_millis(639));
    assert_eq!(bed.outputs(), []);
    bed.room.on_time(bed.now + Duration::from_millis(640));
    assert_eq!(bed.outputs(), [Output::Host(bed.ids[0], report)]);
}

#[test]
fn dropped_links_end_with_a_supervision_timeout() {
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
fn drops_queued_data_of_a_lost_link() {
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
fn queues_data_until_both_ends_reported_the_link() {
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
fn removing_a_controller_does_not_affect_others() {
    let mut bed = Bed::new(3, 1000);
    bed.connect((0, 42), 1);
    bed.connect((0, 43), 2);
    bed.send(0, acl(42, 100));
    bed.room.remove(bed.ids[1]);
    bed.send(0, acl(43, 20));
    assert_eq!(bed.run(), BTreeMap::from([((bed.ids[2], 42), 20)]));
}

#[test]
fn reports_the_dialled_ends_own_handle() {
    let mut bed = Bed::new(3, 0);
    bed.connect((0, 42), 1);
    bed.room
        .on_controller_packet(bed.ids[2], connected(43, 1, 0), bed.now);
    assert!(bed
        .outputs()
        .contains(&Output::Host(bed.ids[2], connected(42, 1, 0))));
}

#[test]
fn reset_ends_links_with_a_supervision_timeout_at_the_peers() {
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

#[test]
fn shorter_advertising_interval_is_reported_sooner() {
    let mut bed = Bed::new(3, 0);
    bed.outputs();
    let report = |n| {
        [
            &[hci::EVENT, 0x3e, 12, 2, 1, 0, 0][..],
            &address(n),
            &[0, 0],
        ]
        .concat()
    };
    // 160 and 240 units of 0.625 ms.
    bed.send(2, vec![hci::COMMAND, 0x06, 0x20, 4, 160, 0, 240, 0]);
    bed.outputs();
    for n in [1, 2] {
        bed.room
            .on_controller_packet(bed.ids[0], report(n), bed.now);
    }
    bed.room.on_time(bed.now + Duration::from_millis(75));
    assert_eq!(bed.outputs(), [Output::Host(bed.ids[0], report(2))]);
    bed.room.on_time(bed.now + Duration::from_millis(640));
    assert_eq!(bed.outputs(), [Output::Host(bed.ids[0], report(1))]);
}

#[test]
fn connection_update_completes_at_both_ends() {
    let mut bed = Bed::new(2, 0);
    bed.connect((0, 42), 1);
    let update = vec![
        hci::COMMAND,
        0x13,
        0x20,
        14,
        42,
        0,
        13,
        0,
        13,
        0,
        0,
        0,
        200,
        0,
        0,
        0,
        0,
        0,
    ];
    bed.send(0, update);
    bed.outputs();
    let status = vec![hci::EVENT, 0x0f, 4, 0, 1, 0x13, 0x20];
    bed.room
        .on_controller_packet(bed.ids[0], status.clone(), bed.now);
    let complete = hci::update_complete(42, 13);
    let expected = [
        Output::Host(bed.ids[0], status),
        Output::Host(bed.ids[1], complete.clone()),
        Output::Host(bed.ids[0], complete),
    ];
    assert_eq!(bed.outputs(), expected);
    assert!(bed
        .room
        .describe(bed.ids[1])
        .contains("1 links with intervals [13]"));
}

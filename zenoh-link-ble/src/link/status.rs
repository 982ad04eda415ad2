//! Defines what a node reports about its links and their lanes.
use std::time::{Duration, Instant};

use link_lanes::{
    lanes::{report::Count, Lane, Lanes},
    usage::UsageReport,
};
use serde::Serialize;

use crate::{discovered::DiscoveredStatus, link::history::PeerStatus, refusals::RefusedStatus};

/// The `ble` links of one Zenoh runtime.
#[derive(Clone, Debug, Serialize)]
pub struct NodeStatus {
    /// The name with which the node listens; empty if it does not listen.
    pub name: String,
    /// Open links.
    pub links: Vec<LinkStatus>,
    /// History of the peers that were linked or dialled.
    pub peers: Vec<PeerStatus>,
    /// Peers that have asked for a link within the last minute and got none.
    pub refused: Vec<RefusedStatus>,
    /// Nodes whose advertisements were received within the last minute. A node scans only while it dials, and while it
    /// searches for another robot with its name.
    pub discovered: Vec<DiscoveredStatus>,
}

/// An open link.
#[derive(Clone, Debug, Serialize)]
pub struct LinkStatus {
    /// Number that identifies the link within the process.
    pub link: u64,
    /// Name of the peer, or its address if it has no name.
    pub peer: String,
    /// Bluetooth address of the peer.
    pub address: String,
    /// Name of the local adapter.
    pub adapter: String,
    /// Largest batch, in bytes.
    pub mtu: u16,
    /// Whether the link is encrypted: with the secret of both sides, or by Bluetooth because they are paired.
    pub encrypted: bool,
    /// Time since the link was opened, in seconds.
    pub up_s: f64,
    /// Batches that were sent.
    pub sent: Count,
    /// Batches that were received.
    pub received: Count,
    /// State of the lanes. A link with a plain peer has none.
    pub lanes: Option<LanesStatus>,
}

/// The bytes that a link has sent, by key.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkUsage {
    /// Name of the peer, or its address if it has no name.
    pub peer: String,
    /// The bytes that were counted.
    pub report: UsageReport,
    /// Rate of the path while there is enough to send, per second in the unit of the costs in the report, once it was measured.
    pub rate_per_s: Option<f64>,
}

/// The lanes of a link, and the path to the peer that they share.
#[derive(Clone, Debug, Serialize)]
pub struct LanesStatus {
    /// Rate of the path while there is enough to send, in bytes per second, once it was measured.
    pub rate_bytes_per_s: Option<f64>,
    /// Moving average of the time from an SDU to its acknowledgement, in milliseconds, once it was measured.
    pub round_trip_ms: Option<f64>,
    /// Number of bytes that were sent and not acknowledged yet.
    pub in_flight_bytes: u16,
    /// Current limit of the bytes in flight.
    pub in_flight_limit_bytes: u16,
    /// Number of bytes that may wait on a lane before it accepts another message that must arrive.
    pub backlog_limit_bytes: usize,
    /// The lanes that were used, the most urgent first.
    pub lanes: Vec<LaneStatus>,
}

/// A lane of a link, in both directions.
#[derive(Clone, Debug, Serialize)]
pub struct LaneStatus {
    /// Name of Zenoh's priority, such as `Data`.
    pub priority: String,
    /// Batches that were sent.
    pub sent: Count,
    /// Batches that wait to be sent. Here, `bytes` is the memory that they occupy.
    pub waiting: Count,
    /// Number of bytes of these batches, without framing.
    pub unsent_bytes: u64,
    /// Number of waiting bytes that count towards `backlog_limit_bytes`: those of messages that are not large.
    pub backlog_bytes: u64,
    /// How long the oldest waiting batch has waited, in milliseconds; `None` if none waits.
    pub oldest_ms: Option<f64>,
    /// Moving average of the time from the queueing of a batch to its acknowledgement, in milliseconds; `None` until it was
    /// measured.
    pub delay_ms: Option<f64>,
    /// Number of batches that were withdrawn because Zenoh abandoned their message.
    pub abandoned: u64,
    /// Whether the peer has stopped the lane.
    pub is_stopped: bool,
    /// Batches that were received.
    pub received: Count,
    /// Number of received bytes that Zenoh has not read yet, with 24 more for each batch.
    pub unread_bytes: usize,
}

impl LanesStatus {
    /// Returns the current state of the lanes, and the totals of what was sent and received.
    pub(crate) fn of(lanes: &Lanes, now: Instant) -> (Self, Count, Count) {
        let (mut sent, mut received) = (Count::default(), Count::default());
        let mut used = Vec::new();
        for lane in Lane::all() {
            let (out, into) = lanes.lane_report(lane, now);
            sent = sent + out.sent;
            received = received + into.received;
            if out.sent + out.waiting + into.received == Count::default() {
                continue;
            }
            used.push(LaneStatus {
                priority: lane.priority(),
                sent: out.sent,
                waiting: out.waiting,
                unsent_bytes: out.unsent_bytes,
                backlog_bytes: out.backlog_bytes,
                oldest_ms: out.oldest.map(milliseconds),
                delay_ms: out.delay.map(milliseconds),
                abandoned: out.abandoned_sdus,
                is_stopped: out.is_stopped,
                received: into.received,
                unread_bytes: into.unread_bytes,
            });
        }
        let (in_flight_bytes, in_flight_limit_bytes) = lanes.in_flight();
        let status = Self {
            rate_bytes_per_s: lanes.path().rate_bytes_per_s(),
            round_trip_ms: lanes.path().round_trip().map(milliseconds),
            in_flight_bytes,
            in_flight_limit_bytes,
            backlog_limit_bytes: lanes.backlog_limit_bytes(),
            lanes: used,
        };
        (status, sent, received)
    }
}

fn milliseconds(duration: Duration) -> f64 {
    1000.0 * duration.as_secs_f64()
}

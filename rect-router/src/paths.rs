//! Describes the paths and lanes of `any` links for the registry and the admin space.
use link_lanes::lanes::report::Count;
use rect_core::registry::connection::{
    LinkLane, LinkPath, LinkPathState, PathSwitch, SwitchReason, Traffic,
};
use serde::Serialize;
use zenoh_link_any::{
    multipath::SwitchReason as Reason,
    path::{Medium, PathState},
    status::{self, LinkStatus},
};

/// A link, as the admin space reports it.
#[derive(Serialize)]
pub struct LinkDocument {
    /// The peer.
    peer: String,
    /// How long the link has been open, in seconds.
    up_s: f64,
    /// Whether all its paths are encrypted.
    is_encrypted: bool,
    /// The batches sent.
    sent: Traffic,
    /// The batches received.
    received: Traffic,
    paths: Vec<LinkPath>,
    lanes: Vec<LinkLane>,
    /// How often the path that carries the bulk was replaced.
    switches: u64,
    last_switch: Option<PathSwitch>,
}

/// Returns all links of the process.
pub fn links() -> Vec<LinkDocument> {
    let document = |link: &LinkStatus| LinkDocument {
        peer: link.peer.clone(),
        up_s: link.up.as_secs_f64(),
        is_encrypted: link.is_encrypted,
        sent: traffic(link.sent),
        received: traffic(link.received),
        paths: paths_of(link),
        lanes: lanes_of(link),
        switches: link.switches,
        last_switch: last_switch_of(link),
    };
    status::links().iter().map(document).collect()
}

/// Describes the paths of a link.
pub fn paths_of(link: &LinkStatus) -> Vec<LinkPath> {
    let paths = link.paths.iter().map(|path| LinkPath {
        method: method(path.medium).to_owned(),
        state: match path.state {
            PathState::Untried => LinkPathState::Untried,
            PathState::Live => LinkPathState::Live,
            PathState::Suspected => LinkPathState::Suspected,
        },
        is_primary: path.is_primary,
        round_trip_ms: path.round_trip.map(|time| time.as_secs_f64() * 1000.0),
        bytes_per_s: path.rate_bytes_per_s,
        sent_bytes: path.sent_bytes,
        resent_bytes: path.resent_bytes,
    });
    paths.collect()
}

/// Describes the lanes of a link.
pub fn lanes_of(link: &LinkStatus) -> Vec<LinkLane> {
    let lanes = link.lanes.iter().map(|(lane, report)| LinkLane {
        priority: lane.priority(),
        waiting_bytes: report.waiting_bytes,
        delay_ms: report.delay.map(|delay| delay.as_secs_f64() * 1000.0),
        dropped_batches: report.abandoned_batches,
    });
    lanes.collect()
}

/// Describes the last change of the path that carries the bulk of a link.
pub fn last_switch_of(link: &LinkStatus) -> Option<PathSwitch> {
    link.last_switch.map(|switch| PathSwitch {
        previous: method(switch.previous).to_owned(),
        path: method(switch.current).to_owned(),
        reason: match switch.reason {
            Reason::Ended => SwitchReason::Ended,
            Reason::Silent => SwitchReason::Silent,
            Reason::Faster => SwitchReason::Faster,
        },
        gap_ms: switch.gap.as_secs_f64() * 1000.0,
        ago_s: switch.at.elapsed().as_secs_f64(),
    })
}

/// Describes what a link has carried.
pub fn traffic(count: Count) -> Traffic {
    Traffic {
        batches: Some(count.sdus),
        bytes: count.bytes,
    }
}

/// Returns the method of the paths over a medium.
pub fn method(medium: Medium) -> &'static str {
    match medium {
        Medium::Bluetooth => "ble",
        Medium::Network => "tcp",
    }
}

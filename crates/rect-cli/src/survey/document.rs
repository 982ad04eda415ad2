//! Defines the JSON file of a survey: surveys/survey.schema.json.
use std::time::SystemTime;

use rect::{Connection, Name};
use rect_core::text::humanize::milliseconds;
use rect_terminal::clock;
use rect_terminal::Cell;
use serde::Serialize;

use super::{computer::Computer, label::Label};
use crate::measure::{goodput::Goodput, round_trip::RoundTrips};

/// The version of the file. It changes when a reader of the last version would misunderstand it.
const VERSION: u32 = 1;
/// The shares of requests for which the round trip is stored.
const SHARES: [f64; 13] = [
    0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0,
];

/// The results of a survey.
#[derive(Debug, Serialize)]
pub struct Survey {
    format: &'static str,
    version: u32,
    /// When it was made, in local time.
    date: String,
    rect_version: &'static str,
    /// Results that are not as expected, in words.
    pub deviations: Vec<String>,
    robots: [SurveyedRobot; 2],
    pub link: Link,
    pub places: Vec<Place>,
    pub reconnections: Vec<Reconnection>,
    pub switches: Vec<Switch>,
    pub soak: Option<Soak>,
}

#[derive(Debug, Serialize)]
struct SurveyedRobot {
    name: Name,
    computer: Computer,
}

/// The link of the two robots.
#[derive(Debug, Serialize)]
pub struct Link {
    pub method: String,
    encrypted: Option<bool>,
    paths: Vec<String>,
    /// The largest batch that the Bluetooth link accepts, in bytes, if the router tells it.
    batch_bytes: Option<u64>,
}

/// How soon the other robot is discovered.
#[derive(Debug, Default, Serialize)]
pub struct Discovery {
    /// Each time from the begin of a scan to the first advertisement of the other robot.
    pub seconds: Vec<f64>,
    /// Median of the strength of these advertisements.
    pub signal_dbm: Option<i16>,
    /// Why it was not measured, or not completely.
    pub error: Option<String>,
}

/// How the link was lost and came back.
#[derive(Debug, Serialize)]
pub struct Reconnection {
    /// Time until the loss was noticed, in seconds.
    pub noticed_s: f64,
    /// Time from the return of the radio until the robots reached each other: discovery, link, and Zenoh's handshake.
    pub reachable_s: f64,
}

/// The measurements at one place.
#[derive(Debug, Serialize)]
pub struct Place {
    pub label: Label,
    pub distance_m: Option<f64>,
    pub behind_body: bool,
    /// Not over Wi-Fi.
    pub discovery: Option<Discovery>,
    /// The path that carries the load: `ble` or `tcp`.
    pub path: Option<String>,
    /// Urgent requests, while nothing else is sent.
    pub round_trip: Option<RoundTripSummary>,
    /// Urgent requests beside a load.
    pub round_trip_under_load: Option<RoundTripSummary>,
    /// Loads to the other robot.
    pub sent: Vec<Goodput>,
    /// Loads from the other robot.
    pub received: Vec<Goodput>,
    /// The radio that has such a goodput in theory, for a place that is near.
    pub resembles: Option<&'static str>,
    /// Why nothing was measured.
    pub error: Option<String>,
}

/// The round trips of many requests.
#[derive(Debug, Serialize)]
pub struct RoundTripSummary {
    pub replies: usize,
    pub lost: usize,
    /// Pairs of a share of the requests, and the time in milliseconds that they did not exceed.
    pub curve: Vec<(f64, f64)>,
}

/// A switch to another path.
#[derive(Debug, Default, Serialize)]
pub struct Switch {
    /// The path afterwards: `ble` or `tcp`.
    pub path: String,
    pub reason: String,
    /// How long data had waited for an acknowledgement when the other path took it over, in milliseconds.
    pub gap_ms: f64,
    pub longest_round_trip_ms: Option<f64>,
    pub sent: u64,
    pub lost: u64,
}

/// The round trips over a long time.
#[derive(Debug, Serialize)]
pub struct Soak {
    pub seconds: f64,
    pub round_trip: RoundTripSummary,
}

impl Survey {
    pub fn new(robots: [(Name, Computer); 2], link: Link) -> Self {
        Self {
            format: "rect-survey",
            version: VERSION,
            date: clock::file_name(SystemTime::now()),
            rect_version: env!("CARGO_PKG_VERSION"),
            deviations: Vec::new(),
            robots: robots.map(|(name, computer)| SurveyedRobot { name, computer }),
            link,
            places: Vec::new(),
            reconnections: Vec::new(),
            switches: Vec::new(),
            soak: None,
        }
    }
}

impl Link {
    pub fn of(connection: &Connection, batch_bytes: Option<u64>) -> Self {
        let paths = connection.paths.iter().flatten();
        Self {
            method: connection.method.clone(),
            encrypted: connection.encrypted,
            paths: paths.map(|path| path.method.clone()).collect(),
            batch_bytes,
        }
    }
}

impl Place {
    pub fn new(label: &Label) -> Self {
        Self {
            label: label.clone(),
            distance_m: label.distance_m,
            behind_body: label.behind_body,
            discovery: None,
            path: None,
            round_trip: None,
            round_trip_under_load: None,
            sent: Vec::new(),
            received: Vec::new(),
            resembles: None,
            error: None,
        }
    }

    pub fn failed(label: &Label, error: &str) -> Self {
        Self {
            error: Some(error.to_owned()),
            ..Self::new(label)
        }
    }

    /// Returns the signal strength, if it was measured.
    pub fn signal_dbm(&self) -> Option<i16> {
        self.discovery.as_ref()?.signal_dbm
    }

    /// Returns the number of lost messages and requests.
    pub fn lost(&self) -> u64 {
        let loads = self.sent.iter().chain(&self.received);
        let requests = self.round_trip.iter().chain(&self.round_trip_under_load);
        loads.map(|load| load.lost).sum::<u64>()
            + requests.map(|requests| requests.lost as u64).sum::<u64>()
    }

    /// Returns the line of a table: place, signal, round trip idle and under load, best goodput in both directions, losses.
    pub fn cells(&self) -> Vec<Cell> {
        let or_dash = |text: Option<String>| text.unwrap_or_else(|| "-".to_owned());
        let p50 = |one: &Option<RoundTripSummary>| {
            or_dash(
                one.as_ref()
                    .and_then(|one| one.quantile_ms(0.5))
                    .map(milliseconds),
            )
        };
        let best = |loads: &[Goodput]| {
            let best = loads.iter().map(|load| load.kb_per_s).reduce(f64::max);
            or_dash(best.map(|best| format!("{best:.1} kB/s")))
        };
        let cells = [
            self.label.to_string(),
            or_dash(self.signal_dbm().map(|dbm| format!("{dbm} dBm"))),
            p50(&self.round_trip),
            p50(&self.round_trip_under_load),
            best(&self.sent),
            best(&self.received),
            match &self.error {
                Some(error) => error.clone(),
                None => self.lost().to_string(),
            },
        ];
        cells.map(Cell::from).into()
    }
}

impl RoundTripSummary {
    /// Returns the time that a stored share of the requests did not exceed, in milliseconds.
    pub fn quantile_ms(&self, share: f64) -> Option<f64> {
        let mut curve = self.curve.iter();
        curve.find(|(of, _)| *of == share).map(|(_, ms)| *ms)
    }
}

impl From<RoundTrips> for RoundTripSummary {
    fn from(measured: RoundTrips) -> Self {
        let rounded = |ms: f64| (ms * 1000.0).round() / 1000.0;
        let at = |share| Some((share, rounded(measured.quantile_ms(share)?)));
        Self {
            replies: measured.replies(),
            lost: measured.lost,
            curve: SHARES.into_iter().filter_map(at).collect(),
        }
    }
}

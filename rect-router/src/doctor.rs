//! Finds problems that keep a computer from reaching robots, with advice on each: `rect-router doctor` shows them, and the registry
//! of a router answers with them.
pub mod alerts;
pub mod declarations;
pub mod encryption;
pub mod names;
pub mod radio;
pub mod refused;
pub mod slow_link;
pub mod system;

use std::path::Path;

use rect_core::registry::connection::Connection;
use serde::Serialize;
use serde_json::Value;
use zenoh_link_any::locator;

/// The result of one check.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Subject of the check.
    pub about: &'static str,
    /// Result of the check.
    pub verdict: Verdict,
    /// Description of the result.
    pub what: String,
    /// Advice, if there is a problem that the user can solve.
    pub advice: Option<String>,
}

/// The verdict of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// There is no problem.
    Good,
    /// It works, but could be improved.
    Poor,
    /// It does not work.
    Wrong,
}

impl Finding {
    /// Creates a finding that there is no problem.
    pub fn good(about: &'static str, what: impl Into<String>) -> Self {
        Self {
            about,
            verdict: Verdict::Good,
            what: what.into(),
            advice: None,
        }
    }

    /// Creates a finding of what works, and could be improved.
    pub fn poor(about: &'static str, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Poor,
            advice: Some(advice.into()),
            ..Self::good(about, what)
        }
    }

    /// Creates a finding of what does not work.
    pub fn wrong(about: &'static str, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Wrong,
            ..Self::poor(about, what, advice)
        }
    }
}

/// Returns the findings of a router about its computer, its links and its programs. `adapters` are those of its Bluetooth listeners,
/// `may_choose` is whether it may choose connection
/// intervals, if that is known, and `delayed` the number of declarations that had to wait.
pub fn of_router(
    connections: &[Connection],
    adapters: &[String],
    may_choose: Option<bool>,
    delayed: u64,
) -> Vec<Finding> {
    let mut findings = system::findings(Path::new("/"), Some(adapters));
    findings.extend(declarations::finding(delayed));
    // The form that another router would answer with.
    if let Ok(connections) = serde_json::to_value(connections) {
        findings.extend(radio::findings(&connections, may_choose));
        findings.extend(encryption::findings(&connections, adapters));
        findings.extend(refused::findings(&connections));
    }
    findings
}

/// Returns whether a router uses the simulated air and no other adapter.
fn is_simulated(adapters: &[String]) -> bool {
    !adapters.is_empty()
        && adapters
            .iter()
            .all(|one| zenoh_link_ble::locator::is_simulated(one))
}

/// Returns whether a connection uses Bluetooth.
fn has_radio(connection: &Value) -> bool {
    (connection["method"].as_str()).is_some_and(locator::has_radio)
}

/// Returns the name of the robot or program at the other end of a connection, or else its address.
fn peer(connection: &Value) -> &str {
    let mut paths = ["/peer/robot", "/address"].iter();
    let peer = paths.find_map(|path| connection.pointer(path)?.as_str());
    peer.unwrap_or("a robot")
}

//! Implements `rect-router doctor`: finds problems that keep this computer from reaching other robots, and gives advice on
//! each.
mod encryption;
mod login;
mod names;
mod network;
mod radio;
mod system;

use std::{path::Path, process::ExitCode};

use rect::{
    core::display::line,
    terminal::{self, paint, Style},
};
use serde::Serialize;
use serde_json::Value;
use zenoh_link::any::locator;

use super::Failure;
use crate::args::DoctorArgs;

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
    fn good(about: &'static str, what: impl Into<String>) -> Self {
        Self {
            about,
            verdict: Verdict::Good,
            what: what.into(),
            advice: None,
        }
    }

    fn poor(about: &'static str, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Poor,
            advice: Some(advice.into()),
            ..Self::good(about, what)
        }
    }

    fn wrong(about: &'static str, what: impl Into<String>, advice: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Wrong,
            ..Self::poor(about, what, advice)
        }
    }
}

/// Width of the text before a finding and before advice, in columns.
const MARK_WIDTH: usize = 7;
const ADVICE_WIDTH: usize = 10;

/// Prints a text after `mark`, wrapped to the terminal's width. Removes control characters, as other robots may have sent
/// parts of the text.
fn show(mark: &str, text: &str) {
    let indent = if mark.trim_start().starts_with("->") {
        ADVICE_WIDTH
    } else {
        MARK_WIDTH
    };
    let width = terminal::width().map(|width| width.saturating_sub(indent));
    for (n, text) in terminal::wrap(&line(text), width).iter().enumerate() {
        if n == 0 {
            rect::outln!("{mark}{text}");
        } else {
            rect::outln!("{:indent$}{text}", "");
        }
    }
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

/// Runs all checks and prints their findings. The exit status is 1 if something does not work.
///
/// # Errors
/// Fails if the findings cannot be printed as JSON.
pub fn run(args: &DoctorArgs) -> Result<ExitCode, Failure> {
    let mut findings = system::findings(Path::new("/"));
    findings.extend(network::findings(args));
    if args.json {
        terminal::json(&findings)?;
    } else {
        for finding in &findings {
            let mark = match finding.verdict {
                Verdict::Good => paint(Style::Good, "good "),
                Verdict::Poor => paint(Style::Poor, "poor "),
                Verdict::Wrong => paint(Style::Wrong, "WRONG"),
            };
            show(
                &format!("{mark}  "),
                &format!("{}: {}", finding.about, finding.what),
            );
            if let Some(advice) = &finding.advice {
                show("       -> ", advice);
            }
        }
    }
    let is_wrong = findings
        .iter()
        .any(|finding| finding.verdict == Verdict::Wrong);
    Ok(ExitCode::from(u8::from(is_wrong)))
}

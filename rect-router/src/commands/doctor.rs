//! Owns `rect-router doctor`: what keeps this computer from talking to others, each with what to do about it.
mod login;
mod names;
mod network;
mod system;

use std::{path::Path, process::ExitCode};

use rect::{
    core::display::line,
    terminal::{self, paint, Style},
};
use serde::Serialize;

use super::{DoctorArgs, Failure};

/// What one look found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What was looked at.
    pub about: &'static str,
    /// How it is.
    pub verdict: Verdict,
    /// In words.
    pub what: String,
    /// What to do, where something can be done.
    pub advice: Option<String>,
}

/// How something is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// As it should be.
    Good,
    /// It works, and could be better.
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

/// The columns of what stands before a finding and before an advice.
const MARK_WIDTH: usize = 7;
const ADVICE_WIDTH: usize = 10;

/// Prints a text after `mark`, in lines that fit the terminal. What others have sent may be a part of it.
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

/// Tells all findings; the exit status is 1 where something does not work.
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

//! Owns `rect-router doctor`: what keeps this computer from talking to others, each with what to do about it.
mod network;
mod system;

use std::{path::Path, process::ExitCode};

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

/// Tells all findings; the exit status is 1 where something does not work.
pub fn run(args: &DoctorArgs) -> Result<ExitCode, Failure> {
    let mut findings = system::findings(Path::new("/"));
    findings.extend(network::findings(&args.router));
    if args.json {
        println!("{}", serde_json::to_string_pretty(&findings)?);
    } else {
        for finding in &findings {
            let mark = match finding.verdict {
                Verdict::Good => "good ",
                Verdict::Poor => "poor ",
                Verdict::Wrong => "WRONG",
            };
            println!("{mark}  {}: {}", finding.about, finding.what);
            if let Some(advice) = &finding.advice {
                println!("       -> {advice}");
            }
        }
    }
    let is_wrong = findings
        .iter()
        .any(|finding| finding.verdict == Verdict::Wrong);
    Ok(ExitCode::from(u8::from(is_wrong)))
}

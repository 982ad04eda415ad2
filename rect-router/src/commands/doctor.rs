//! Implements `rect-router doctor`: finds problems that keep this computer from reaching other robots, and gives advice on
//! each.
mod login;
mod network;

use std::{path::Path, process::ExitCode};

use rect_core::text::display::line;
use rect_terminal::{self as terminal, paint, Style};

use super::Failure;
use crate::{
    args::DoctorArgs,
    doctor::{system, Verdict},
};

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
            rect_terminal::outln!("{mark}{text}");
        } else {
            rect_terminal::outln!("{:indent$}{text}", "");
        }
    }
}

/// Runs all checks and prints their findings. The exit status is 1 if something does not work.
///
/// # Errors
/// Fails if the findings cannot be printed as JSON.
pub fn run(args: &DoctorArgs) -> Result<ExitCode, Failure> {
    let (of_network, adapters) = network::findings(args);
    let mut findings = system::findings(Path::new("/"), adapters.as_deref());
    findings.extend(of_network);
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

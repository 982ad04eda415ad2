//! Describes how a run of a program has ended.
use std::{os::unix::process::ExitStatusExt, process::ExitStatus, time::Duration};

use rect::Name;
use rect_core::text::humanize;
use rustix::process::Signal;
use serde_json::json;

/// The maximum length of the reason in an alert, in characters.
const MAX_REASON: usize = 120;

/// How a run of the program has ended.
pub struct End {
    pub status: ExitStatus,
    pub ran: Duration,
    /// Somebody has asked for it.
    pub is_asked: bool,
    /// Programs that it has left behind still have its output.
    pub has_left_programs: bool,
    pub last_error: String,
}

impl End {
    pub fn has_failed(&self) -> bool {
        !self.status.success() && !self.is_asked
    }

    /// Returns how the program has ended, in words: `failed after 12 s with exit status 1`.
    pub fn text(&self) -> String {
        let ran = humanize::duration(self.ran);
        match (self.status.signal(), self.status.code()) {
            (Some(signal), _) => format!("was ended after {ran} by {}", signal_in_words(signal)),
            (None, Some(0)) => format!("ended after {ran}"),
            (None, code) => {
                let code = code.unwrap_or_default();
                format!("failed after {ran} with exit status {code}")
            }
        }
    }

    pub fn fields(&self, restarts: u64) -> Vec<(&'static str, serde_json::Value)> {
        let ended = match (self.status.signal(), self.status.code()) {
            (Some(signal), _) => ("signal", json!(signal)),
            (None, code) => ("exit_status", json!(code)),
        };
        let seconds = (self.ran.as_secs_f64() * 1000.0).round() / 1000.0;
        let restarts = (restarts > 0).then(|| ("restarts", json!(restarts)));
        [ended, ("seconds", json!(seconds))]
            .into_iter()
            .chain(restarts)
            .collect()
    }

    /// Returns the text of the alert: how it has ended, and the last line that it wrote to the standard error.
    pub fn alert(&self, program: &Name, restarts: u64) -> String {
        let reason = self.last_error.lines().last().unwrap_or_default().trim();
        let reason: String = reason.chars().take(MAX_REASON).collect();
        let mut text = format!("{program} {}", self.text());
        if !reason.is_empty() {
            text.push_str(": ");
            text.push_str(&reason);
        }
        if restarts > 0 {
            text.push_str(&format!(" (restarted {restarts} times)"));
        }
        text
    }
}

/// Names a signal, with what it usually means.
fn signal_in_words(number: i32) -> String {
    let known = [
        (
            Signal::SEGV,
            "SIGSEGV, an access to memory that it does not have",
        ),
        (Signal::ABORT, "SIGABRT: it has aborted itself"),
        (
            Signal::ILL,
            "SIGILL: it was perhaps built for another processor",
        ),
        (Signal::BUS, "SIGBUS, a wrong access to memory"),
        (Signal::FPE, "SIGFPE, such as a division by zero"),
        (
            Signal::KILL,
            "SIGKILL: somebody has killed it, or the robot had no memory left",
        ),
        (Signal::TERM, "SIGTERM"),
        (Signal::INT, "SIGINT"),
        (Signal::HUP, "SIGHUP: its terminal was closed"),
        (Signal::PIPE, "SIGPIPE: nobody reads its output"),
    ];
    let known = known
        .into_iter()
        .find(|(signal, _)| signal.as_raw() == number);
    known.map_or_else(|| format!("signal {number}"), |(_, text)| text.to_owned())
}

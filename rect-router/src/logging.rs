//! Sets up the log. Like zenohd's, it is written to stdout and filtered by `RUST_LOG`. It has colours on a terminal only.
//!
//! Logging never blocks on the reader of the log and never fails because of it: lines pass through a queue to a thread
//! (`queue`), and lines that do not fit are counted and dropped. A panic is logged in the same way. Repeated warnings and errors
//! are summed up (`repeats`).

mod queue;
mod repeats;

use std::{
    backtrace::{Backtrace, BacktraceStatus},
    env::{self, VarError},
    io::{self, IsTerminal, Write},
    panic::{self, PanicHookInfo},
    sync::{mpsc, OnceLock},
    thread,
    time::Duration,
};

use tracing_subscriber::{prelude::*, EnvFilter};

use self::{
    queue::{Line, LineQueue},
    repeats::Summaries,
};

/// The default filter: level `info` for Zenoh, whose targets begin with `z`, and for RECT.
const DEFAULT_FILTER: &str = "z=info,rect=info";
/// Maximum time for which the end of the program waits until the log and the last message on stderr are written, as their
/// reader may have stopped.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);

static QUEUE: OnceLock<LineQueue> = OnceLock::new();
static SUMMARIES: OnceLock<Summaries> = OnceLock::new();

/// Starts logging. Call it before anything else logs.
///
/// # Errors
/// Fails if `RUST_LOG` is invalid or the thread cannot be started.
pub fn start() -> Result<(), StartError> {
    let given = match env::var("RUST_LOG") {
        Ok(given) => given,
        Err(VarError::NotPresent) => DEFAULT_FILTER.to_owned(),
        Err(VarError::NotUnicode(given)) => given.to_string_lossy().into_owned(),
    };
    let filter =
        EnvFilter::try_new(&given).map_err(|source| StartError::Filter { given, source })?;
    let queue = LineQueue::start(io::stdout()).map_err(StartError::Thread)?;
    let queue = QUEUE.get_or_init(|| queue);
    let (summed_up, summaries) = repeats::sum_up(write_summary);
    let _ = SUMMARIES.set(summaries);
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_thread_ids(true)
        .with_thread_names(true)
        .with_ansi(has_colour(
            io::stdout().is_terminal(),
            env::var_os("NO_COLOR").is_some_and(|set| !set.is_empty()),
        ))
        // By default the subscriber reports a failed write on stderr, and panics if that fails, too.
        .log_internal_errors(false)
        .with_writer(|| Line::new(queue))
        .finish()
        .with(summed_up)
        .init();
    panic::set_hook(Box::new(log_panic));
    Ok(())
}

/// Writes how often warnings and errors were repeated that are not in the log. Call it now and then.
pub fn sum_up_repeated() {
    if let Some(summaries) = SUMMARIES.get() {
        summaries.write();
    }
}

fn write_summary(summary: String) {
    if let Some(queue) = QUEUE.get() {
        queue.push(format!("rect-router: {summary}\n").into_bytes());
    }
}

/// Waits until the log is written, at most 1 s: its reader may have stopped or exited.
pub fn finish() {
    if let Some(queue) = QUEUE.get() {
        queue.flush(FLUSH_TIMEOUT);
    }
}

/// Writes a message for the user to stderr. It is lost if it is not read within 1 s; the exit status still reports the
/// failure.
pub fn report(message: &str) {
    let line = format!("rect-router: {message}\n");
    let (written, is_written) = mpsc::channel();
    let writing = thread::Builder::new().spawn(move || {
        let _ = io::stderr().write_all(line.as_bytes());
        let _ = written.send(());
    });
    if writing.is_ok() {
        let _ = is_written.recv_timeout(FLUSH_TIMEOUT);
    }
}

/// Returns whether to use colours: on a terminal, unless `NO_COLOR` is set (<https://no-color.org>).
fn has_colour(is_terminal: bool, is_disabled: bool) -> bool {
    is_terminal && !is_disabled
}

/// Logs a panic. Rust's default hook writes to stderr, and would block if nothing reads it.
fn log_panic(panic: &PanicHookInfo<'_>) {
    let Some(queue) = QUEUE.get() else { return };
    let thread = thread::current();
    let name = thread.name().unwrap_or("(unnamed)");
    let mut text = format!("rect-router: thread {name}: {panic}\n");
    let backtrace = Backtrace::capture();
    if backtrace.status() == BacktraceStatus::Captured {
        text.push_str(&format!("{backtrace}\n"));
    }
    queue.push(text.into_bytes());
}

/// The reason why logging could not be started.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// `RUST_LOG` is not a filter. Write it as `info`, or as `zenoh=debug,rect=info`.
    #[error("RUST_LOG={given} is not a log filter; use for example RUST_LOG=info or RUST_LOG=zenoh=debug,rect=info")]
    Filter {
        /// Value of the variable.
        given: String,
        /// Description and position of the mistake.
        source: tracing_subscriber::filter::ParseError,
    },
    /// The thread that writes the log could not be started.
    #[error("cannot start the thread that writes the log")]
    Thread(#[source] io::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_need_a_terminal_and_can_be_disabled() {
        let cases = [(true, false), (true, true), (false, false), (false, true)];
        let coloured = cases.map(|(is_terminal, is_disabled)| has_colour(is_terminal, is_disabled));
        assert_eq!(coloured, [true, false, false, false]);
    }
}

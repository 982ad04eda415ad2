//! The log: as zenohd's, on stdout, steered by `RUST_LOG`, with colours on a terminal only.
//!
//! Nothing that logs ever waits for the log's reader or fails because of it: lines go through a queue to a thread of their
//! own (`queue`), and what does not fit is counted and left out. A panic is logged in the same way.

mod queue;

use std::{
    backtrace::{Backtrace, BacktraceStatus},
    env::{self, VarError},
    io::{self, IsTerminal, Write},
    panic::{self, PanicHookInfo},
    sync::{mpsc, OnceLock},
    thread,
    time::Duration,
};

use tracing_subscriber::EnvFilter;

use self::queue::{Line, LineQueue};

/// All of zenoh (its targets begin with `z`) and of RECT, from `info` up.
const DEFAULT_FILTER: &str = "z=info,rect=info";
/// How long the end of the program waits until the log is written; a reader may have stopped reading.
const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);

static QUEUE: OnceLock<LineQueue> = OnceLock::new();

/// Starts logging, before anything can have something to say.
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
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_thread_ids(true)
        .with_thread_names(true)
        .with_ansi(has_colour(
            io::stdout().is_terminal(),
            env::var_os("NO_COLOR").is_some_and(|set| !set.is_empty()),
        ))
        // The subscriber reports a line that it cannot write on stderr, and panics where that cannot be written either.
        .log_internal_errors(false)
        .with_writer(|| Line::new(queue))
        .init();
    panic::set_hook(Box::new(log_panic));
    Ok(())
}

/// Waits until what was logged is written, but not for long: the reader may be gone, or have stopped.
pub fn finish() {
    if let Some(queue) = QUEUE.get() {
        queue.flush(FLUSH_TIMEOUT);
    }
}

/// Writes a message for the user on stderr. It is lost if nobody reads it in time; the exit status tells the same.
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

/// Colours are for a terminal, unless the user does not want any (<https://no-color.org>).
fn has_colour(is_terminal: bool, is_unwanted: bool) -> bool {
    is_terminal && !is_unwanted
}

/// Rust's own hook writes to stderr, and waits where nobody reads it.
fn log_panic(panic: &PanicHookInfo<'_>) {
    let Some(queue) = QUEUE.get() else { return };
    let thread = thread::current();
    let name = thread.name().unwrap_or("without a name");
    let mut text = format!("rect-router: thread {name}: {panic}\n");
    let backtrace = Backtrace::capture();
    if backtrace.status() == BacktraceStatus::Captured {
        text.push_str(&format!("{backtrace}\n"));
    }
    queue.push(text.into_bytes());
}

/// Why there is no log.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// Give `RUST_LOG` as `info`, or as `zenoh=debug,rect=info`.
    #[error("RUST_LOG={given} is not a log filter; use for example RUST_LOG=info or RUST_LOG=zenoh=debug,rect=info")]
    Filter {
        /// The value of the variable.
        given: String,
        /// Where it is wrong.
        source: tracing_subscriber::filter::ParseError,
    },
    /// The system refuses a thread.
    #[error("the log has no thread to be written by")]
    Thread(#[source] io::Error),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_for_a_terminal_and_for_users_who_want_them() {
        let cases = [(true, false), (true, true), (false, false), (false, true)];
        let coloured = cases.map(|(is_terminal, is_unwanted)| has_colour(is_terminal, is_unwanted));
        assert_eq!(coloured, [true, false, false, false]);
    }
}

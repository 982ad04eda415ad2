//! Gives the lines of a program to the router of its robot, and keeps those of a robot.
use std::{
    fmt,
    time::{Duration, Instant},
};

use rect_core::{
    log::{keeper::LogKeeper, line::Line, outbox::Outbox},
    name::key::KeySpace,
};
use tokio::runtime::Handle;
use zenoh::Session;

use super::{
    executor::{Executor, OnThread, Running},
    shared::NoItems,
};
use crate::error::Error;

/// How long the end of a session waits for the last lines.
const LAST_LINES: Duration = Duration::from_secs(1);
/// How long the last lines wait for a router that has just started.
const FIRST_ANSWER: Duration = Duration::from_millis(150);
/// The interval at which that is checked.
const CHECK_EVERY: Duration = Duration::from_millis(5);

/// Logs lines of a program; created by [`Robot::log_of`](crate::Robot::log_of).
pub struct ProgramLog(Running<Outbox>);

impl ProgramLog {
    pub(super) fn start(
        session: &Session,
        outbox: Outbox,
        runtime: &Handle,
    ) -> Result<Self, Error> {
        let executor = Executor::new(session, outbox, NoItems);
        executor.start(runtime).map(Self)
    }

    /// Logs a line, as [`Robot::log_line`](crate::Robot::log_line) does, or one that stays on this robot.
    pub fn log(&self, line: Line, is_private: bool) {
        if (self.0.driver()).log(line, is_private, Instant::now()) {
            self.0.wake();
        }
    }

    /// Waits until the last lines were sent, for 1 s at most.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn flush(&self) {
        let now = Instant::now();
        self.0.driver().flush(now, now + FIRST_ANSWER);
        self.0.wake();
        let until = now + LAST_LINES;
        while !self.0.driver().is_empty() && Instant::now() < until {
            tokio::time::sleep(CHECK_EVERY).await;
        }
    }
}

impl Drop for ProgramLog {
    /// Sends the last lines, of a program that does not close its session.
    fn drop(&mut self) {
        let now = Instant::now();
        self.0.driver().flush(now, now);
        if let Err(error) = self.0.poll_now() {
            tracing::debug!("the last lines of the log were not sent: {error}");
        }
    }
}

impl fmt::Debug for ProgramLog {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ProgramLog").finish_non_exhaustive()
    }
}

/// The log of a robot, which is kept until this is dropped. For routers; a program without a router has one of its own.
#[doc(hidden)]
pub struct KeptLog(OnThread<LogKeeper>);

impl KeptLog {
    /// Begins to keep the lines of the programs of the robot of `place`, on a thread.
    ///
    /// # Errors
    /// [`Error::Zenoh`] if Zenoh refuses a declaration.
    pub fn start(session: &Session, place: KeySpace) -> Result<Self, Error> {
        let keeper = LogKeeper::new(place, rand::random());
        let executor = Executor::new(session, keeper, NoItems);
        Ok(Self(OnThread::start(executor, "log")?))
    }

    /// Waits until those who follow were sent the last lines, for 1 s at most.
    pub(super) async fn flush(&self) {
        let until = Instant::now() + LAST_LINES;
        while !self.0.driver().flush() && Instant::now() < until {
            self.0.signal().set();
            tokio::time::sleep(CHECK_EVERY).await;
        }
    }
}

//! Logs lines of the program, and reads those of others.
mod layer;
mod reading;

pub use layer::LogLayer;
pub use reading::{LogOptions, Logs};

use std::{
    fmt,
    sync::Arc,
    time::{Duration, Instant, SystemTime},
};

use rect_core::{
    clock::unix::ms_since_1970,
    driver::Event,
    log::{keeper::LogKeeper, level::Level, line::Line, outbox::Outbox},
    name::{key::KeySpace, Name},
};
use zenoh::Session;

use super::{
    executor::{Executor, Running},
    robot::Robot,
    shared::{NoItems, Shared},
};
use crate::error::Error;

/// How long the end of a session waits for the last lines.
const LAST_LINES: Duration = Duration::from_millis(200);
/// The interval at which that is checked.
const CHECK_EVERY: Duration = Duration::from_millis(5);

impl Robot {
    /// Logs a line, which the router of this robot keeps: `rect log` shows it, also after this program has ended.
    ///
    /// It never waits and never fails. A router keeps the last 1,000 lines of each program, and 2 MB in all. A program that logs faster
    /// than that can be sent loses lines, which are counted in the log. A text has 8 kB at most; a longer one is cut.
    ///
    /// ```no_run
    /// # fn log(robot: rect::Robot) {
    /// robot.log(rect::Level::Warn, "the gripper is slow");
    /// # }
    /// ```
    pub fn log(&self, level: Level, text: impl Into<String>) {
        let now_ms = ms_since_1970(SystemTime::now());
        self.log_line(Line::new(now_ms, level, text));
    }

    /// Logs a line with everything that belongs to it, as [`log`](Self::log) does.
    pub fn log_line(&self, line: Line) {
        self.give_line(line, false);
    }

    /// Logs a line that stays on this robot: access control does not let other robots read it. For what may contain paths or passwords.
    pub fn log_private(&self, line: Line) {
        self.give_line(line, true);
    }

    fn give_line(&self, line: Line, is_private: bool) {
        let inner = &self.inner;
        let start = || {
            let program = inner.program.driver().program().clone();
            ProgramLog::start(self, program.name.as_ref(), program.instance.0).ok()
        };
        if let Some(log) = inner.log.get_or_init(start) {
            log.log(line, is_private);
        }
    }

    /// Returns the log of a program of this robot that does not use RECT itself, for those who run it.
    ///
    /// # Errors
    /// [`Error::Closed`] if the session is closed.
    pub fn log_of(&self, program: &Name) -> Result<ProgramLog, Error> {
        ProgramLog::start(self, Some(program), rand::random())
    }

    /// Waits until the last lines of the program were sent, for a moment at most.
    pub(super) async fn flush_log(&self) {
        if let Some(Some(log)) = self.inner.log.get() {
            log.flush().await;
        }
    }
}

/// Logs lines of a program; created by [`Robot::log_of`].
pub struct ProgramLog(Running<Outbox>);

impl ProgramLog {
    fn start(robot: &Robot, program: Option<&Name>, run: u32) -> Result<Self, Error> {
        let inner = &robot.inner;
        let outbox = Outbox::new(&inner.place, program, run);
        let executor = Executor::new(&inner.session, outbox, NoItems);
        executor.start(&inner.runtime).map(Self)
    }

    /// Logs a line, as [`Robot::log_line`] does, or one that stays on this robot.
    pub fn log(&self, line: Line, is_private: bool) {
        if (self.0.driver()).log(line, is_private, Instant::now()) {
            self.0.wake();
        }
    }

    /// Waits until the last lines were sent, for 0.2 s at most.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn flush(&self) {
        self.0.driver().flush(Instant::now());
        self.0.wake();
        let until = Instant::now() + LAST_LINES;
        while !self.0.driver().is_empty() && Instant::now() < until {
            tokio::time::sleep(CHECK_EVERY).await;
        }
    }
}

impl Drop for ProgramLog {
    /// Sends the last lines, of a program that does not close its session.
    fn drop(&mut self) {
        self.0.driver().flush(Instant::now());
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
pub struct KeptLog(Arc<Shared<LogKeeper>>);

impl KeptLog {
    /// Begins to keep the lines of the programs of the robot of `place`, on a thread.
    ///
    /// # Errors
    /// [`Error::Zenoh`] if Zenoh refuses a declaration.
    pub fn start(session: &Session, place: KeySpace) -> Result<Self, Error> {
        let keeper = LogKeeper::new(place, rand::random());
        let executor = Executor::new(session, keeper, NoItems);
        Ok(Self(executor.start_thread("log")?))
    }
}

impl Drop for KeptLog {
    fn drop(&mut self) {
        self.0.on_event(Event::Closed);
    }
}

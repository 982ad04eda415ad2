//! Logs lines of the program, and reads those of others.
mod layer;
mod reading;

pub use layer::LogLayer;
pub use reading::{LogOptions, Logs};

use std::time::SystemTime;

use rect_core::{
    clock::unix::ms_since_1970,
    log::{level::Level, line::Line, outbox::Outbox},
    name::Name,
};

use super::{program_log::ProgramLog, robot::Robot};
use crate::error::Error;

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
            self.start_log(program.name.as_ref(), program.instance.0)
                .ok()
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
        self.start_log(Some(program), rand::random())
    }

    fn start_log(&self, program: Option<&Name>, run: u32) -> Result<ProgramLog, Error> {
        let inner = &self.inner;
        let outbox = Outbox::new(&inner.place, program, run);
        ProgramLog::start(&inner.session, outbox, &inner.runtime)
    }

    /// Waits until the last lines of the program were sent, for a moment at most.
    pub(super) async fn flush_log(&self) {
        if let Some(Some(log)) = self.inner.log.get() {
            log.flush().await;
        }
        if let Some((_, kept, _)) = &self.inner.kept {
            kept.flush().await;
        }
    }
}

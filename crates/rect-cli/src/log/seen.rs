//! The lines that this computer has seen of robots, for the time when they are silent.
use std::time::{Duration, SystemTime};

use rect::{KeptLine, Name};
use rect_core::{
    clock::unix::ms_since_1970,
    log::seen::{SeenLog, SeenLogs},
    session::names::reachable_robots,
    text::humanize::duration,
};

use super::print::Printer;

/// The logs that this computer has seen.
pub struct Seen(SeenLogs);

impl Seen {
    pub fn of(fleet: &Name) -> Self {
        Self(SeenLogs::new(fleet, |name| std::env::var_os(name)))
    }

    /// Remembers lines.
    pub fn add(&mut self, robot: &Name, lines: &[KeptLine]) {
        if let Some(log) = self.log(robot) {
            log.add(lines, ms_since_1970(SystemTime::now()));
        }
    }

    /// Writes what was added. If that fails, the lines are shown nevertheless.
    pub fn save(&mut self) {
        for (_, error) in self.0.save() {
            tracing::warn!(
                "the lines are not remembered for the time when the robot is silent: {error}"
            );
        }
    }

    /// Prints what was seen of a robot that does not answer, and says so.
    pub fn print(&mut self, robot: &Name, reachable: &[Name], printer: &Printer) {
        let now = ms_since_1970(SystemTime::now());
        let Some(log) = self.log(robot) else { return };
        let Some(last) = log.lines().map(|line| line.seen).max() else {
            rect_terminal::errln!(
                "rect log: {robot} does not answer, and this computer has not seen any of its lines; {}",
                reachable_robots(robot, reachable)
            );
            return;
        };
        for kept in printer.last(log.lines().map(|line| &line.kept)) {
            printer.print(robot, kept);
        }
        let age = duration(Duration::from_millis(now.saturating_sub(last)));
        rect_terminal::errln!(
            "rect log: {robot} does not answer; this computer has seen these lines before, the last ones {age} ago"
        );
    }

    fn log(&mut self, robot: &Name) -> Option<&mut SeenLog> {
        let log = self.0.of(robot);
        log.inspect_err(|error| tracing::warn!("{error}")).ok()?
    }
}

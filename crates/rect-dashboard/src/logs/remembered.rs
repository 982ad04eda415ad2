//! Remembers the lines of all robots that this computer has seen. Their files are read and written on threads that may wait for the
//! disk.
use std::mem;

use rect::{Level, Name};
use rect_core::log::{
    page::Kept,
    seen::{SeenLine, SeenLog, SeenLogs},
};
use tokio::task::spawn_blocking;

/// The lines of each robot.
pub struct Remembered {
    fleet: Name,
    logs: SeenLogs,
}

impl Remembered {
    /// Reads the files of a fleet.
    pub async fn load(fleet: Name) -> Self {
        let mut logs = of_fleet(&fleet);
        let loaded = spawn_blocking(move || {
            for robot in logs.robots() {
                open(&mut logs, &robot);
            }
            logs
        });
        Self {
            logs: loaded.await.unwrap_or_else(|_| of_fleet(&fleet)),
            fleet,
        }
    }

    /// Adds lines of a robot, except those that are remembered.
    pub fn add(&mut self, robot: &Name, lines: &[Kept], now_ms: u64) {
        if let Some(log) = open(&mut self.logs, robot) {
            log.add(lines, now_ms);
        }
    }

    /// Returns the newest lines of each robot of `level` and above, the oldest one first, within about `bytes` of all.
    pub fn newest(&self, level: Level, bytes: usize) -> Vec<(&Name, Vec<SeenLine>)> {
        let share = bytes / self.logs.all().len().max(1);
        let newest = self.logs.all().map(|(robot, log)| {
            let mut room = share;
            let important = log.lines().rev();
            let important = important.filter(|seen| seen.kept.line.level >= level);
            let fitting = important.take_while(|seen| {
                let fits = room > 0;
                room = room.saturating_sub(seen.kept.line.size());
                fits
            });
            let mut lines: Vec<_> = fitting.cloned().collect();
            lines.reverse();
            (robot, lines)
        });
        newest.filter(|(_, lines)| !lines.is_empty()).collect()
    }

    /// Writes the files of the robots whose lines have changed.
    pub async fn save(mut self) -> Self {
        let mut logs = mem::replace(&mut self.logs, of_fleet(&self.fleet));
        let saved = spawn_blocking(move || {
            for (robot, error) in logs.save() {
                tracing::warn!("cannot keep the lines of {robot} on the disk: {error}");
            }
            logs
        });
        if let Ok(logs) = saved.await {
            self.logs = logs;
        }
        self
    }
}

fn of_fleet(fleet: &Name) -> SeenLogs {
    SeenLogs::new(fleet, |name| std::env::var_os(name))
}

fn open<'a>(logs: &'a mut SeenLogs, robot: &Name) -> Option<&'a mut SeenLog> {
    let log = logs.of(robot);
    log.inspect_err(|error| tracing::warn!("{error}")).ok()?
}

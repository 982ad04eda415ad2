//! Remembers the lines of all robots that this computer has seen. Their files are read and written on threads that may wait for the
//! disk.
use std::{collections::BTreeMap, fs, mem, path::PathBuf};

use rect::{Level, Name};
use rect_core::log::{
    page::Kept,
    seen::{self, SeenLine, SeenLog},
};
use tokio::task::spawn_blocking;

/// The lines of each robot.
pub struct Remembered {
    fleet: Name,
    logs: BTreeMap<Name, SeenLog>,
}

impl Remembered {
    /// Reads the files of a fleet. `own`: a robot of it.
    pub async fn load(fleet: Name, own: Name) -> Self {
        let named = fleet.clone();
        let logs = spawn_blocking(move || {
            let robots = robots(&named, &own).into_iter();
            let logs = robots.filter_map(|robot| Some((robot.clone(), open(&named, &robot)?)));
            logs.collect()
        });
        Self {
            logs: logs.await.unwrap_or_default(),
            fleet,
        }
    }

    /// Adds lines of a robot, except those that are remembered.
    pub fn add(&mut self, robot: &Name, lines: &[Kept], now_ms: u64) {
        if !self.logs.contains_key(robot) {
            let Some(log) = open(&self.fleet, robot) else {
                return;
            };
            self.logs.insert(robot.clone(), log);
        }
        if let Some(log) = self.logs.get_mut(robot) {
            log.add(lines, now_ms);
        }
    }

    /// Returns the newest lines of each robot of `level` and above, the oldest one first, within about `bytes` of all.
    pub fn newest(&self, level: Level, bytes: usize) -> Vec<(&Name, Vec<SeenLine>)> {
        let share = bytes / self.logs.len().max(1);
        let newest = self.logs.iter().map(|(robot, log)| {
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
        let mut logs = mem::take(&mut self.logs);
        let saved = spawn_blocking(move || {
            for (robot, log) in &mut logs {
                if let Err(error) = log.save() {
                    tracing::warn!("cannot keep the lines of {robot} on the disk: {error}");
                }
            }
            logs
        });
        self.logs = saved.await.unwrap_or_default();
        self
    }
}

fn path(fleet: &Name, robot: &Name) -> Option<PathBuf> {
    seen::path(fleet, robot, |name| std::env::var_os(name))
}

fn open(fleet: &Name, robot: &Name) -> Option<SeenLog> {
    let path = path(fleet, robot)?;
    let log = SeenLog::open(&path);
    log.inspect_err(|error| tracing::warn!("{}: {error}", path.display()))
        .ok()
}

/// Returns the robots that have a file.
fn robots(fleet: &Name, own: &Name) -> Vec<Name> {
    let folder = path(fleet, own).and_then(|path| path.parent().map(PathBuf::from));
    let files = folder.and_then(|folder| fs::read_dir(folder).ok());
    let paths = files
        .into_iter()
        .flatten()
        .flatten()
        .map(|file| file.path());
    let names = paths.filter_map(|path| Name::new(path.file_stem()?.to_str()?).ok());
    names.collect()
}

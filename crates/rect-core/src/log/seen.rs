//! The lines of a robot that this computer has seen, for the time when the robot is silent: a file in JSON Lines.
use std::{
    collections::{BTreeMap, VecDeque},
    ffi::OsString,
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

use super::page::Kept;
use crate::{
    name::Name,
    storage::{state_folder, ReplacedFile},
};

/// The maximum number of lines in the file.
const MAX_LINES: usize = 2000;
/// The maximum size of the file, in bytes; a larger one is not read.
const MAX_BYTES: u64 = 16 << 20;

/// A line, and when it was seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SeenLine {
    /// When this computer has received it, in milliseconds since 1970.
    pub seen: u64,
    /// The line.
    #[serde(flatten)]
    pub kept: Kept,
}

/// The last lines of a robot that this computer has seen.
#[derive(Debug)]
pub struct SeenLog {
    file: ReplacedFile,
    lines: VecDeque<SeenLine>,
    is_changed: bool,
}

impl SeenLog {
    /// Reads the file at `path`, if there is one. Lines that cannot be read are skipped.
    ///
    /// # Errors
    /// Fails if there is a file that cannot be read.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = ReplacedFile::new(path);
        let text = file.read(MAX_BYTES)?;
        let lines = text
            .lines()
            .filter_map(|line| serde_json::from_str(line).ok());
        Ok(Self {
            lines: lines.collect(),
            file,
            is_changed: false,
        })
    }

    /// Returns the lines, the oldest one first.
    pub fn lines(&self) -> impl DoubleEndedIterator<Item = &SeenLine> {
        self.lines.iter()
    }

    /// Adds lines, except those that it has.
    pub fn add(&mut self, lines: &[Kept], now_ms: u64) {
        for kept in lines {
            let is_known = self.lines.iter().rev().any(|seen| seen.kept == *kept);
            if !is_known {
                let kept = kept.clone();
                let at = kept.line.at;
                let place = self
                    .lines
                    .iter()
                    .rposition(|seen| seen.kept.line.at <= at)
                    .map_or(0, |place| place + 1);
                self.lines.insert(place, SeenLine { seen: now_ms, kept });
                self.is_changed = true;
            }
        }
        while self.lines.len() > MAX_LINES {
            self.lines.pop_front();
        }
    }

    /// Writes the file, if lines were added.
    ///
    /// # Errors
    /// Fails if its folder cannot be made or the file cannot be written.
    pub fn save(&mut self) -> io::Result<()> {
        if !self.is_changed {
            return Ok(());
        }
        if let Some(folder) = self.file.path().parent() {
            std::fs::create_dir_all(folder)?;
        }
        let mut text = Vec::new();
        for line in &self.lines {
            serde_json::to_writer(&mut text, line)?;
            text.push(b'\n');
        }
        self.file.replace(text)?;
        self.is_changed = false;
        Ok(())
    }
}

/// The logs of the robots of a fleet that this computer has seen: `log/<fleet>/<robot>.jsonl` in the [folder](state_folder) of the
/// user's state. Without such a folder, nothing is remembered. Each file is read when its robot is asked for.
#[derive(Debug)]
pub struct SeenLogs {
    folder: Option<PathBuf>,
    logs: BTreeMap<Name, SeenLog>,
}

impl SeenLogs {
    /// Names the files of a fleet. `variable` returns an environment variable.
    pub fn new(fleet: &Name, variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let folder = state_folder("log", variable);
        Self {
            folder: folder.map(|folder| folder.join(fleet.as_str())),
            logs: BTreeMap::new(),
        }
    }

    /// Returns the robots that have a file.
    pub fn robots(&self) -> Vec<Name> {
        let files = self
            .folder
            .as_ref()
            .and_then(|folder| fs::read_dir(folder).ok());
        let paths = files
            .into_iter()
            .flatten()
            .flatten()
            .map(|file| file.path());
        let names = paths.filter_map(|path| Name::new(path.file_stem()?.to_str()?).ok());
        names.collect()
    }

    /// Returns the log of a robot; `None` if it has no place.
    ///
    /// # Errors
    /// Fails with the path if there is a file that cannot be read.
    pub fn of(&mut self, robot: &Name) -> Result<Option<&mut SeenLog>, String> {
        if !self.logs.contains_key(robot) {
            let Some(folder) = &self.folder else {
                return Ok(None);
            };
            let path = folder.join(format!("{robot}.jsonl"));
            let log = SeenLog::open(&path);
            let log = log.map_err(|error| format!("{}: {error}", path.display()))?;
            self.logs.insert(robot.clone(), log);
        }
        Ok(self.logs.get_mut(robot))
    }

    /// Returns the logs that were asked for, by their robots.
    pub fn all(&self) -> impl ExactSizeIterator<Item = (&Name, &SeenLog)> {
        self.logs.iter()
    }

    /// Writes the files of the robots to which lines were added. Returns those that cannot be written.
    pub fn save(&mut self) -> Vec<(&Name, io::Error)> {
        let saved = self.logs.iter_mut().map(|(robot, log)| (robot, log.save()));
        saved
            .filter_map(|(robot, saved)| Some((robot, saved.err()?)))
            .collect()
    }
}

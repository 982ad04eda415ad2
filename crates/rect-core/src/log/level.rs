//! Defines how important a line is.
use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// How important a line of a log, or an alert, is.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// Details, for finding a fault in the program.
    Debug,
    /// An event of usual operation.
    #[default]
    Info,
    /// Something that somebody should look at.
    Warn,
    /// Something has failed.
    Error,
}

/// The text is not a level.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a level: use debug, info, warn or error")]
pub struct LevelError(String);

impl Level {
    /// All levels, the least important one first.
    pub const ALL: [Self; 4] = [Self::Debug, Self::Info, Self::Warn, Self::Error];

    /// Returns the level as text.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error => "error",
        }
    }

    /// Returns the level of a number of Python's module `logging`, whose levels are 10, 20, 30, 40 and 50.
    pub fn of_python(number: i64) -> Self {
        match number {
            ..20 => Self::Debug,
            20..30 => Self::Info,
            30..40 => Self::Warn,
            40.. => Self::Error,
        }
    }
}

impl FromStr for Level {
    type Err = LevelError;

    /// Reads a level, also by the names that other libraries give to it.
    fn from_str(text: &str) -> Result<Self, LevelError> {
        Ok(match text.to_ascii_lowercase().as_str() {
            "trace" | "debug" => Self::Debug,
            "info" => Self::Info,
            "warn" | "warning" => Self::Warn,
            "error" | "critical" | "fatal" => Self::Error,
            _ => return Err(LevelError(text.chars().take(40).collect())),
        })
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

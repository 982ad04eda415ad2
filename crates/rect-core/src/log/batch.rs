//! The lines that a program gives to its router, in JSON.
use serde::{Deserialize, Serialize};

use super::line::Line;
use crate::message::{encoding::Encoding, payload::Payload};

/// The maximum size of a batch, in bytes.
const MAX_BYTES: usize = 1 << 20;

/// Lines of one run of a program.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Batch {
    /// A random number that is different in each run.
    pub run: u32,
    /// The number of the first line in that run, beginning with 0. A gap before it are lines that were lost.
    pub first: u64,
    /// Whether they stay on the robot.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub private: bool,
    /// The lines.
    pub lines: Vec<Line>,
}

impl Batch {
    /// Returns the batch as bytes.
    pub fn write(&self) -> Payload {
        // Numbers, texts and lists can always be written.
        let json = serde_json::to_vec(self).unwrap_or_default();
        Payload::new(json, Encoding::JSON)
    }

    /// Reads a batch, whose lines are cleaned.
    ///
    /// # Errors
    /// Returns the reason.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        if bytes.len() > MAX_BYTES {
            return Err(format!("a batch of lines has {MAX_BYTES} bytes at most"));
        }
        let batch: Self = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        let lines = batch.lines.into_iter().map(Line::clean).collect();
        Ok(Self { lines, ..batch })
    }
}

//! Defines the blocking form of a recording that runs.
use std::{path::PathBuf, sync::Arc};

use rect_recording::Progress;

use super::Runtime;
use crate::{session, Error};

/// A recording that runs; created by [`Robot::record`](super::Robot::record). Dropping it leaves a folder, which `rect recording
/// merge` makes a file of.
#[derive(Debug)]
pub struct RobotRecorder {
    pub(super) recorder: session::RobotRecorder,
    pub(super) runtime: Arc<Runtime>,
}

impl RobotRecorder {
    /// Returns how the recording goes.
    pub fn progress(&self) -> Progress {
        self.recorder.progress()
    }

    /// Stops, and makes one file of the recording, or several if it is split; none if nothing was recorded. Returns the files.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::RobotRecorder::finish`].
    pub fn finish(self) -> Result<(Vec<PathBuf>, Progress), Error> {
        self.runtime.wait(self.recorder.finish())
    }
}

//! Makes recordings for the page's Record button.
use std::{path::PathBuf, sync::Arc, time::SystemTime};

use rect::{RecordOptions, Robot, RobotRecorder};
use rect_terminal::clock;
use tokio::sync::Mutex;

use crate::{browsers::Browsers, protocol::State};

/// The recording that runs, if one does.
pub struct Recording {
    robot: Robot,
    folder: PathBuf,
    running: Mutex<Option<Running>>,
}

struct Running {
    file: String,
    recorder: RobotRecorder,
}

impl Recording {
    /// Creates the button of a robot, which records to files in a folder.
    pub fn new(robot: Robot, folder: PathBuf) -> Self {
        Self {
            robot,
            folder,
            running: Mutex::default(),
        }
    }

    /// Starts a recording of what the robot's programs publish. Returns the file that it will be.
    ///
    /// # Errors
    /// Fails if one runs already, or the disk fails.
    pub async fn start(&self) -> Result<String, String> {
        let mut running = self.running.lock().await;
        if let Some(running) = &*running {
            return Err(format!("{} is being recorded already", running.file));
        }
        let now = clock::file_name(SystemTime::now());
        let path = self
            .folder
            .join(format!("{}-{now}.mcap", self.robot.name()));
        let file = path.display().to_string();
        let recorder = self.robot.record(path, RecordOptions::default()).await;
        let recorder = recorder.map_err(|error| error.to_string())?;
        *running = Some(Running {
            file: file.clone(),
            recorder,
        });
        Ok(file)
    }

    /// Finishes the recording. Returns the file.
    ///
    /// # Errors
    /// Fails if none runs, or the disk fails.
    pub async fn finish(&self) -> Result<String, String> {
        let running = self.running.lock().await.take();
        let running = running.ok_or("nothing is being recorded")?;
        let finished = running.recorder.finish().await;
        let (files, progress) = finished.map_err(|error| error.to_string())?;
        match files.is_empty() {
            true => Err("nothing was published meanwhile, so there is no recording".to_owned()),
            false => Ok(format!("{}: {} messages", running.file, progress.written)),
        }
    }

    /// Shows browsers how the recording goes.
    pub async fn show(&self, browsers: &Arc<Browsers>) {
        let running = self.running.lock().await;
        let progress = running.as_ref().map(|running| running.recorder.progress());
        let progress = progress.unwrap_or_default();
        browsers.publish(
            "recording",
            &State::Recording {
                file: running.as_ref().map(|running| running.file.as_str()),
                messages: progress.written,
                bytes: progress.bytes,
                dropped: progress.dropped,
                problem: progress.problem.as_deref(),
            },
        );
    }
}

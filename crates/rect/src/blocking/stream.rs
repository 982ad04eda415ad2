//! Implements streams in blocking form.
use std::{sync::Arc, time::Duration};

use super::{Robot, Runtime};
use crate::{session, Error, Frame, QueueOptions, RobotTopic, StreamOptions, StreamSender, Topic};

/// Receives the frames of a stream; created by [`Robot::watch`].
///
/// The iterator blocks until the next frame, by default the newest one, and ends when the session is closed.
#[derive(Debug)]
pub struct Watcher {
    watcher: session::Watcher,
    runtime: Arc<Runtime>,
}

impl Robot {
    /// Declares a stream of frames of which only the newest matters: a slow link drops older ones.
    ///
    /// ```no_run
    /// # fn stream(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// let distance = robot.stream("distance", rect::StreamOptions::sensor())?;
    /// distance.send([12, 34])?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::stream`].
    pub fn stream(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        options: StreamOptions,
    ) -> Result<StreamSender, Error> {
        self.runtime.wait(self.robot.stream(topic, options))
    }

    /// Receives a stream, `<robot>/<topic>`. Only the newest frame is kept until the program reads it.
    ///
    /// ```no_run
    /// # fn watch(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// for frame in robot.watch("wombat-2/camera")? {
    ///     println!("frame {}, {:?} old, {} skipped", frame.number, frame.age, frame.skipped);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::watch`].
    pub fn watch(
        &self,
        stream: impl TryInto<RobotTopic, Error: Into<Error>>,
    ) -> Result<Watcher, Error> {
        let watcher = self.runtime.wait(self.robot.watch(stream))?;
        Ok(self.watcher(watcher))
    }

    /// Receives a stream with other settings of the receive queue.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::watch_with`].
    pub fn watch_with(
        &self,
        stream: impl TryInto<RobotTopic, Error: Into<Error>>,
        queue: QueueOptions,
    ) -> Result<Watcher, Error> {
        let watched = self.robot.watch_with(stream, queue);
        let watcher = self.runtime.wait(watched)?;
        Ok(self.watcher(watcher))
    }

    fn watcher(&self, watcher: session::Watcher) -> Watcher {
        let runtime = self.runtime.clone();
        Watcher { watcher, runtime }
    }
}

impl Watcher {
    /// Leaves video undecoded: see [`crate::Watcher::undecoded`].
    #[must_use]
    pub fn undecoded(self) -> Self {
        let watcher = self.watcher.undecoded();
        Self { watcher, ..self }
    }

    /// Asks the sender of a video for a key frame: see [`crate::Watcher::ask_for_key_frame`].
    pub fn ask_for_key_frame(&self) {
        self.watcher.ask_for_key_frame();
    }

    /// Blocks until the next frame; returns `None` if none arrives within `timeout`, or if the session is closed.
    pub fn next_timeout(&mut self, timeout: Duration) -> Option<Frame> {
        let next = async { tokio::time::timeout(timeout, self.watcher.next()).await };
        self.runtime.wait(next).ok().flatten()
    }

    /// Returns the round trip of a small message to the sender; `None` until the first one has been measured.
    pub fn round_trip(&self) -> Option<Duration> {
        self.watcher.round_trip()
    }
}

impl Iterator for Watcher {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        self.runtime.wait(self.watcher.next())
    }
}

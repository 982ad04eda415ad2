//! Implements streams in blocking form.
use std::{sync::Arc, time::Duration};

use super::{Robot, Runtime};
use crate::{session, Error, Frame, Name, QueueOptions, Stream, StreamOptions, Topic};

/// Receives the frames of a stream; created by [`Robot::watch`].
///
/// The iterator blocks until the next frame, by default the newest one, and ends when the session is closed.
#[derive(Debug)]
pub struct Frames {
    watch: session::Watch,
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
    pub fn stream<T: TryInto<Topic>>(
        &self,
        topic: T,
        options: StreamOptions,
    ) -> Result<Stream, Error>
    where
        Error: From<T::Error>,
    {
        self.runtime.wait(self.robot.stream(topic, options))
    }

    /// Receives the stream `topic` of `robot`. Only the newest frame is kept until the program reads it.
    ///
    /// ```no_run
    /// # fn watch(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// for frame in robot.watch("wombat-2", "camera")? {
    ///     println!("frame {}, {:?} old, {} skipped", frame.number, frame.age, frame.skipped);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::watch`].
    pub fn watch<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
    ) -> Result<Frames, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let watch = self.runtime.wait(self.robot.watch(robot, topic))?;
        Ok(self.frames(watch))
    }

    /// Receives the stream `topic` of `robot`, with other settings of the receive queue.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::watch_with`].
    pub fn watch_with<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        queue: QueueOptions,
    ) -> Result<Frames, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let watched = self.robot.watch_with(robot, topic, queue);
        let watch = self.runtime.wait(watched)?;
        Ok(self.frames(watch))
    }

    fn frames(&self, watch: session::Watch) -> Frames {
        let runtime = self.runtime.clone();
        Frames { watch, runtime }
    }
}

impl Frames {
    /// Leaves video undecoded: see [`crate::Watch::undecoded`].
    #[must_use]
    pub fn undecoded(self) -> Self {
        let watch = self.watch.undecoded();
        Self { watch, ..self }
    }

    /// Asks the sender of a video for a key frame: see [`crate::Watch::ask_for_key_frame`].
    pub fn ask_for_key_frame(&self) {
        self.watch.ask_for_key_frame();
    }

    /// Blocks until the next frame; returns `None` if none arrives within `timeout`, or if the session is closed.
    pub fn next_timeout(&mut self, timeout: Duration) -> Option<Frame> {
        let next = async { tokio::time::timeout(timeout, self.watch.next()).await };
        self.runtime.wait(next).ok().flatten()
    }

    /// Returns the round trip of a small message to the sender; `None` until the first one has been measured.
    pub fn round_trip(&self) -> Option<Duration> {
        self.watch.round_trip()
    }
}

impl Iterator for Frames {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        self.runtime.wait(self.watch.next())
    }
}

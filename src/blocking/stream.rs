//! Owns streams in blocking form.
use std::{sync::Arc, time::Duration};

use tokio::time::timeout;

use super::{Robot, Runtime};
use crate::{session, Error, Frame, Name, Receiving, Stream, StreamOptions, Topic};

/// The frames of a stream, the newest when one is asked for; an iterator that waits for the next. It ends when the session is
/// closed.
#[derive(Debug)]
pub struct Frames {
    watch: session::Watch,
    runtime: Arc<Runtime>,
}

impl Robot {
    /// A stream of which the newest frame counts.
    ///
    /// ```no_run
    /// # fn streamed(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// let distance = robot.stream("distance", rect::StreamOptions::sensor())?;
    /// distance.send([12, 34])?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// As [`crate::Robot::stream`].
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

    /// Watches a robot's stream: the newest frame waits until it is taken.
    ///
    /// ```no_run
    /// # fn watched(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// for frame in robot.watch("wombat-2", "camera")? {
    ///     println!("frame {}, {:?} old, after {} others", frame.number, frame.age, frame.skipped);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// As [`crate::Robot::watch`].
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

    /// The same, with a say in how frames wait.
    ///
    /// # Errors
    /// As [`crate::Robot::watch_with`].
    pub fn watch_with<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        receiving: Receiving,
    ) -> Result<Frames, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let watched = self.robot.watch_with(robot, topic, receiving);
        let watch = self.runtime.wait(watched)?;
        Ok(self.frames(watch))
    }

    fn frames(&self, watch: session::Watch) -> Frames {
        let runtime = self.runtime.clone();
        Frames { watch, runtime }
    }
}

impl Frames {
    /// The next frame; `None`: there was none within that time, or the session was closed.
    pub fn next_within(&mut self, time: Duration) -> Option<Frame> {
        let next = async { timeout(time, self.watch.recv()).await };
        self.runtime.wait(next).ok().flatten()
    }

    /// What a small message takes to the sender and back, once it has answered one.
    pub fn round_trip(&self) -> Option<Duration> {
        self.watch.round_trip()
    }
}

impl Iterator for Frames {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        self.runtime.wait(self.watch.recv())
    }
}

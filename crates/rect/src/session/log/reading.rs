//! Reads the logs of robots.
use std::{fmt, sync::Arc, time::Duration};

use rect_core::{
    log::{
        level::Level,
        reader::{Item, LogReader, Reading},
    },
    message::queue::{Queue, WhenFull},
    name::Name,
};

use super::super::{
    executor::{Executor, Running},
    receive_queue::ReceiveQueue,
    robot::Robot,
};
use crate::error::{valid, Error};

/// The number of items that wait for the program; beyond it the oldest ones are dropped.
const CAPACITY: usize = 1024;
/// The name that stands for all robots.
const ALL: &str = "*";

/// Which lines [`Robot::logs`] reads.
#[derive(Clone, Debug, Default)]
pub struct LogOptions(Reading);

/// Receives the lines of logs; created by [`Robot::logs`]. Dropping it ends the reading.
pub struct Logs {
    queue: Arc<ReceiveQueue<Item>>,
    _running: Running<LogReader>,
}

impl LogOptions {
    /// Selects the last 100 lines of all programs and levels.
    pub fn new() -> Self {
        Self::default()
    }

    /// Selects one program.
    #[must_use]
    pub fn program(mut self, program: Name) -> Self {
        self.0.program = Some(program);
        self
    }

    /// Selects this level and more important ones. Default: all.
    #[must_use]
    pub fn level(mut self, level: Level) -> Self {
        self.0.level = level;
        self
    }

    /// Selects the last lines of each robot, 10,000 at most. Default: 100.
    #[must_use]
    pub fn last(mut self, last: usize) -> Self {
        self.0.last = last;
        self
    }

    /// Continues with new lines until [`Logs`] is dropped. They cross the link, in the background, while somebody follows.
    #[must_use]
    pub fn follow(mut self) -> Self {
        self.0.follow = true;
        self
    }

    /// Leaves out the private lines of the own robot, for a program that passes lines on.
    #[must_use]
    pub fn without_private(mut self) -> Self {
        self.0.without_private = true;
        self
    }

    /// Sets how long the router of a robot may take to answer. Default: 10 s.
    #[must_use]
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.0.timeout = timeout;
        self
    }
}

impl Robot {
    /// Reads the log of a robot, or of all robots (`*`): the last lines, newest ones first in parts, and with
    /// [`LogOptions::follow`] new ones.
    ///
    /// ```no_run
    /// # async fn read(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let logs = robot.logs("wombat-2", rect::LogOptions::new().level(rect::Level::Warn)).await?;
    /// while let Some(item) = logs.next().await {
    ///     println!("{item:?}");
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`] if the name is invalid, and [`Error::Closed`] if the session is closed. A robot that does not answer is none: no
    /// item names it.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn logs(&self, robot: &str, options: LogOptions) -> Result<Logs, Error> {
        let robot = match robot {
            ALL => None,
            name => Some(valid(name)?),
        };
        let reading = Reading { robot, ..options.0 };
        let inner = &self.inner;
        let queue = ReceiveQueue::new(Queue::new(CAPACITY, WhenFull::DropOldest));
        let reader = LogReader::new(inner.place.clone(), reading);
        let executor = Executor::new(&inner.session, reader, queue.clone());
        Ok(Logs {
            queue,
            _running: executor.start(&inner.runtime)?,
        })
    }
}

impl Logs {
    /// Waits for the next lines; returns `None` when all routers have answered, or once the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, nothing is lost: the next call returns it.
    pub async fn next(&self) -> Option<Item> {
        self.queue.pop().await
    }
}

impl Drop for Logs {
    fn drop(&mut self) {
        self.queue.close();
    }
}

impl fmt::Debug for Logs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Logs").finish_non_exhaustive()
    }
}

//! Receives a stream: runs the core's [`StreamWatch`] and passes the frames to the program.
use std::{
    fmt,
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll},
    time::{Duration, Instant},
};

use futures_core::Stream;
use rect_core::{
    message::queue::{Queue, WhenFull},
    name::topic::RobotTopic,
    session::name_check::Used,
    stream::{
        frame::{Frame, ReceivedFrame},
        read::FrameReader,
        watch::StreamWatch,
    },
};

use crate::{
    error::{valid, Error},
    session::{
        executor::{Executor, Running},
        next_item::NextItem,
        receive_queue::ReceiveQueue,
        robot::Robot,
        subscriber::QueueOptions,
    },
};

/// Receives a stream of another robot; created by [`Robot::watch`]. It also implements [`futures_core::Stream`]. Dropping it ends
/// the subscription.
pub struct Watcher {
    arriving: Arc<Arriving>,
    next: NextItem<Frame>,
    running: Running<StreamWatch>,
}

/// The frames that the program has not read.
struct Arriving {
    queue: Arc<ReceiveQueue<ReceivedFrame>>,
    reader: Mutex<FrameReader>,
}

impl Robot {
    /// Receives a stream, `<robot>/<topic>`. Only the newest frame is kept until the program reads it.
    ///
    /// The stream may start later than the watcher, and may stop and start again.
    ///
    /// ```no_run
    /// # async fn watch(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let camera = robot.watch("wombat-2/camera").await?;
    /// while let Some(frame) = camera.next().await {
    ///     println!("frame {}, {:?} old, {} skipped", frame.number, frame.age, frame.skipped);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the robot or topic is invalid, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn watch(
        &self,
        stream: impl TryInto<RobotTopic, Error: Into<Error>>,
    ) -> Result<Watcher, Error> {
        let newest = QueueOptions {
            capacity: 1,
            when_full: WhenFull::DropOldest,
        };
        self.watch_with(stream, newest).await
    }

    /// Receives a stream with other settings of the receive queue, for example to read every value of a
    /// sensor.
    ///
    /// # Errors
    /// Returns the same errors as [`watch`](Self::watch).
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn watch_with(
        &self,
        stream: impl TryInto<RobotTopic, Error: Into<Error>>,
        queue: QueueOptions,
    ) -> Result<Watcher, Error> {
        let stream: RobotTopic = valid(stream)?;
        self.check_name(Used::Stream(stream.clone()));
        let RobotTopic { robot, topic } = stream;
        let inner = &self.inner;
        let queue = ReceiveQueue::new(Queue::new(queue.capacity, queue.when_full));
        let watch = StreamWatch::new(&inner.place, robot, topic, rand::random(), Instant::now());
        let reader = Mutex::new(watch.reader());
        let executor = Executor::new(&inner.session, watch, queue.clone());
        Ok(Watcher {
            arriving: Arc::new(Arriving { queue, reader }),
            next: NextItem::default(),
            running: executor.start(&inner.runtime)?,
        })
    }
}

impl Watcher {
    /// Leaves video undecoded: the payloads are the frames as they were sent, from a key frame on, with the encoding
    /// `video/h264`. A program that saves or forwards them needs them all, and chooses a receive queue with room for many
    /// ([`Robot::watch_with`]).
    #[must_use]
    pub fn undecoded(self) -> Self {
        self.running.driver().leave_undecoded();
        self
    }

    /// Asks the sender of a video for a key frame, with the next frame that arrives: for a program that decodes the video itself
    /// and has dropped frames, or has just begun.
    pub fn ask_for_key_frame(&self) {
        self.running.driver().ask_for_key();
    }

    /// Waits for the next frame, by default the newest one; returns `None` once the session or the watch is closed. Decoding a
    /// frame of a video takes a few milliseconds, during which this call blocks.
    ///
    /// # Cancel safety
    /// If the future is dropped, no frame is lost: the next call returns it. The same holds for the [`Stream`], which keeps its
    /// wait.
    pub async fn next(&self) -> Option<Frame> {
        self.arriving.next().await
    }

    /// Returns the next frame, by default the newest one, if one is queued.
    pub fn try_next(&self) -> Option<Frame> {
        let arriving = &self.arriving;
        std::iter::from_fn(|| arriving.queue.try_pop()).find_map(|received| arriving.read(received))
    }

    /// Stops receiving. Frames that are already queued can still be read.
    pub fn close(&self) {
        self.arriving.queue.close();
    }

    /// Returns the round trip of a small message to the sender; `None` until the first one has been measured.
    pub fn round_trip(&self) -> Option<Duration> {
        self.running.driver().round_trip()
    }
}

impl Arriving {
    async fn next(&self) -> Option<Frame> {
        loop {
            let received = self.queue.pop().await?;
            if let Some(frame) = self.read(received) {
                return Some(frame);
            }
        }
    }

    fn read(&self, received: ReceivedFrame) -> Option<Frame> {
        let mut reader = self.reader.lock().unwrap_or_else(PoisonError::into_inner);
        reader.read(received)
    }
}

impl Stream for Watcher {
    type Item = Frame;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Frame>> {
        let Self { arriving, next, .. } = &mut *self;
        next.poll(context, || {
            let arriving = arriving.clone();
            async move { arriving.next().await }
        })
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        // Closed before undeclaring, which waits for Zenoh's threads: one of them may wait for room in the queue.
        self.close();
    }
}

impl fmt::Debug for Watcher {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let round_trip = self.round_trip();
        f.debug_struct("Watcher")
            .field("round_trip", &round_trip)
            .finish_non_exhaustive()
    }
}

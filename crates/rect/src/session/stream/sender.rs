//! Sends a stream: runs the core's [`StreamPublish`], and encodes the frames that are due.
use std::{
    fmt,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Instant, SystemTime},
};

use rect_core::{
    clock::unix::ms_since_1970,
    codec::picture::Picture,
    message::payload::{Payload, ToPayload},
    name::topic::Topic,
    stream::{
        job::Job, ladder::Step, picture::PictureEncoder, publish::StreamPublish, sender::Options,
        status::Status,
    },
};

use crate::{
    error::{valid, Error},
    session::{
        executor::{Executor, Running},
        robot::Robot,
        shared::NoItems,
    },
};

/// Sends frames of which only the newest matters; created by [`Robot::stream`]. Dropping it ends the stream.
pub struct StreamSender {
    running: Running<StreamPublish>,
    /// Locked while a frame is sent, so that frames are sent in the order of their numbers.
    encoder: Mutex<PictureEncoder>,
}

impl Robot {
    /// Declares a stream of frames of which only the newest matters: a slow link drops older ones.
    ///
    /// An adaptive stream ([`StreamSender::send_picture`], [`StreamSender::send_with`]) adapts size, quality and rate to the throughput
    /// of the link. [`StreamOptions`](crate::StreamOptions) describes the kinds of streams and their limits.
    ///
    /// ```no_run
    /// # async fn stream(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let distance = robot.stream("distance", rect::StreamOptions::sensor()).await?;
    /// distance.send([12, 34])?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the topic is invalid, [`Error::Option`] if an option is out of range, and [`Error::Closed`] if the
    /// session is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn stream(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        options: Options,
    ) -> Result<StreamSender, Error> {
        let inner = &self.inner;
        options.check()?;
        let stream = StreamPublish::new(
            &inner.place,
            &valid(topic)?,
            options,
            self.urgency(),
            rand::random(),
            ms_since_1970(SystemTime::now()),
            Instant::now(),
        );
        let encoder = Mutex::new(PictureEncoder::new(stream.lossy_format()));
        let executor = Executor::new(&inner.session, stream, NoItems);
        Ok(StreamSender {
            running: executor.start(&inner.runtime)?,
            encoder,
        })
    }
}

impl StreamSender {
    /// Sends a frame unchanged to each group of receivers that is due for one, and returns the number of those groups (0 to
    /// 2). Does not wait for the link.
    ///
    /// # Errors
    /// [`Error::Payload`] if the frame cannot be serialized, and [`Error::Closed`] if the session is closed.
    pub fn send(&self, frame: impl ToPayload) -> Result<usize, Error> {
        let payload = frame.to_payload()?;
        let size = payload.bytes.len();
        self.send_with(size, |_| Ok(payload.clone()))
    }

    /// Offers a frame of `pixels` pixels, and returns the number of groups of receivers to which it was sent (0 to 2).
    ///
    /// `pixels` is the size of the uncompressed frame, from which an adaptive stream chooses its step; for frames that
    /// are not pictures, it is the number of bytes.
    ///
    /// `encode` is called once for each group that is due for a frame, and not at all without receivers. It encodes the frame
    /// at the given step; `None` means that the stream is not adaptive and the program chooses. The call takes as long as
    /// `encode` and does not wait for the link; asynchronous programs call it where blocking is permitted.
    ///
    /// # Errors
    /// Returns the error of `encode`, [`Error::Payload`] if the encoding of the frame is too long, and
    /// [`Error::Closed`] if the session is closed.
    pub fn send_with(
        &self,
        pixels: usize,
        mut encode: impl FnMut(Option<Step>) -> Result<Payload, Error>,
    ) -> Result<usize, Error> {
        let _sending = self.encoder();
        let jobs = self.running.driver().offer(pixels, Instant::now());
        self.send_jobs(&jobs, |job| encode(job.step))
    }

    /// Sends a picture with RECT's codecs, at a size and quality that fit the throughput of the link. Returns the number of
    /// groups of receivers to which it was sent (0 to 2), and blocks as [`send_with`](Self::send_with) does.
    ///
    /// ```no_run
    /// # fn send(stream: rect::StreamSender, picture: rect::Picture) -> Result<(), rect::Error> {
    /// stream.send_picture(&picture)?;
    /// println!("{:?}", stream.status());
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Codec`] if the picture cannot be encoded, and [`Error::Closed`] if the session is closed.
    pub fn send_picture(&self, picture: &Picture) -> Result<usize, Error> {
        let mut encoder = self.encoder();
        let (width, height) = (picture.width(), picture.height());
        let jobs = self
            .running
            .driver()
            .offer_picture(width, height, Instant::now());
        self.send_jobs(&jobs, |job| {
            Ok(encoder.encode(picture, job, Instant::now())?)
        })
    }

    fn encoder(&self) -> MutexGuard<'_, PictureEncoder> {
        self.encoder.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn send_jobs(
        &self,
        jobs: &[Job],
        mut encode: impl FnMut(Job) -> Result<Payload, Error>,
    ) -> Result<usize, Error> {
        if self.running.has_ended() {
            return Err(Error::Closed);
        }
        for &job in jobs {
            let payload = encode(job)?.sendable()?;
            let frame = self.running.driver().frame(job, payload, Instant::now());
            self.running.act(frame)?;
        }
        Ok(jobs.len())
    }

    /// Returns the current rate, throughput and step of each group, with the reason for the choice.
    pub fn status(&self) -> Status {
        self.running.driver().status()
    }
}

impl fmt::Debug for StreamSender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StreamSender({})", self.running.driver().notice_key())
    }
}

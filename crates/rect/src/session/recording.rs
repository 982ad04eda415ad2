//! Records the messages that a program receives, with its events, the state of its router's links, the requests to its robot, and the
//! lines that programs log.
use std::{
    path::PathBuf,
    sync::Arc,
    time::{Duration, Instant},
};

use rect_core::{
    message::{encoding::Encoding, payload::Payload, urgency::Urgency},
    name::topic::Pattern,
};
use rect_recording::{
    file, key_frames::KeyFrames, log_recorder::LogRecorder, recorder::CAPACITY,
    report::LINKS_EVERY, Progress, Recorder, Settings, Split,
};
use tokio::{
    task::JoinSet,
    time::{interval, MissedTickBehavior},
};
use zenoh::{
    bytes::ZBytes,
    query::{Query, Queryable},
    Wait,
};

use super::{
    executor::{Executor, Running},
    queries,
    recorded::RecordingQueries,
    robot::Robot,
    shared::NoItems,
    Events, QueueOptions, Subscriber,
};
use crate::error::Error;

/// The settings of [`Robot::record`].
#[derive(Clone, Debug, Default)]
pub struct RecordOptions {
    /// The messages; a message that matches several patterns is recorded once. Default: everything that the programs of this robot
    /// publish, and everything that they send to one robot or that is sent to this one. Messages of other robots travel over the
    /// links to this robot only because they are recorded.
    pub patterns: Vec<Pattern>,
    /// How much of the past to keep; default: everything.
    pub keep: Option<Duration>,
    /// When the recording continues in another file; default: never.
    pub split: Split,
    /// Whether to leave out the lines that the programs of the recorded robots log. Default: they are recorded. Those of other
    /// robots travel over the links, in the background, only because they are recorded; private ones never are.
    pub without_logs: bool,
}

/// A recording that runs; created by [`Robot::record`]. Dropping it leaves a folder, which `rect recording merge` makes a file of.
pub struct RobotRecorder {
    recorder: Arc<Recorder>,
    subscriber: Arc<Subscriber>,
    messages: JoinSet<()>,
    reports: JoinSet<()>,
    logs: Vec<Running<LogRecorder>>,
    requests: Queryable<()>,
    queries: RecordingQueries,
}

impl Robot {
    /// Records messages to an MCAP file until [`finish`](RobotRecorder::finish) is called, with the events of this robot, the
    /// requests to its services, the lines that programs log and, once a second, the state of its router's links. Of a stream, the
    /// frames of the faster group of receivers are, and the sender of a video is asked for a key frame at the beginning and every 5 s.
    ///
    /// Recording never delays the program: what a slow or full disk does not take waits in 8 MB of memory, and is then dropped and
    /// counted, urgent messages last.
    ///
    /// While it runs, other robots can ask for a part of it ([`recorded`](Self::recorded)), and stock Zenoh programs, too
    /// (docs/how-to/record.md).
    ///
    /// ```no_run
    /// # async fn record(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let recorder = robot.record("match.mcap", rect::RecordOptions::default()).await?;
    /// // The match.
    /// let (files, progress) = recorder.finish().await?;
    /// println!("{files:?}: {} messages", progress.written);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Recording`] if there is a recording of that name, or the folder cannot be written; [`Error::Closed`] if the session
    /// is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn record(
        &self,
        path: impl Into<PathBuf>,
        options: RecordOptions,
    ) -> Result<RobotRecorder, Error> {
        let place = &self.inner.place;
        let recorder = Arc::new(Recorder::start(Settings {
            path: path.into(),
            about: file::about(place, &options.patterns),
            keep: options.keep,
            split: options.split,
        })?);
        let queue = QueueOptions {
            capacity: CAPACITY,
            ..QueueOptions::default()
        };
        let subscriber = Arc::new(self.select(place.recorded(&options.patterns), queue)?);
        let (mut messages, mut reports) = (JoinSet::new(), JoinSet::new());
        let logs = match options.without_logs {
            true => Vec::new(),
            false => LogRecorder::of_recording(place, &options.patterns, &recorder),
        };
        let logs = logs.into_iter().map(|log| {
            let executor = Executor::new(&self.inner.session, log, NoItems);
            executor.start(&self.inner.runtime)
        });
        let logs = logs.collect::<Result<_, _>>()?;
        messages.spawn(forward(subscriber.clone(), self.clone(), recorder.clone()));
        let events = self.events().await?;
        let events = forward_events(events, self.clone(), recorder.clone());
        reports.spawn(events);
        if !self.inner.direct {
            let links = record_links(self.clone(), recorder.clone());
            reports.spawn(links);
        }
        let requests = record_requests(self, &recorder)?;
        let queries = RecordingQueries::start(self, &recorder)?;
        Ok(RobotRecorder {
            recorder,
            requests,
            queries,
            subscriber,
            messages,
            reports,
            logs,
        })
    }
}

impl RobotRecorder {
    /// Returns what is recorded, for people: the patterns, or what is recorded without patterns.
    pub fn patterns(&self) -> &str {
        file::patterns(self.recorder.about())
    }

    /// Returns how the recording goes.
    pub fn progress(&self) -> Progress {
        let mut progress = self.recorder.progress();
        progress.dropped += self.subscriber.dropped();
        progress
    }

    /// Waits until the session has ended.
    ///
    /// # Cancel safety
    /// Dropping the future ends the wait. Nothing else changes.
    pub async fn ended(&mut self) {
        while self.messages.join_next().await.is_some() {}
    }

    /// Stops, and makes one file of the recording, or several if it is split; none if nothing was recorded. Returns the files.
    ///
    /// # Errors
    /// [`Error::Recording`] if the disk fails; then the folder remains, and can be read.
    ///
    /// # Cancel safety
    /// If the future is dropped, recording has stopped, but there may be no single file yet: the folder of the
    /// recording remains, and `rect recording merge` makes a file of it.
    pub async fn finish(mut self) -> Result<(Vec<PathBuf>, Progress), Error> {
        self.logs.clear();
        self.reports.shutdown().await;
        self.subscriber.close();
        // Until what has arrived is recorded.
        self.ended().await;
        let unread = self.subscriber.dropped();
        drop(self.requests);
        self.queries.close().await;
        let recorder = self.recorder;
        let finished = tokio::task::spawn_blocking(move || recorder.finish());
        let (files, mut progress) = finished.await.map_err(|_| Error::Closed)??;
        progress.dropped += unread;
        Ok((files, progress))
    }
}

async fn forward(subscriber: Arc<Subscriber>, robot: Robot, recorder: Arc<Recorder>) {
    let mut videos = KeyFrames::new(robot.inner.place.clone());
    while let Some(message) = subscriber.next().await {
        if let Some(request) = videos.on_message(&message, Instant::now()) {
            let payload = Payload::new(request.bytes, Encoding::BYTES);
            let qos = Urgency::Normal.qos().drop_when_congested();
            if let Err(error) = queries::put_once(&robot.inner.session, &request.key, payload, qos)
            {
                tracing::warn!("cannot ask for a key frame: {error}");
            }
        }
        recorder.on_message(message);
    }
}

async fn forward_events(events: Events, robot: Robot, recorder: Arc<Recorder>) {
    while let Some(event) = events.next().await {
        recorder.on_event(robot.name(), (&event).into());
    }
}

/// Records the requests to the services of the robot, beside those that answer: a request is sent to all programs that declare
/// its key.
fn record_requests(robot: &Robot, recorder: &Arc<Recorder>) -> Result<Queryable<()>, Error> {
    let inner = &robot.inner;
    let place = inner.place.clone();
    let recorder = Arc::downgrade(recorder);
    let on_query = move |query: Query| {
        if let Some(recorder) = recorder.upgrade() {
            let attachment = query.attachment().map(ZBytes::to_bytes);
            let key = query.key_expr().as_str();
            let payload = queries::payload_of(&query);
            recorder.on_request(&place, key, attachment.as_deref(), &payload);
        }
    };
    let declared = inner.session.declare_queryable(inner.place.services());
    let declared = declared.complete(false).callback(on_query).wait();
    declared.map_err(Error::zenoh("cannot record requests"))
}

async fn record_links(robot: Robot, recorder: Arc<Recorder>) {
    let mut ticks = interval(LINKS_EVERY);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        match robot.connections().await {
            Ok(connections) => recorder.on_connections(robot.name(), &connections),
            // A router without the registry, such as a stock zenohd, has nothing to report.
            Err(Error::NoService { .. } | Error::Closed) => return,
            // The router is busy or restarts.
            Err(_) => {}
        }
    }
}

impl std::fmt::Debug for RobotRecorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RobotRecorder")
            .field("progress", &self.progress())
            .finish_non_exhaustive()
    }
}

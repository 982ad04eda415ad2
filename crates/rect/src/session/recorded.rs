//! Answers queries for the recording that a program makes, and asks the recorders of other robots.
use std::{
    fmt,
    sync::Arc,
    time::{Duration, UNIX_EPOCH},
};

use rect_core::{
    driver,
    message::request::{error_from_payload, is_timeout},
    name::Name,
};
use rect_recording::{
    answer::{busy, key, Answer, FORM, MCAP, WAITING},
    excerpt::Excerpt,
    file::About,
    Entry, Recorder, RecorderError,
};
use tokio::{sync::mpsc, task::JoinHandle, time::timeout};
use zenoh::{
    query::{
        ConsolidationMode, Query, QueryTarget, Queryable, ReplyError, ReplyKeyExpr, TimeBound,
        TimeRange,
    },
    time::{Timestamp, TimestampId, NTP64},
    Wait,
};

use super::{convert, queries, robot::Robot};
use crate::error::{valid, Error};

/// How long the end of a recording waits for the answer that is being sent.
const SENT_WITHIN: Duration = Duration::from_secs(2);
/// How long an answer may take.
const TIMEOUT: Duration = Duration::from_secs(15);

/// Answers queries for a recording, until it is closed.
pub(super) struct RecordingQueries {
    queryable: Queryable<()>,
    task: JoinHandle<()>,
}

impl RecordingQueries {
    /// Begins to answer.
    pub(super) fn start(robot: &Robot, recorder: &Arc<Recorder>) -> Result<Self, Error> {
        let inner = &robot.inner;
        let place = Arc::new(inner.place.clone());
        let own = key(&place, &place.robot);
        let asked_at = place.clone();
        let (queue, mut waiting) = mpsc::channel::<Query>(WAITING);
        let on_query = move |query: Query| {
            if let Err(mpsc::error::TrySendError::Full(query)) = queue.try_send(query) {
                queries::answer(&query, driver::Answer::Error(busy(&asked_at)));
            }
        };
        let declared = inner.session.declare_queryable(format!("{own}/**"));
        let queryable = declared
            .complete(true)
            .callback(on_query)
            .wait()
            .map_err(Error::zenoh("cannot offer the recording"))?;
        let id = TimestampId::from(inner.session.zid());
        // A recording also ends while answers wait for a slow link.
        let recorder = Arc::downgrade(recorder);
        let task = inner.runtime.spawn(async move {
            while let Some(query) = waiting.recv().await {
                let Some(recorder) = recorder.upgrade() else {
                    return;
                };
                let place = place.clone();
                // Reading takes time, and so does a slow link.
                let answered = tokio::task::spawn_blocking(move || {
                    let asked = query.key_expr().as_str();
                    let parameters = query.parameters().as_str();
                    let answer = Answer::to(asked, parameters, &recorder, &place);
                    drop(recorder);
                    send(&query, answer, id);
                });
                if let Err(error) = answered.await {
                    tracing::warn!("a question about the recording was not answered: {error}");
                }
            }
        });
        Ok(Self { queryable, task })
    }

    /// Stops, after the answer that is being sent, unless that takes too long.
    pub(super) async fn close(self) {
        drop(self.queryable);
        // The task cannot panic, and may continue.
        let _ = timeout(SENT_WITHIN, self.task).await;
    }
}

fn send(query: &Query, answer: Answer, id: TimestampId) {
    let sent = answer.replies.into_iter().try_for_each(|reply| {
        let time = reply
            .recorded
            .map(|time| Timestamp::new(NTP64::from(time), id));
        let encoding = reply.payload.encoding;
        let reply = query.reply(reply.key, reply.payload.bytes);
        reply.encoding(encoding.as_str()).timestamp(time).wait()
    });
    match (sent, answer.error) {
        (Err(error), _) => tracing::debug!("cannot reply on {}: {error}", query.key_expr()),
        (Ok(()), Some(error)) => queries::answer(query, driver::Answer::Error(error)),
        (Ok(()), None) => {}
    }
}

/// Reads the recording that another robot makes, a part at a time; created by [`Robot::recorded`].
pub struct Recorded {
    robot: Robot,
    recorder: Name,
    topics: String,
    /// The time that is left, in Zenoh's notation.
    time: String,
    about: About,
    /// The time of the last message that was read.
    newest: Option<Duration>,
    is_complete: bool,
}

impl Robot {
    /// Reads from the recording that a program of `robot` makes, or `rect record` there. `topics` selects `<robot>/<topic>`, such
    /// as `wombat-2/arm/*`, and `**` also events and links. `time` is a range in Zenoh's notation, such as `[now(-10s)..]`.
    ///
    /// ```no_run
    /// # async fn read(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let mut recorded = robot.recorded("wombat-2", "**", "[now(-10s)..]")?;
    /// while let Some(entries) = recorded.next().await? {
    ///     for entry in entries {
    ///         println!("{}: {:?}", entry.topic, entry.payload);
    ///     }
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`] if `robot` is not a valid name.
    pub fn recorded(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topics: &str,
        time: &str,
    ) -> Result<Recorded, Error> {
        Ok(Recorded {
            robot: self.clone(),
            recorder: valid(robot)?,
            topics: topics.to_owned(),
            time: time.to_owned(),
            about: About::new(),
            newest: None,
            is_complete: false,
        })
    }
}

impl Recorded {
    /// Returns the description of the recording, once a part has been read.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Returns the next messages, in the order of recording; `None` at the end. After an error, a further call continues at the
    /// same place.
    ///
    /// # Errors
    /// [`Error::NoService`] if no program of the robot records, [`Error::Service`] if the recorder rejects the question,
    /// [`Error::TimedOut`] if no answer arrives within 15 s, [`Error::Recording`] if the answer is damaged, and
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, no message is lost: the next call asks for the same part again.
    pub async fn next(&mut self) -> Result<Option<Vec<Entry>>, Error> {
        if self.is_complete {
            return Ok(None);
        }
        let inner = &self.robot.inner;
        let own = key(&inner.place, &self.recorder);
        let selector = format!("{own}/{}?_time={};{FORM}={MCAP}", self.topics, self.time);
        let replies = inner
            .session
            .get(selector)
            .target(QueryTarget::BestMatching)
            .consolidation(ConsolidationMode::None)
            .accept_replies(ReplyKeyExpr::Any)
            .timeout(TIMEOUT)
            .await
            .map_err(Error::zenoh("cannot ask for the recording"))?;
        let Ok(reply) = replies.recv_async().await else {
            let service = "recording (`rect record`)".to_owned();
            let recorder = self.recorder.clone();
            return Err(self.robot.no_service(Some(recorder), service).await);
        };
        let sample = reply.into_result().map_err(|error| self.failure(&error))?;
        let bytes = sample.payload().to_bytes().into_owned();
        let (excerpt, about, until) = Excerpt::decode(bytes).map_err(RecorderError::from)?;
        self.about = about;
        match excerpt.entries.last() {
            // A recorder that sends the same part again and again is not asked for ever.
            Some(last) if excerpt.more && self.newest < Some(last.logged) => {
                self.newest = Some(last.logged);
                let range = TimeRange {
                    start: TimeBound::Exclusive(UNIX_EPOCH + last.logged),
                    end: TimeBound::Inclusive(UNIX_EPOCH + until),
                };
                self.time = range.to_string();
            }
            _ => self.is_complete = true,
        }
        Ok(Some(excerpt.entries))
    }

    fn failure(&self, error: &ReplyError) -> Error {
        let payload = convert::payload(error.payload(), error.encoding());
        let (robot, payload) = error_from_payload(payload);
        if is_timeout(robot.as_ref(), &payload) {
            return Error::TimedOut {
                expected: format!("part of the recording of {}", self.recorder),
                timeout: TIMEOUT,
            };
        }
        Error::Service {
            robot: Some(self.recorder.clone()),
            payload,
        }
    }
}

impl fmt::Debug for Recorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Recorded")
            .field("recorder", &self.recorder)
            .field("time", &self.time)
            .finish_non_exhaustive()
    }
}

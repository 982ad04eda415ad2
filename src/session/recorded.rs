//! Answers queries for the recording that a program makes, and asks the recorders of other robots.
use std::{
    fmt,
    sync::{Arc, Weak},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use tokio::{sync::mpsc, task::JoinHandle, time::timeout};
use zenoh::{
    query::{
        ConsolidationMode, Query, QueryTarget, Queryable, ReplyError, ReplyKeyExpr, TimeBound,
        TimeRange, ZenohParameters,
    },
    time::{Timestamp, TimestampId, NTP64},
    Wait,
};
use zenoh_keyexpr::OwnedKeyExpr;

use super::{convert, queries, robot::Robot};
use crate::{
    core::{
        driver::Answer,
        encoding::Encoding,
        name::Name,
        payload::Payload,
        request::{error_from_payload, error_to_payload, is_timeout},
    },
    error::Error,
    recording::{
        excerpt::{Excerpt, Question},
        file::About,
        Entry, Recorder, RecorderError,
    },
};

/// The part of RECT's internal keys under which a recorder answers. The key expression behind it selects `<robot>/<topic>`.
const RECORDING: &str = "recording";
/// Selects all messages.
const ALL: &str = "**";
/// The parameter for an answer in one file.
const FORM: &str = "form";
const MCAP: &str = "mcap";
/// The number of queries that wait at most. Further ones are refused.
const WAITING: usize = 8;
/// The size of the messages in one answer, in bytes, so that it takes about a second over Bluetooth.
const PAGE_BYTES: usize = 64 * 1024;
/// The largest number of messages that are sent one by one.
const MAX_MESSAGES: usize = 1000;
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
        let own = inner.place.own(Some(&inner.place.robot), RECORDING);
        let (queue, mut waiting) = mpsc::channel::<Query>(WAITING);
        let me = inner.place.robot.clone();
        let on_query = move |query: Query| {
            if let Err(mpsc::error::TrySendError::Full(query)) = queue.try_send(query) {
                refuse(
                    &query,
                    &me,
                    "too many questions about the recording at once: try again",
                );
            }
        };
        let declared = inner.session.declare_queryable(format!("{own}/**"));
        let queryable = declared
            .complete(true)
            .callback(on_query)
            .wait()
            .map_err(Error::zenoh("cannot offer the recording"))?;
        let answering = Answering {
            id: inner.session.zid().into(),
            me: inner.place.robot.clone(),
            own,
            // The recorder is finished by its only owner.
            recorder: Arc::downgrade(recorder),
        };
        let task = inner.runtime.spawn(async move {
            let answering = Arc::new(answering);
            while let Some(query) = waiting.recv().await {
                let answering = answering.clone();
                // Reading takes time, and so does a slow link.
                let answered = tokio::task::spawn_blocking(move || answering.answer(&query));
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

struct Answering {
    id: TimestampId,
    me: Name,
    /// The key under which the recording is.
    own: String,
    recorder: Weak<Recorder>,
}

impl Answering {
    fn answer(&self, query: &Query) {
        if let Err(problem) = self.reply(query) {
            refuse(query, &self.me, &problem);
        }
    }

    fn reply(&self, query: &Query) -> Result<(), String> {
        // Not kept while the answer is sent: a recording ends also if a link stands still.
        let recorder = self.recorder.upgrade();
        let recorder = recorder.ok_or("the recording has ended")?;
        let (question, is_file) = self.question(query, recorder.now())?;
        let max_count = if is_file { usize::MAX } else { MAX_MESSAGES };
        let excerpt = Excerpt::read(&recorder.readable(), &question, PAGE_BYTES, max_count);
        let about = recorder.about().clone();
        drop(recorder);
        let excerpt = excerpt.map_err(text)?;
        if is_file {
            let file = excerpt.encode(about, question.until).map_err(text)?;
            let reply = query.reply(&self.own, file);
            return reply.encoding("application/mcap").wait().map_err(text);
        }
        for entry in excerpt.entries {
            self.send(query, entry)?;
        }
        match excerpt.more {
            false => Ok(()),
            true => Err(format!(
                "more messages follow: at most {MAX_MESSAGES} or {PAGE_BYTES} bytes are sent at once; ask for a shorter time, or \
                 use `rect recording fetch {}`",
                self.me
            )),
        }
    }

    fn send(&self, query: &Query, entry: Entry) -> Result<(), String> {
        let time = Timestamp::new(NTP64::from(entry.logged), self.id);
        let reply = query.reply(format!("{}/{}", self.own, entry.topic), entry.payload.bytes);
        let reply = reply.encoding(entry.payload.encoding.as_str());
        reply.timestamp(time).wait().map_err(text)
    }

    /// Returns the selected messages, and whether they are to be sent as a file.
    fn question(&self, query: &Query, now: Duration) -> Result<(Question, bool), String> {
        let key = query.key_expr().as_str();
        let topics = key.strip_prefix(self.own.as_str());
        // A wildcard in the robot's name: the rest has no wildcards before the internal keys.
        let topics = topics.or_else(|| {
            key.split_once(&format!("@rect/{RECORDING}"))
                .map(|(_, rest)| rest)
        });
        let topics = topics.unwrap_or_default().trim_start_matches('/');
        let topics = if topics.is_empty() { ALL } else { topics };
        let mut is_file = false;
        for (name, value) in query.parameters().iter() {
            match (name, value) {
                (FORM, MCAP) => is_file = true,
                (FORM, _) => return Err(format!("{FORM} is {MCAP}, or is left out")),
                (name, _) if name.is_empty() || name.starts_with('_') => {}
                (name, _) => {
                    return Err(format!("`{name}` is unknown; known are _time and {FORM}"))
                }
            }
        }
        let range = query.parameters().time_range();
        let range = range.ok_or("name the time, such as _time=[now(-10s)..]")?;
        let at = UNIX_EPOCH + now;
        let range = range.map_err(text)?.resolve_at(at);
        let step = Duration::from_nanos(1);
        let begin = match range.start {
            TimeBound::Inclusive(time) => since_1970(time),
            TimeBound::Exclusive(time) => since_1970(time) + step,
            TimeBound::Unbounded => Duration::ZERO,
        };
        let until = match range.end {
            TimeBound::Inclusive(time) => since_1970(time),
            TimeBound::Exclusive(time) => since_1970(time).saturating_sub(step),
            TimeBound::Unbounded => now,
        };
        let question = Question {
            topics: OwnedKeyExpr::new(topics).map_err(text)?,
            // They have keys of RECT's own, which a stock program has not asked for.
            reports: is_file && topics == ALL,
            begin,
            until,
        };
        Ok((question, is_file))
    }
}

fn since_1970(time: SystemTime) -> Duration {
    time.duration_since(UNIX_EPOCH).unwrap_or_default()
}

fn text(error: impl fmt::Display) -> String {
    error.to_string()
}

fn refuse(query: &Query, me: &Name, problem: &str) {
    let error = error_to_payload(me, Payload::new(problem.to_owned(), Encoding::TEXT));
    queries::answer(query, Answer::Error(error));
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
    pub fn recorded<N: TryInto<Name>>(
        &self,
        robot: N,
        topics: &str,
        time: &str,
    ) -> Result<Recorded, Error>
    where
        Error: From<N::Error>,
    {
        Ok(Recorded {
            robot: self.clone(),
            recorder: robot.try_into()?,
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
    pub async fn next(&mut self) -> Result<Option<Vec<Entry>>, Error> {
        if self.is_complete {
            return Ok(None);
        }
        let inner = &self.robot.inner;
        let own = inner.place.own(Some(&self.recorder), RECORDING);
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
            let service = format!("{RECORDING} (`rect record`)");
            let recorder = self.recorder.to_string();
            return Err(self.robot.no_service(recorder, service).await);
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

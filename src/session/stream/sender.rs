//! Owns the sending end of a stream: it puts the frames that are wanted, and hears what receivers say.
use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use tokio::{sync::Notify, task::JoinHandle};
use zenoh::{
    bytes::Encoding,
    matching::MatchingListener,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    query::{Query, Queryable},
    sample::Sample,
    Session, Wait,
};

use crate::{
    core::{
        key::Place,
        payload::{Payload, ToPayload},
        picture::Picture,
        stream::{
            feedback::Feedback,
            feedback_from, feedback_keys,
            ladder::Level,
            notice_key,
            picture::{encode, Photographs},
            sender::{Job, Options, Sender},
            status::Status,
            Group,
        },
        topic::Topic,
        urgency::Urgency,
    },
    error::Error,
    session::{
        publication::{now_ms, priority},
        robot::Robot,
    },
};

/// A stream that this program sends. It ends when this is dropped.
pub struct Stream {
    shared: Arc<Shared>,
    photographs: Photographs,
    /// One frame at a time: they go out in the order of their numbers.
    sending: Mutex<[Publisher<'static>; 2]>,
    task: JoinHandle<()>,
    _declared: (Subscriber<()>, Queryable<()>, [MatchingListener<()>; 2]),
}

struct Shared {
    core: Mutex<Sender>,
    /// A receiver has said something.
    heard: Notify,
    notice_key: String,
}

impl Robot {
    /// A stream of which the newest frame counts: what is old, a slow link drops. An adaptive one
    /// ([`Stream::send_with`]) fits its frames to what gets through; see [`Options`] for the others.
    ///
    /// ```no_run
    /// # async fn streamed(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let distance = robot.stream("distance", rect::StreamOptions::sensor()).await?;
    /// distance.send([12, 34])?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`]; [`Error::Zenoh`] when the session is closed.
    pub async fn stream<T: TryInto<Topic>>(
        &self,
        topic: T,
        options: Options,
    ) -> Result<Stream, Error>
    where
        Error: From<T::Error>,
    {
        let inner = &self.inner;
        let topic = topic.try_into()?;
        let _entered = inner.runtime.enter();
        Stream::declare(
            &inner.session,
            &inner.place,
            &topic,
            options,
            self.urgency(),
        )
    }
}

impl Stream {
    fn declare(
        session: &Session,
        place: &Place,
        topic: &Topic,
        options: Options,
        urgency: Urgency,
    ) -> Result<Self, Error> {
        let photographs = options.photographs;
        let sender = Sender::new(options, rand::random(), now_ms(), Instant::now());
        let shared = Arc::new(Shared {
            core: Mutex::new(sender),
            heard: Notify::new(),
            notice_key: notice_key(place, topic),
        });
        let [main, slow] = Group::ALL;
        let (main, main_matched) = frames(session, place, topic, urgency, main, &shared)?;
        let (slow, slow_matched) = frames(session, place, topic, urgency, slow, &shared)?;
        let subscriber = session
            .declare_subscriber(feedback_keys(place, topic))
            .callback({
                let (shared, place) = (shared.clone(), place.clone());
                move |sample| shared.on_feedback(&place, &sample)
            })
            .wait()
            .map_err(Error::zenoh("the stream can't hear its receivers"))?;
        let queryable = session
            .declare_queryable(shared.notice_key.clone())
            .complete(true)
            .callback({
                let shared = shared.clone();
                move |query| shared.on_question(&query)
            })
            .wait()
            .map_err(Error::zenoh("the stream can't tell of itself"))?;
        let task = tokio::spawn(tell_changes(session.clone(), shared.clone()));
        Ok(Self {
            shared,
            photographs,
            sending: Mutex::new([main, slow]),
            task,
            _declared: (subscriber, queryable, [main_matched, slow_matched]),
        })
    }

    /// Sends a frame as it is, if anyone wants one now; how many groups it went to. Does not wait for the link.
    ///
    /// # Errors
    /// [`Error::Payload`]; [`Error::Zenoh`] when the session is closed.
    pub fn send(&self, frame: impl ToPayload) -> Result<usize, Error> {
        let payload = frame.to_payload()?;
        let size = payload.bytes.len();
        self.send_with(size, |_| Ok(payload.clone()))
    }

    /// There is a frame of so many pixels: `encode` writes it at the level that is wanted (`None`: as the program likes),
    /// once for each group that gets one now, and not at all where nobody does. To how many it went. Takes as long as
    /// `encode`, and does not wait for the link: in async code, call it where blocking is allowed.
    ///
    /// # Errors
    /// What `encode` returns; [`Error::Zenoh`] when the session is closed.
    pub fn send_with(
        &self,
        pixels: usize,
        mut encode: impl FnMut(Option<Level>) -> Result<Payload, Error>,
    ) -> Result<usize, Error> {
        let publishers = self.sending.lock().unwrap_or_else(PoisonError::into_inner);
        let jobs = self.shared.core().offer(pixels, Instant::now());
        for job in &jobs {
            self.put(&publishers, *job, encode(job.level)?)?;
        }
        Ok(jobs.len())
    }

    /// Sends a picture, at the size and quality that get through; for [`send_with`](Self::send_with) with RECT's codecs.
    ///
    /// # Errors
    /// [`Error::Codec`]; [`Error::Zenoh`] when the session is closed.
    pub fn send_picture(&self, picture: &Picture) -> Result<usize, Error> {
        let pixels = picture.width() as usize * picture.height() as usize;
        self.send_with(pixels, |level| {
            Ok(encode(picture, level, self.photographs)?)
        })
    }

    /// What goes out, what gets through, and why it is as it is.
    pub fn status(&self) -> Status {
        self.shared.core().status()
    }

    fn put(
        &self,
        publishers: &[Publisher<'static>; 2],
        job: Job,
        payload: Payload,
    ) -> Result<(), Error> {
        let payload = payload.sendable()?;
        let attachment = self
            .shared
            .core()
            .on_encoded(job, payload.bytes.len(), Instant::now());
        let [main, slow] = publishers;
        let publisher = match job.group {
            Group::Main => main,
            Group::Slow => slow,
        };
        let put = publisher.put(payload.bytes);
        let put = put
            .encoding(Encoding::from(payload.encoding.as_str()))
            .attachment(attachment.encode());
        put.wait().map_err(Error::zenoh("the frame is not sent"))
    }
}

/// What puts a group's frames, and what knows whether anyone wants them.
fn frames(
    session: &Session,
    place: &Place,
    topic: &Topic,
    urgency: Urgency,
    group: Group,
    shared: &Arc<Shared>,
) -> Result<(Publisher<'static>, MatchingListener<()>), Error> {
    let qos = urgency.qos().newest_wins();
    let refused = || Error::zenoh("the stream is refused");
    let publisher = session
        .declare_publisher(group.key(place, topic))
        .priority(priority(qos))
        .express(qos.express)
        .congestion_control(CongestionControl::Drop)
        .wait()
        .map_err(refused())?;
    let listener = publisher
        .matching_listener()
        .callback({
            let shared = shared.clone();
            move |status| shared.core().on_subscribers(group, status.matching())
        })
        .wait()
        .map_err(refused())?;
    let status = publisher.matching_status().wait().map_err(refused())?;
    shared.core().on_subscribers(group, status.matching());
    Ok((publisher, listener))
}

/// Who is to listen elsewhere is told, reliably.
async fn tell_changes(session: Session, shared: Arc<Shared>) {
    loop {
        shared.heard.notified().await;
        let notice = shared.core().poll_notice(Instant::now());
        if let Some(notice) = notice {
            let put = session.put(&shared.notice_key, notice.encode());
            let put = put
                .encoding(Encoding::APPLICATION_JSON)
                .congestion_control(CongestionControl::Block);
            if let Err(error) = put.await {
                tracing::debug!("{} is not told any more: {error}", shared.notice_key);
                return;
            }
        }
    }
}

impl Shared {
    fn core(&self) -> MutexGuard<'_, Sender> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn on_feedback(&self, place: &Place, sample: &Sample) {
        let Some(robot) = feedback_from(place, sample.key_expr().as_str()) else {
            return;
        };
        match Feedback::decode(&sample.payload().to_bytes()) {
            Ok(feedback) => self.core().on_feedback(&robot, &feedback, Instant::now()),
            Err(error) => tracing::debug!("{}: {error}", sample.key_expr()),
        }
        self.heard.notify_one();
    }

    fn on_question(&self, query: &Query) {
        let notice = self.core().notice(Instant::now());
        let reply = query.reply(&self.notice_key, notice.encode());
        if let Err(error) = reply.encoding(Encoding::APPLICATION_JSON).wait() {
            tracing::debug!("{} is not answered: {error}", self.notice_key);
        }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl fmt::Debug for Stream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Stream({})", self.shared.notice_key)
    }
}

//! Sends a stream: publishes the frames of each group that has receivers, processes feedback, and answers queries for the
//! stream's notice.
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
        key::KeySpace,
        payload::{Payload, ToPayload},
        picture::Picture,
        stream::{
            feedback::Feedback,
            feedback_from, feedback_keys,
            ladder::Step,
            notice_key,
            picture::{encode, LossyFormat},
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

/// Sends frames of which only the newest matters; created by [`Robot::stream`]. Dropping it ends the stream.
pub struct Stream {
    shared: Arc<Shared>,
    lossy_format: LossyFormat,
    /// Locked while a frame is sent, so that frames are sent in the order of their numbers.
    sending: Mutex<[Publisher<'static>; 2]>,
    task: JoinHandle<()>,
    _declared: (Subscriber<()>, Queryable<()>, [MatchingListener<()>; 2]),
}

struct Shared {
    core: Mutex<Sender>,
    /// Notified when feedback of a receiver arrives.
    feedback_received: Notify,
    notice_key: String,
}

impl Robot {
    /// Declares a stream of frames of which only the newest matters: a slow link drops older ones.
    ///
    /// An adaptive stream ([`Stream::send_picture`], [`Stream::send_with`]) adapts size, quality and rate to the throughput
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
    /// [`Error::Topic`] if the topic is invalid, and [`Error::Zenoh`] if the session is closed.
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
        place: &KeySpace,
        topic: &Topic,
        options: Options,
        urgency: Urgency,
    ) -> Result<Self, Error> {
        let lossy_format = options.lossy_format;
        let sender = Sender::new(options, rand::random(), now_ms(), Instant::now());
        let shared = Arc::new(Shared {
            core: Mutex::new(sender),
            feedback_received: Notify::new(),
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
            .map_err(Error::zenoh("cannot subscribe to the stream's feedback"))?;
        let queryable = session
            .declare_queryable(shared.notice_key.clone())
            .complete(true)
            .callback({
                let shared = shared.clone();
                move |query| shared.on_query(&query)
            })
            .wait()
            .map_err(Error::zenoh(
                "cannot declare the queryable of the stream's notice",
            ))?;
        let task = tokio::spawn(publish_notices(session.clone(), shared.clone()));
        Ok(Self {
            shared,
            lossy_format,
            sending: Mutex::new([main, slow]),
            task,
            _declared: (subscriber, queryable, [main_matched, slow_matched]),
        })
    }

    /// Sends a frame unchanged to each group of receivers that is due for one, and returns the number of those groups (0 to
    /// 2). Does not wait for the link.
    ///
    /// # Errors
    /// [`Error::Payload`] if the frame cannot be serialized, and [`Error::Zenoh`] if the session is closed.
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
    /// Returns the error of `encode`, [`Error::Payload`] if the encoding of the frame is too long, and [`Error::Zenoh`]
    /// if the session is closed.
    pub fn send_with(
        &self,
        pixels: usize,
        mut encode: impl FnMut(Option<Step>) -> Result<Payload, Error>,
    ) -> Result<usize, Error> {
        let publishers = self.sending.lock().unwrap_or_else(PoisonError::into_inner);
        let jobs = self.shared.core().offer(pixels, Instant::now());
        for job in &jobs {
            self.put(&publishers, *job, encode(job.step)?)?;
        }
        Ok(jobs.len())
    }

    /// Sends a picture with RECT's codecs, at a size and quality that fit the throughput of the link. Returns the number of
    /// groups of receivers to which it was sent (0 to 2), and blocks as [`send_with`](Self::send_with) does.
    ///
    /// ```no_run
    /// # fn send(stream: rect::Stream, picture: rect::core::picture::Picture) -> Result<(), rect::Error> {
    /// stream.send_picture(&picture)?;
    /// println!("{:?}", stream.status());
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Codec`] if the picture cannot be encoded, and [`Error::Zenoh`] if the session is closed.
    pub fn send_picture(&self, picture: &Picture) -> Result<usize, Error> {
        let pixels = picture.width() as usize * picture.height() as usize;
        self.send_with(pixels, |step| Ok(encode(picture, step, self.lossy_format)?))
    }

    /// Returns the current rate, throughput and step of each group, with the reason for the choice.
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
        put.wait().map_err(Error::zenoh("cannot send the frame"))
    }
}

/// Declares the publisher of a group, and the listener that reports whether the group has subscribers.
fn frames(
    session: &Session,
    place: &KeySpace,
    topic: &Topic,
    urgency: Urgency,
    group: Group,
    shared: &Arc<Shared>,
) -> Result<(Publisher<'static>, MatchingListener<()>), Error> {
    let qos = urgency.qos().drop_when_congested();
    let refused = || Error::zenoh("cannot declare the stream's publisher");
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

/// Publishes a notice, reliably, whenever feedback changes the assignment of receivers to groups.
async fn publish_notices(session: Session, shared: Arc<Shared>) {
    loop {
        shared.feedback_received.notified().await;
        let notice = shared.core().poll_notice(Instant::now());
        if let Some(notice) = notice {
            let put = session.put(&shared.notice_key, notice.encode());
            let put = put
                .encoding(Encoding::APPLICATION_JSON)
                .congestion_control(CongestionControl::Block);
            if let Err(error) = put.await {
                tracing::debug!("no more notices on {}: {error}", shared.notice_key);
                return;
            }
        }
    }
}

impl Shared {
    fn core(&self) -> MutexGuard<'_, Sender> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn on_feedback(&self, place: &KeySpace, sample: &Sample) {
        let Some(robot) = feedback_from(place, sample.key_expr().as_str()) else {
            return;
        };
        match Feedback::decode(&sample.payload().to_bytes()) {
            Ok(feedback) => self.core().on_feedback(&robot, &feedback, Instant::now()),
            Err(error) => tracing::debug!("{}: {error}", sample.key_expr()),
        }
        self.feedback_received.notify_one();
    }

    fn on_query(&self, query: &Query) {
        let notice = self.core().notice(Instant::now());
        let reply = query.reply(&self.notice_key, notice.encode());
        if let Err(error) = reply.encoding(Encoding::APPLICATION_JSON).wait() {
            tracing::debug!("cannot reply to a query for {}: {error}", self.notice_key);
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

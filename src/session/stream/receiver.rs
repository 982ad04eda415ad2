//! Receives a stream: subscribes to the group that the sender assigns, queries the sender's notices, sends feedback, and
//! passes the newest frame to the program.
use std::{
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use tokio::{sync::Notify, task::JoinHandle};
use zenoh::{
    bytes::ZBytes,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    query::Reply,
    sample::Sample,
    Session, Wait,
};

use crate::{
    core::{
        attachment::Attachment,
        key::KeySpace,
        name::Name,
        payload::Payload,
        queue::{Queue, WhenFull},
        stream::{feedback_key, notice::Notice, notice_key, receiver::Receiver, Group},
        topic::Topic,
        urgency::Urgency,
    },
    error::Error,
    session::{
        publication::priority,
        receive_queue::ReceiveQueue,
        robot::Robot,
        subscriber::{self, QueueOptions},
    },
};

/// How long the receiver stays subscribed to the previous group after a change, to receive the frames in flight.
const LINGER: Duration = Duration::from_millis(300);
/// Timeout of a query for the sender's notice.
const TIMEOUT: Duration = Duration::from_secs(3);

/// A frame of a stream, received by a [`Watch`].
#[derive(Clone, Debug)]
pub struct Frame {
    /// The picture or value.
    pub payload: Payload,
    /// The number of the frame. It starts again when the sender restarts or assigns this receiver to another group.
    pub number: u32,
    /// The age of the frame on arrival. Until the offset of the clocks is known, the delay relative to the fastest frame of
    /// the last minute. `None` if the sender is a stock Zenoh program.
    pub age: Option<Duration>,
    /// The number of frames between the previous frame that the program read and this one. The link dropped them, or
    /// newer frames replaced them in the receive queue.
    pub skipped: u32,
    ordinal: u64,
}

/// Receives a stream of another robot; created by [`Robot::watch`]. Dropping it ends the subscription.
pub struct Watch {
    shared: Arc<Shared>,
    last: Mutex<Option<u64>>,
    task: JoinHandle<()>,
}

struct Shared {
    core: Mutex<Counted>,
    /// Notified when a notice of the sender arrives.
    changed: Notify,
    queue: Arc<ReceiveQueue<Frame>>,
}

struct Counted {
    receiver: Receiver,
    /// Number of frames sent since the first one that arrived.
    ordinal: u64,
}

impl Robot {
    /// Receives the stream `topic` of `robot`. Only the newest frame is kept until the program reads it.
    ///
    /// The stream may start later than the watch, and may stop and start again.
    ///
    /// ```no_run
    /// # async fn watch(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let camera = robot.watch("wombat-2", "camera").await?;
    /// while let Some(frame) = camera.next().await {
    ///     println!("frame {}, {:?} old, {} skipped", frame.number, frame.age, frame.skipped);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Topic`] if an argument is invalid, and [`Error::Zenoh`] if the session is closed.
    pub async fn watch<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
    ) -> Result<Watch, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let newest = QueueOptions {
            capacity: 1,
            when_full: WhenFull::DropOldest,
        };
        self.watch_with(robot, topic, newest).await
    }

    /// Receives the stream `topic` of `robot` with other settings of the receive queue, for example to read every value of a
    /// sensor.
    ///
    /// # Errors
    /// Returns the same errors as [`watch`](Self::watch).
    pub async fn watch_with<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        queue: QueueOptions,
    ) -> Result<Watch, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let (robot, topic) = (robot.try_into()?, topic.try_into()?);
        let inner = &self.inner;
        let queue = ReceiveQueue::new(Queue::new(queue.capacity, queue.when_full));
        let receiver = Receiver::new(inner.place.robot.clone(), rand::random(), Instant::now());
        let core = Mutex::new(Counted {
            receiver,
            ordinal: 0,
        });
        let shared = Arc::new(Shared {
            core,
            changed: Notify::new(),
            queue,
        });
        let task = WatchTask::declare(&inner.session, &inner.place, robot, topic, &shared)?;
        let task = inner.runtime.spawn(task.run());
        Ok(Watch {
            shared,
            last: Mutex::default(),
            task,
        })
    }
}

impl Watch {
    /// Waits for the next frame, by default the newest one; returns `None` once the session or the watch is closed.
    pub async fn next(&self) -> Option<Frame> {
        self.shared
            .queue
            .pop()
            .await
            .map(|frame| self.counted(frame))
    }

    /// Returns the next frame, by default the newest one, if one is queued.
    pub fn try_next(&self) -> Option<Frame> {
        self.shared.queue.try_pop().map(|frame| self.counted(frame))
    }

    /// Stops receiving. Frames that are already queued can still be read.
    pub fn close(&self) {
        self.shared.queue.close();
    }

    /// Returns the round trip of a small message to the sender; `None` until the first one has been measured.
    pub fn round_trip(&self) -> Option<Duration> {
        self.shared.core().receiver.round_trip()
    }

    fn counted(&self, mut frame: Frame) -> Frame {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let skipped = last.map_or(0, |last| frame.ordinal.saturating_sub(last + 1));
        *last = Some(frame.ordinal);
        frame.skipped = u32::try_from(skipped).unwrap_or(u32::MAX);
        frame
    }
}

/// The task behind a [`Watch`].
struct WatchTask {
    session: Session,
    sender: KeySpace,
    topic: Topic,
    shared: Arc<Shared>,
    feedback: Publisher<'static>,
    subscribers: [Option<Subscriber<()>>; 2],
    group: Option<(Group, Instant)>,
    _notices: Subscriber<()>,
}

impl WatchTask {
    fn declare(
        session: &Session,
        place: &KeySpace,
        robot: Name,
        topic: Topic,
        shared: &Arc<Shared>,
    ) -> Result<Self, Error> {
        let feedback = session
            .declare_publisher(feedback_key(place, &robot, &topic))
            .priority(priority(Urgency::Urgent.qos()))
            .express(true)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(Error::zenoh(
                "cannot declare the publisher of the stream's feedback",
            ))?;
        let sender = KeySpace {
            fleet: place.fleet.clone(),
            robot,
        };
        let notices = session
            .declare_subscriber(notice_key(&sender, &topic))
            .callback({
                let shared = NoticeSource(shared.clone());
                move |sample: Sample| {
                    let shared = &shared.0;
                    if let Ok(notice) = Notice::decode(&sample.payload().to_bytes()) {
                        shared.core().receiver.on_notice(&notice);
                        shared.changed.notify_one();
                    }
                }
            })
            .wait()
            .map_err(Error::zenoh("cannot subscribe to the stream's notices"))?;
        Ok(Self {
            session: session.clone(),
            sender,
            topic,
            shared: shared.clone(),
            feedback,
            subscribers: [None, None],
            group: None,
            _notices: notices,
        })
    }

    async fn run(mut self) {
        while !self.session.is_closed() {
            let poll_at = match self.poll(Instant::now()).await {
                Ok(poll_at) => poll_at,
                Err(error) => {
                    tracing::debug!("{}/{}: {error}", self.sender.robot, self.topic);
                    break;
                }
            };
            tokio::select! {
                () = tokio::time::sleep_until(poll_at.into()) => {}
                () = self.shared.changed.notified() => {}
            }
        }
        self.shared.queue.close();
    }

    /// Performs the actions that are due, and returns the time of the next call.
    async fn poll(&mut self, now: Instant) -> zenoh::Result<Instant> {
        let (group, is_query_due, feedback) = {
            let receiver = &mut self.shared.core().receiver;
            (
                receiver.poll_group(now),
                receiver.poll_query(now),
                receiver.poll_feedback(now),
            )
        };
        if is_query_due {
            self.query_notice().await?;
        }
        if let Some(group) = group {
            self.subscribe_to(group, now).await?;
        }
        if let Some(feedback) = feedback {
            self.feedback.put(feedback.encode()).await?;
        }
        let unsubscribe_at = self.group.and_then(|(group, since)| {
            let other = self.subscribers[1 - group.index()].as_ref();
            other.map(|_| since + LINGER)
        });
        let poll_at = self.shared.core().receiver.poll_at(now);
        Ok(unsubscribe_at.map_or(poll_at, |unsubscribe_at| unsubscribe_at.min(poll_at)))
    }

    async fn query_notice(&self) -> zenoh::Result<()> {
        let (shared, sent) = (self.shared.clone(), Instant::now());
        self.session
            .get(notice_key(&self.sender, &self.topic))
            .priority(priority(Urgency::Urgent.qos()))
            .express(true)
            .timeout(TIMEOUT)
            .callback(move |reply: Reply| {
                let now = Instant::now();
                let sample = reply.result().ok();
                let notice =
                    sample.and_then(|sample| Notice::decode(&sample.payload().to_bytes()).ok());
                if let Some(notice) = notice {
                    shared.core().receiver.on_reply(&notice, sent, now);
                    shared.changed.notify_one();
                }
            })
            .await
    }

    /// Subscribes to a group; the subscription to the other group ends [`LINGER`] later.
    async fn subscribe_to(&mut self, group: Group, now: Instant) -> zenoh::Result<()> {
        if self.subscribers[group.index()].is_none() {
            let shared = self.shared.clone();
            let subscriber = self
                .session
                .declare_subscriber(group.key(&self.sender, &self.topic));
            let subscriber = subscriber
                .callback(move |sample| shared.on_frame(&sample))
                .await?;
            self.subscribers[group.index()] = Some(subscriber);
        }
        match self.group {
            Some((known, since)) if known == group => {
                let other = &mut self.subscribers[1 - group.index()];
                if now.saturating_duration_since(since) >= LINGER {
                    if let Some(left) = other.take() {
                        left.undeclare().await?;
                    }
                }
            }
            _ => self.group = Some((group, now)),
        }
        Ok(())
    }
}

impl Shared {
    fn core(&self) -> MutexGuard<'_, Counted> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn on_frame(&self, sample: &Sample) {
        let now = Instant::now();
        let attachment = sample.attachment().map(ZBytes::to_bytes);
        let attachment = attachment.and_then(|bytes| Attachment::decode(&bytes));
        let mut core = self.core();
        let Some(seen) = core
            .receiver
            .on_frame(attachment, sample.payload().len(), now)
        else {
            return;
        };
        core.ordinal += 1 + u64::from(seen.skipped);
        let frame = Frame {
            payload: subscriber::payload(sample.payload(), sample.encoding()),
            number: seen.number,
            age: seen.age,
            skipped: seen.skipped,
            ordinal: core.ordinal,
        };
        drop(core);
        self.queue.push(frame);
    }
}

/// Held by the callback for the sender's notices. Zenoh drops the callback with the session at the latest, which closes the
/// receive queue.
struct NoticeSource(Arc<Shared>);

impl Drop for NoticeSource {
    fn drop(&mut self) {
        self.0.queue.close();
        self.0.changed.notify_one();
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.close();
        self.task.abort();
    }
}

impl fmt::Debug for Watch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let round_trip = self.round_trip();
        f.debug_struct("Watch")
            .field("round_trip", &round_trip)
            .finish_non_exhaustive()
    }
}

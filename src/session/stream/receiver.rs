//! Owns the receiving end of a stream: it listens where it is to, asks, tells, and hands the newest frame to the program.
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
        key::Place,
        name::Name,
        payload::Payload,
        queue::{Queue, WhenFull},
        stream::{feedback_key, notice::Notice, notice_key, receiver::Receiver, Group},
        topic::Topic,
        urgency::Urgency,
    },
    error::Error,
    session::{
        inbox::Inbox,
        publication::priority,
        robot::Robot,
        subscriber::{self, Receiving},
    },
};

/// The key of a group that is left is listened to for so long still: what is on its way comes.
const LINGER: Duration = Duration::from_millis(300);
const PATIENCE: Duration = Duration::from_secs(3);

/// A frame of a stream.
#[derive(Clone, Debug)]
pub struct Frame {
    /// What it is.
    pub payload: Payload,
    /// Its number. The sender numbers anew when it starts, and when this robot gets other frames than before.
    pub number: u32,
    /// How old it was when it came; until the sender has told its time, how much older than the fastest of the last
    /// minute. `None`: another program's, which does not tell.
    pub age: Option<Duration>,
    /// So many before it were not seen: the link dropped them, or this program was not there to take them.
    pub skipped: u32,
    ordinal: u64,
}

/// A stream that this program watches. It ends when this is dropped.
pub struct Watch {
    shared: Arc<Shared>,
    last: Mutex<Option<u64>>,
    task: JoinHandle<()>,
}

struct Shared {
    core: Mutex<Counted>,
    /// The sender has said something.
    told: Notify,
    inbox: Arc<Inbox<Frame>>,
}

struct Counted {
    receiver: Receiver,
    /// Frames that were sent since the first that came.
    ordinal: u64,
}

impl Robot {
    /// Watches a robot's stream: the newest frame waits until it is taken.
    ///
    /// ```no_run
    /// # async fn watched(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let camera = robot.watch("wombat-2", "camera").await?;
    /// while let Some(frame) = camera.recv().await {
    ///     println!("frame {}, {:?} old, after {} others", frame.number, frame.age, frame.skipped);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`], [`Error::Topic`]; [`Error::Zenoh`] when the session is closed.
    pub async fn watch<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
    ) -> Result<Watch, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let newest = Receiving {
            capacity: 1,
            when_full: WhenFull::NewestWins,
        };
        self.watch_with(robot, topic, newest).await
    }

    /// The same, with a say in how frames wait: a program may want all values of a sensor.
    ///
    /// # Errors
    /// As [`watch`](Self::watch).
    pub async fn watch_with<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        receiving: Receiving,
    ) -> Result<Watch, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let (robot, topic) = (robot.try_into()?, topic.try_into()?);
        let inner = &self.inner;
        let inbox = Inbox::new(Queue::new(receiving.capacity, receiving.when_full));
        let receiver = Receiver::new(inner.place.robot.clone(), rand::random(), Instant::now());
        let core = Mutex::new(Counted {
            receiver,
            ordinal: 0,
        });
        let shared = Arc::new(Shared {
            core,
            told: Notify::new(),
            inbox,
        });
        let listening = Listening::declare(&inner.session, &inner.place, robot, topic, &shared)?;
        let task = inner.runtime.spawn(listening.run());
        Ok(Watch {
            shared,
            last: Mutex::default(),
            task,
        })
    }
}

impl Watch {
    /// The newest frame, once there is one that was not taken yet; `None`: the session was closed.
    pub async fn recv(&self) -> Option<Frame> {
        self.shared
            .inbox
            .pop()
            .await
            .map(|frame| self.counted(frame))
    }

    /// The same, if there is one.
    pub fn try_recv(&self) -> Option<Frame> {
        self.shared.inbox.try_pop().map(|frame| self.counted(frame))
    }

    /// Nothing comes any more; what waits can still be taken.
    pub fn close(&self) {
        self.shared.inbox.close();
    }

    /// What a small message takes to the sender and back, once it has answered one.
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
struct Listening {
    session: Session,
    sender: Place,
    topic: Topic,
    shared: Arc<Shared>,
    says: Publisher<'static>,
    hears: [Option<Subscriber<()>>; 2],
    group: Option<(Group, Instant)>,
    _notices: Subscriber<()>,
}

impl Listening {
    fn declare(
        session: &Session,
        place: &Place,
        robot: Name,
        topic: Topic,
        shared: &Arc<Shared>,
    ) -> Result<Self, Error> {
        let says = session
            .declare_publisher(feedback_key(place, &robot, &topic))
            .priority(priority(Urgency::Urgent.qos()))
            .express(true)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(Error::zenoh("what comes can't be told"))?;
        let sender = Place {
            fleet: place.fleet.clone(),
            robot,
        };
        let notices = session
            .declare_subscriber(notice_key(&sender, &topic))
            .callback({
                let shared = Told(shared.clone());
                move |sample: Sample| {
                    let shared = &shared.0;
                    if let Ok(notice) = Notice::decode(&sample.payload().to_bytes()) {
                        shared.core().receiver.on_notice(&notice);
                        shared.told.notify_one();
                    }
                }
            })
            .wait()
            .map_err(Error::zenoh("the stream's notices are refused"))?;
        Ok(Self {
            session: session.clone(),
            sender,
            topic,
            shared: shared.clone(),
            says,
            hears: [None, None],
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
                () = self.shared.told.notified() => {}
            }
        }
        self.shared.inbox.close();
    }

    /// Does what is due; when there may be more to do.
    async fn poll(&mut self, now: Instant) -> zenoh::Result<Instant> {
        let (group, asks, says) = {
            let receiver = &mut self.shared.core().receiver;
            (
                receiver.poll_group(now),
                receiver.poll_question(now),
                receiver.poll_feedback(now),
            )
        };
        if asks {
            self.ask().await?;
        }
        if let Some(group) = group {
            self.listen(group, now).await?;
        }
        if let Some(feedback) = says {
            self.says.put(feedback.encode()).await?;
        }
        let left_at = self.group.and_then(|(group, since)| {
            let other = self.hears[1 - group.index()].as_ref();
            other.map(|_| since + LINGER)
        });
        let poll_at = self.shared.core().receiver.poll_at(now);
        Ok(left_at.map_or(poll_at, |left_at| left_at.min(poll_at)))
    }

    async fn ask(&self) -> zenoh::Result<()> {
        let (shared, asked) = (self.shared.clone(), Instant::now());
        self.session
            .get(notice_key(&self.sender, &self.topic))
            .priority(priority(Urgency::Urgent.qos()))
            .express(true)
            .timeout(PATIENCE)
            .callback(move |reply: Reply| {
                let now = Instant::now();
                let sample = reply.result().ok();
                let notice =
                    sample.and_then(|sample| Notice::decode(&sample.payload().to_bytes()).ok());
                if let Some(notice) = notice {
                    shared.core().receiver.on_answer(&notice, asked, now);
                    shared.told.notify_one();
                }
            })
            .await
    }

    /// Listens to a group's key; the other's is left a little later.
    async fn listen(&mut self, group: Group, now: Instant) -> zenoh::Result<()> {
        if self.hears[group.index()].is_none() {
            let shared = self.shared.clone();
            let declared = self
                .session
                .declare_subscriber(group.key(&self.sender, &self.topic));
            let declared = declared
                .callback(move |sample| shared.on_frame(&sample))
                .await?;
            self.hears[group.index()] = Some(declared);
        }
        match self.group {
            Some((known, since)) if known == group => {
                let other = &mut self.hears[1 - group.index()];
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
        self.inbox.push(frame);
    }
}

/// Where the sender's notices come in: a callback that Zenoh drops with the session, at the latest.
struct Told(Arc<Shared>);

impl Drop for Told {
    fn drop(&mut self) {
        self.0.inbox.close();
        self.0.told.notify_one();
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

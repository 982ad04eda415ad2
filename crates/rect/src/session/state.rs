//! Publishes retained messages, receives them from the router, and keeps the state of a robot.
use std::{
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak},
    time::{Instant, SystemTime},
};

use rect_core::{
    clock::unix::ms_since_1970,
    message::{
        counters::AtomicCounters,
        payload::{FromPayload, Payload},
        Inbound, Message,
    },
    name::{
        key::{Audience, KeySpace, Selected},
        topic::Topic,
        Name,
    },
    registry::topics::RetainedTopic,
    state::{
        keeper::{Disk, IsServed, Item, StateKeeper},
        latest::Latest,
        page::Order,
        program::{Arrival, Following, ProgramState},
        retain::{Outcome, Retain},
    },
};
use zenoh::Session;

use super::{
    executor::Executor,
    receive_queue::ReceiveQueue,
    robot::Robot,
    router_links::LinkTable,
    shared::{NoItems, Shared, Sink},
};
use crate::error::{valid, Error};

/// Begins to keep the state of a program that has no router.
pub(super) fn keep_own(session: &Session, place: &KeySpace) -> Result<KeptState, Error> {
    let disk = Disk::None("a program without a router keeps no values on disk".to_owned());
    let save = Box::new(|_: &[u8]| Ok(()));
    KeptState::start(session, place.clone(), disk, save, Box::new(|_| false))
}

/// How a handle retains what it publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Retention {
    InMemory,
    OnDisk,
}

/// The retained messages that a program receives: a driver on a thread of its own, which begins with the first subscription or retained
/// message.
pub(super) struct State {
    session: Session,
    place: KeySpace,
    run: u32,
    running: OnceLock<Arc<Shared<ProgramState>>>,
    receivers: Arc<Receivers>,
}

type Receivers = Mutex<Vec<(u64, Arc<Receiver>)>>;

/// The part of a subscription that retained messages go through.
pub(super) struct Receiver {
    pub(super) inbound: Arc<Mutex<Inbound>>,
    pub(super) queue: Weak<ReceiveQueue<Message>>,
    pub(super) counting: Arc<AtomicCounters>,
    pub(super) links: Option<LinkTable>,
}

/// A subscription to retained messages. Dropping it ends it.
pub(super) struct Receiving {
    state: Arc<State>,
    number: u64,
}

impl State {
    pub(super) fn new(session: &Session, place: &KeySpace, run: u32) -> Arc<Self> {
        Arc::new(Self {
            session: session.clone(),
            place: place.clone(),
            run,
            running: OnceLock::new(),
            receivers: Arc::default(),
        })
    }

    fn running(&self) -> Result<&Arc<Shared<ProgramState>>, Error> {
        if let Some(running) = self.running.get() {
            return Ok(running);
        }
        let driver = ProgramState::new(self.place.clone(), self.run, Instant::now());
        let receivers = Arc::clone(&self.receivers);
        let executor = Executor::new(&self.session, driver, ToReceivers(receivers));
        let started = executor.start_thread("rect state")?;
        // Of two threads that start it at the same time, one closes its own.
        if let Err(second) = self.running.set(started) {
            second.on_event(rect_core::driver::Event::Closed);
        }
        self.running.get().ok_or(Error::Closed)
    }

    /// Returns whether retained messages come through the router.
    pub(super) fn following(&self) -> Result<Following, Error> {
        Ok(self.running()?.driver().following())
    }

    /// Delivers the retained messages of those subscriptions to a receiver.
    pub(super) fn receive(
        self: &Arc<Self>,
        selected: &[Selected],
        receiver: Receiver,
    ) -> Result<Receiving, Error> {
        let published = selected.iter().filter(|one| one.audience == Audience::All);
        let keys: Vec<_> = published.map(|selected| selected.key.clone()).collect();
        let running = self.running()?;
        // Values that arrive meanwhile wait for the receiver.
        let mut receivers = lock(&self.receivers);
        let number = running.driver().subscribe(&keys, Instant::now());
        receivers.push((number, Arc::new(receiver)));
        drop(receivers);
        running.wake();
        Ok(Receiving {
            state: Arc::clone(self),
            number,
        })
    }
}

impl Drop for State {
    fn drop(&mut self) {
        if let Some(running) = self.running.get() {
            running.on_event(rect_core::driver::Event::Closed);
        }
    }
}

impl Drop for Receiving {
    fn drop(&mut self) {
        lock(&self.state.receivers).retain(|(number, _)| *number != self.number);
        if let Some(running) = self.state.running.get() {
            running.driver().unsubscribe(self.number, Instant::now());
            running.wake();
        }
    }
}

struct ToReceivers(Arc<Receivers>);

impl Sink<Arrival> for ToReceivers {
    fn deliver(&self, arrival: Arrival) {
        // A queue without room blocks, and the program may end a subscription meanwhile.
        let receivers = lock(&self.0).clone();
        for (_, receiver) in receivers {
            let messages = lock(&receiver.inbound).on_retained(&arrival);
            let Some(queue) = receiver.queue.upgrade() else {
                continue;
            };
            for mut message in messages {
                let links = receiver.links.as_ref();
                message.method = links.and_then(|links| links.method(&message.sender));
                receiver
                    .counting
                    .on_received(message.payload.bytes.len(), 0);
                queue.push(message);
            }
        }
    }
}

impl Robot {
    /// Returns a handle that retains what it publishes: the router of this robot keeps the last value of each topic, and programs that
    /// start later, or whose link was interrupted, receive it.
    ///
    /// A subscription receives the value first, then each change, never one twice or an older one after a newer one
    /// ([`Message::retained`]). The value stays when this program ends. A robot's values have 256 kB at most, and one has 64 kB. Requests,
    /// streams and messages to one robot are not affected, and retained messages do not expire.
    ///
    /// ```no_run
    /// # async fn mode(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.retained().publish("mode", "auto").await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn retained(&self) -> Self {
        self.with_retention(Retention::InMemory)
    }

    /// Returns a handle as [`retained`](Self::retained) does, whose values also survive a restart of the robot. The router writes each one
    /// to its disk before it is published: for values that change rarely, such as a calibration.
    #[must_use]
    pub fn retained_on_disk(&self) -> Self {
        self.with_retention(Retention::OnDisk)
    }

    /// Returns the last value of a retained topic of `robot`, or nothing if that robot retains none or is not reachable. At once if a
    /// program of this robot subscribes to the topic; otherwise the other robot's router is asked.
    ///
    /// ```no_run
    /// # async fn mode(robot: rect::Robot) -> Result<(), rect::Error> {
    /// if let Some(message) = robot.latest::<String>("wombat-2", "mode").await? {
    ///     println!("{:?}", message.value);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Topic`] if an argument is invalid, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn latest<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<Option<Message<T::Value>>, Error> {
        let (robot, topic): (Name, Topic) = (valid(robot)?, valid(topic)?);
        let inner = &self.inner;
        let latest = Latest::new(inner.place.clone(), robot.clone(), topic, self.timeout);
        let found = Executor::new(&inner.session, latest, NoItems).run().await?;
        let Some(value) = found else {
            return match self.is_closed() {
                true => Err(Error::Closed),
                false => Ok(None),
            };
        };
        let mut message = value.message(robot);
        inner.decoder.decode_message(&mut message).await;
        Ok(Some(message.typed::<T>()))
    }

    /// Forgets a retained topic of this robot. Subscribers receive that as a message without a value ([`Retained::is_forgotten`]). Nothing
    /// happens if it has no value.
    ///
    /// # Errors
    /// [`Error::Topic`] if the topic is invalid, [`Error::NotRetained`] if no router keeps it, and [`Error::Closed`] if the session is
    /// closed.
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the topic may be forgotten or not.
    pub async fn forget(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<(), Error> {
        let topic: Topic = valid(topic)?;
        let running = self.inner.state.running()?;
        let order = running.driver().forget(&topic, now_ms());
        self.give(topic, order).await
    }

    /// Gives a value to the router of this robot, which publishes it.
    pub(super) async fn retain(
        &self,
        retention: Retention,
        topic: Topic,
        payload: Payload,
    ) -> Result<(), Error> {
        self.retain_at(retention, topic, payload, now_ms()).await
    }

    /// Retains the value of a recording again, or forgets its topic. `sent_ms`: when it was published, in milliseconds since 1970.
    #[cfg(feature = "recording")]
    pub(super) async fn replay_retained(
        &self,
        topic: Topic,
        value: Option<Payload>,
        sent_ms: u64,
    ) -> Result<(), Error> {
        match value {
            Some(payload) => {
                self.retain_at(Retention::InMemory, topic, payload, sent_ms)
                    .await
            }
            None => self.forget(topic).await,
        }
    }

    async fn retain_at(
        &self,
        retention: Retention,
        topic: Topic,
        payload: Payload,
        sent_ms: u64,
    ) -> Result<(), Error> {
        let running = self.inner.state.running()?;
        let size = payload.bytes.len();
        let (urgency, disk) = (self.urgency(), retention == Retention::OnDisk);
        let order = (running.driver()).set(&topic, payload, urgency, disk, sent_ms);
        let given = self.give(topic, order).await;
        if given.is_ok() {
            self.inner.counting.on_sent(size);
        }
        given
    }

    async fn give(&self, topic: Topic, order: Order) -> Result<(), Error> {
        let inner = &self.inner;
        let running = inner.state.running()?;
        let retain = Retain::new(&inner.place, &order, Instant::now());
        let outcome = Executor::new(&inner.session, retain, NoItems).run().await?;
        match outcome {
            Outcome::Kept(kept) => {
                if let Some(warning) = &kept.warning {
                    inner.warnings.on_state(warning);
                }
                (running.driver()).on_kept(topic, &order, kept, Instant::now());
                running.wake();
                Ok(())
            }
            Outcome::Closed => Err(Error::Closed),
            Outcome::Refused(reason) => Err(Error::NotRetained {
                topic: topic.to_string(),
                reason,
            }),
            Outcome::NoKeeper => {
                if let Order::Set {
                    encoding, bytes, ..
                } = order
                {
                    let payload =
                        Payload::new(bytes, rect_core::message::encoding::Encoding::new(encoding));
                    self.send_plain(topic.clone(), payload).await?;
                }
                Err(Error::NotRetained {
                    topic: topic.to_string(),
                    reason: "no router of this robot keeps values. Start rect-router, or a later version of it".to_owned(),
                })
            }
        }
    }
}

/// The state of a robot, which is kept until this is dropped. For routers; a program without a router has one of its own.
#[doc(hidden)]
pub struct KeptState(Arc<Shared<StateKeeper>>);

impl KeptState {
    /// Begins to keep the state of the robot of `place`, on a thread. `save` writes the values that survive a restart. `is_served`: whether
    /// a program serves a topic.
    ///
    /// # Errors
    /// [`Error::Zenoh`] if Zenoh refuses a declaration.
    pub fn start(
        session: &Session,
        place: KeySpace,
        disk: Disk,
        save: Save,
        is_served: IsServed,
    ) -> Result<Self, Error> {
        let now = Instant::now();
        let keeper = StateKeeper::new(place, rand::random(), disk, is_served, now);
        let shared = Arc::new(OnceLock::<Weak<Shared<StateKeeper>>>::new());
        let writer = Writer {
            save,
            shared: Arc::clone(&shared),
        };
        let running = Executor::new(session, keeper, writer).start_thread("state")?;
        let _ = shared.set(Arc::downgrade(&running));
        Ok(Self(running))
    }

    /// Returns whether a topic has a value, so that no program can serve it.
    pub fn has(&self, topic: &Topic) -> bool {
        self.0.driver().has(topic)
    }

    /// Returns the topics that have a value, in the order of their names.
    pub fn topics(&self) -> Vec<RetainedTopic> {
        self.0.driver().topics()
    }
}

impl Drop for KeptState {
    fn drop(&mut self) {
        self.0.on_event(rect_core::driver::Event::Closed);
    }
}

/// Writes bytes to disk in place of those before, or returns why it cannot.
#[doc(hidden)]
pub type Save = Box<dyn Fn(&[u8]) -> Result<(), String> + Send + Sync>;

struct Writer {
    save: Save,
    shared: Arc<OnceLock<Weak<Shared<StateKeeper>>>>,
}

impl Sink<Item> for Writer {
    fn deliver(&self, item: Item) {
        match item {
            Item::Warning(text) => tracing::warn!("{text}"),
            Item::Save(bytes) => {
                let error = (self.save)(&bytes).err();
                if let Some(shared) = self.shared.get().and_then(Weak::upgrade) {
                    shared.driver().on_saved(error);
                }
            }
        }
    }
}

fn now_ms() -> u64 {
    ms_since_1970(SystemTime::now())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

//! Receives retained messages from the router, and keeps the state of a robot.
use std::{
    sync::{Arc, Mutex, OnceLock, Weak},
    time::{Instant, SystemTime},
};

use rect_core::{
    alert::query::RobotAlert,
    clock::unix::ms_since_1970,
    driver::Event,
    message::{
        counters::AtomicCounters,
        retained::{Arrival, Following},
        Inbound, Message,
    },
    name::{
        key::{Audience, KeySpace, Selected},
        topic::Topic,
    },
    registry::topics::RetainedTopic,
    state::{
        keeper::{Disk, IsServed, Item, StateKeeper},
        program::ProgramState,
    },
};
use zenoh::Session;

use super::{
    executor::{Executor, OnThread},
    receive_queue::ReceiveQueue,
    router_links::LinkTable,
    shared::{lock, Shared, Sink},
};
use crate::error::Error;

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

/// The part of a subscription that messages go through, on Zenoh's threads and on that of the driver.
pub(super) struct Receiver {
    pub(super) inbound: Arc<Mutex<Inbound>>,
    pub(super) queue: Weak<ReceiveQueue<Message>>,
    pub(super) counting: Arc<AtomicCounters>,
    pub(super) links: Option<LinkTable>,
}

/// A subscription to retained messages. Dropping it ends it.
pub(super) struct Reception {
    state: Arc<State>,
    number: u64,
}

impl Receiver {
    /// Completes a message that has arrived, and counts it.
    pub(super) fn complete(&self, message: &mut Message) {
        let links = self.links.as_ref();
        message.method = links.and_then(|links| links.method(&message.sender));
        (self.counting).on_received(message.payload.bytes.len(), message.missed);
    }
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

    pub(super) fn running(&self) -> Result<&Arc<Shared<ProgramState>>, Error> {
        if let Some(running) = self.running.get() {
            return Ok(running);
        }
        let driver = ProgramState::new(self.place.clone(), self.run, Instant::now());
        let receivers = Arc::clone(&self.receivers);
        let executor = Executor::new(&self.session, driver, ToReceivers(receivers));
        let started = executor.start_thread("rect state")?;
        // Of two threads that start it at the same time, one closes its own.
        if let Err(second) = self.running.set(started) {
            second.on_event(Event::Closed);
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
        receiver: Arc<Receiver>,
    ) -> Result<Reception, Error> {
        let published = selected.iter().filter(|one| one.audience == Audience::All);
        let keys: Vec<_> = published.map(|selected| selected.key.clone()).collect();
        let running = self.running()?;
        // Values that arrive meanwhile wait for the receiver.
        let mut receivers = lock(&self.receivers);
        let number = running.driver().subscribe(&keys, Instant::now());
        receivers.push((number, receiver));
        drop(receivers);
        running.wake();
        Ok(Reception {
            state: Arc::clone(self),
            number,
        })
    }
}

impl Drop for State {
    fn drop(&mut self) {
        if let Some(running) = self.running.get() {
            running.on_event(Event::Closed);
        }
    }
}

impl Drop for Reception {
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
                receiver.complete(&mut message);
                queue.push(message);
            }
        }
    }
}

/// The state of a robot, which is kept until this is dropped. For routers; a program without a router has one of its own.
#[doc(hidden)]
pub struct KeptState(OnThread<StateKeeper>);

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
        let time_of_day = Box::new(|| ms_since_1970(SystemTime::now()));
        let run = rand::random();
        let keeper = StateKeeper::new(place, run, disk, is_served, time_of_day, now);
        Self::run(session, keeper, save)
    }

    /// Begins to keep the state of the robot of a program that has no router.
    ///
    /// # Errors
    /// Returns the errors of [`start`](Self::start).
    pub fn of_program(session: &Session, place: KeySpace) -> Result<Self, Error> {
        let keeper = StateKeeper::of_program(place, rand::random(), Instant::now());
        Self::run(session, keeper, Box::new(|_| Ok(())))
    }

    fn run(session: &Session, keeper: StateKeeper, save: Save) -> Result<Self, Error> {
        let shared = Arc::new(OnceLock::<Weak<Shared<StateKeeper>>>::new());
        let writer = Writer {
            save,
            shared: Arc::clone(&shared),
        };
        let running = OnThread::start(Executor::new(session, keeper, writer), "state")?;
        let _ = shared.set(Arc::downgrade(&running));
        Ok(Self(running))
    }

    /// Returns whether a topic has a value, so that no program can serve it.
    pub fn has(&self, topic: &Topic) -> bool {
        self.0.driver().has(topic)
    }

    /// Returns the alerts of the robot, the most important ones first.
    pub fn alerts(&self) -> Vec<RobotAlert> {
        let messages = self.0.driver().messages(Instant::now());
        let mut alerts: Vec<_> = messages.iter().filter_map(RobotAlert::of).collect();
        RobotAlert::sort(&mut alerts);
        alerts
    }

    /// Returns the topics that have a value, in the order of their names.
    pub fn topics(&self) -> Vec<RetainedTopic> {
        self.0.driver().topics()
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

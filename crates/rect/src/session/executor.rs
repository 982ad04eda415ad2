//! Performs the actions of one driver on a Zenoh session, and reports what Zenoh delivers to the driver.
use std::{
    collections::HashMap,
    ops::Deref,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex, MutexGuard, PoisonError,
    },
    time::{Duration, Instant},
};

use rect_core::{
    driver::{Action, Driver, Event, Id, Step},
    storage::Files,
    transfer::files::UsesFiles,
};
use tokio::{runtime::Handle, task::JoinHandle};
use zenoh::Session;

use super::{
    declared::Declared,
    queries,
    shared::{Shared, Sink},
};
use crate::error::Error;

/// Interval at which a thread that runs a driver checks whether the session was closed.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// Performs the actions of one driver.
pub(super) struct Executor<D: Driver> {
    session: Session,
    shared: Arc<Shared<D>>,
    declared: Mutex<HashMap<Id, Arc<Declared>>>,
    has_ended: AtomicBool,
}

/// A driver that runs on a task. Dropping it ends everything that the driver has declared.
pub(super) struct Running<D: Driver> {
    executor: Arc<Executor<D>>,
    task: JoinHandle<()>,
}

/// A driver that runs on a thread until this is dropped.
pub(super) struct OnThread<D: Driver>(Arc<Shared<D>>);

enum Next<O> {
    Wait(Option<Instant>),
    Finished(O),
}

impl<D> OnThread<D>
where
    D: Driver<Output: Send> + Send + 'static,
    D::Item: 'static,
{
    /// Starts a driver.
    pub(super) fn start(executor: Executor<D>, name: &str) -> Result<Self, Error> {
        Ok(Self(executor.start_thread(name)?))
    }
}

impl<D: Driver> Deref for OnThread<D> {
    type Target = Arc<Shared<D>>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<D: Driver> Drop for OnThread<D> {
    fn drop(&mut self) {
        self.0.on_event(Event::Closed);
    }
}

impl<D> Executor<D>
where
    D: Driver + Send + 'static,
    D::Item: 'static,
{
    /// Creates the executor of a driver, whose items go to `sink`.
    pub(super) fn new(session: &Session, driver: D, sink: impl Sink<D::Item> + 'static) -> Self {
        Self {
            session: session.clone(),
            shared: Arc::new(Shared::new(driver, sink)),
            declared: Mutex::default(),
            has_ended: AtomicBool::new(false),
        }
    }

    /// Starts the driver: performs its first actions now, so that the caller gets their errors, and the others on a task.
    pub(super) fn start(self, runtime: &Handle) -> Result<Running<D>, Error>
    where
        D::Output: Send,
    {
        let executor = Arc::new(self);
        let first = executor.step().inspect_err(|_| executor.end())?;
        let running = executor.clone();
        let task = runtime.spawn(async move {
            if let Err(error) = running.run_after(first).await {
                tracing::debug!("a driver has ended: {error}");
            }
        });
        Ok(Running { executor, task })
    }

    /// Runs the driver to its end. Dropping the future ends everything that the driver has declared.
    pub(super) async fn run(self) -> Result<D::Output, Error> {
        let first = self.step()?;
        self.run_after(first).await
    }

    async fn run_after(&self, mut next: Next<D::Output>) -> Result<D::Output, Error> {
        loop {
            match next {
                Next::Wait(until) => self.shared.signal().wait_until(until).await,
                Next::Finished(output) => return Ok(output),
            }
            next = self.step().inspect_err(|_| self.end())?;
        }
    }

    /// Performs the actions that are due.
    fn step(&self) -> Result<Next<D::Output>, Error> {
        loop {
            let step = self.shared.driver().poll(Instant::now());
            match step {
                Step::Act(action) => self.act(action)?,
                Step::Deliver(item) => self.shared.deliver(item),
                Step::Wait(until) => return Ok(Next::Wait(until)),
                Step::Finished(output) => {
                    self.end();
                    return Ok(Next::Finished(output));
                }
            }
        }
    }

    /// Performs an action.
    pub(super) fn act(&self, action: Action) -> Result<(), Error> {
        let (session, shared) = (&self.session, &self.shared);
        match action {
            Action::Declare { id, declaration } => {
                let declared = Declared::new(session, id, declaration, shared)?;
                self.declared().insert(id, Arc::new(declared));
            }
            Action::Undeclare { id } => {
                let declared = self.declared().remove(&id);
                drop(declared);
            }
            Action::Put {
                publisher,
                payload,
                attachment,
            } => {
                let declared = self.declared().get(&publisher).cloned();
                let publisher = declared.as_deref().and_then(Declared::publisher);
                queries::put(publisher.ok_or(Error::Closed)?, payload, attachment)?;
            }
            Action::PutOnce { key, payload, qos } => {
                queries::put_once(session, &key, payload, qos)?;
            }
            Action::PutRetained {
                key,
                payload,
                qos,
                attachment,
                number,
            } => queries::put_retained(session, &key, payload, qos, attachment, number)?,
            Action::Get { id, get } => {
                // Zenoh would end the query without replies, as if nobody were reachable.
                if session.is_closed() {
                    return Err(Error::Closed);
                }
                let (on_reply, on_end) = (shared.clone(), shared.clone());
                queries::get(
                    session,
                    get,
                    move |reply| on_reply.on_event(Event::Reply { id, reply }),
                    move || on_end.on_event(Event::Ended { id }),
                );
            }
            Action::Answer { query, answer } => {
                let query = shared.take_query(query);
                if let Some(query) = query {
                    queries::answer(&query, answer);
                }
            }
            Action::AnswerRetained { query, replies } => {
                let query = shared.take_query(query);
                if let Some(query) = query {
                    queries::answer_retained(session, &query, replies);
                }
            }
        }
        Ok(())
    }

    /// Runs the driver to its end. Blocks the thread, also while a link has no room.
    pub(super) fn run_blocking(&self) -> Result<D::Output, Error> {
        self.block(|_| {})
    }

    /// Starts the driver on a thread, as [`start`](Self::start) does on a task.
    pub(super) fn start_thread(self, name: &str) -> Result<Arc<Shared<D>>, Error>
    where
        D::Output: Send,
    {
        let executor = Arc::new(self);
        if let Next::Wait(_) = executor.step().inspect_err(|_| executor.end())? {
            let running = executor.clone();
            let run = move || {
                if let Err(error) = running.run_blocking() {
                    tracing::debug!("a driver has ended: {error}");
                }
            };
            let thread = std::thread::Builder::new().name(name.to_owned());
            let started = thread.spawn(run).map_err(Error::thread);
            // The sink may refer to the driver, and both would be kept.
            started.inspect_err(|_| executor.end())?;
        }
        Ok(executor.shared.clone())
    }

    fn block(&self, mut before_poll: impl FnMut(&Shared<D>)) -> Result<D::Output, Error> {
        loop {
            before_poll(&self.shared);
            match self.step().inspect_err(|_| self.end())? {
                Next::Wait(until) => {
                    let check_at = Instant::now() + CHECK_EVERY;
                    let until = until.map_or(check_at, |until| until.min(check_at));
                    self.shared.signal().block_until(until);
                    if self.session.is_closed() {
                        self.shared.on_event(Event::Closed);
                    }
                }
                Next::Finished(output) => return Ok(output),
            }
        }
    }
}

impl<D> Executor<D>
where
    D: Driver + UsesFiles + Send + 'static,
    D::Item: 'static,
{
    /// Runs a driver with its storage to its end. Blocks the thread.
    pub(super) fn run_with_files<F>(&self, files: &mut F) -> Result<D::Output, Error>
    where
        F: Files<Action = <D as UsesFiles>::Action, Event = <D as UsesFiles>::Event>,
    {
        self.block(|shared| loop {
            let action = shared.driver().poll_file();
            let Some(action) = action else { return };
            let event = files.perform(action);
            shared.driver().on_file(Instant::now(), event);
        })
    }
}

impl<D: Driver> Executor<D> {
    /// Returns the shared state, through which other threads reach the driver.
    pub(super) fn shared(&self) -> &Arc<Shared<D>> {
        &self.shared
    }

    /// Ends everything that the driver has declared.
    fn end(&self) {
        self.has_ended.store(true, Ordering::Relaxed);
        let declared = std::mem::take(&mut *self.declared());
        drop(declared);
        self.shared.end();
    }

    fn declared(&self) -> MutexGuard<'_, HashMap<Id, Arc<Declared>>> {
        self.declared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<D> Running<D>
where
    D: Driver + Send + 'static,
    D::Item: 'static,
{
    /// Returns the driver, for what only the program does.
    pub(super) fn driver(&self) -> MutexGuard<'_, D> {
        self.executor.shared.driver()
    }

    /// Makes the executor poll the driver.
    pub(super) fn wake(&self) {
        self.executor.shared.wake();
    }

    /// Performs the actions that are due on the calling thread, in place of the task, because the driver is about to be dropped.
    pub(super) fn poll_now(&self) -> Result<(), Error> {
        self.executor.step().map(|_| ())
    }

    /// Returns whether the driver has finished, because the session was closed.
    pub(super) fn has_ended(&self) -> bool {
        self.executor.has_ended.load(Ordering::Relaxed)
    }

    /// Performs an action that the program has caused.
    pub(super) fn act(&self, action: Action) -> Result<(), Error> {
        self.executor.act(action)
    }
}

impl<D: Driver> Drop for Running<D> {
    fn drop(&mut self) {
        self.task.abort();
        self.executor.end();
    }
}

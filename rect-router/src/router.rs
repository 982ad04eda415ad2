//! The router's life: opened, running, closed within a bound.

use std::{
    any::Any,
    io,
    panic::{self, AssertUnwindSafe},
    sync::{
        mpsc::{self, Receiver, Sender},
        Arc,
    },
    thread,
    time::Duration,
};

use sd_notify::NotifyState;
use zenoh::{
    internal::runtime::{DynamicRuntime, Runtime, RuntimeBuilder, ZRuntime},
    Config, Session, Wait,
};

use rect::core::wording;

use crate::{
    limits::SessionLimits,
    robot::{self, Robot, Running},
    signals, status,
};

/// How long peers are given to take note that the router ends.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// A router, and its own session with it.
struct Opened {
    runtime: Runtime,
    session: Session,
}

enum Event {
    Opened(Result<Opened, RouterError>),
    Closed,
    StopAsked,
}

/// Runs a router until a signal ends it; `robot`: what RECT adds to it.
pub fn run(
    mut config: Config,
    limits: SessionLimits,
    robot: Option<Robot>,
) -> Result<(), RouterError> {
    limits
        .apply(&mut config)
        .map_err(|error| RouterError::Open(error.into()))?;
    let (events, next) = mpsc::channel();
    signals::watch(events.clone(), || Event::StopAsked).map_err(RouterError::System)?;

    // Opening can wait for peers, and so it has a thread of its own: a signal is heard all the while.
    spawn("open", &events, move || {
        Event::Opened(open(config, &limits))
    })?;
    let opened = match next.recv() {
        Ok(Event::Opened(opened)) => opened?,
        _ => return Ok(()),
    };
    let session = &opened.session;
    status::serve(session).map_err(RouterError::Open)?;
    let running = robot
        .map(|robot| robot.start(session, None))
        .transpose()
        .map_err(RouterError::Open)?;
    tracing::info!("rect-router is up, with id {}", session.zid());
    tell_systemd();

    match next.recv() {
        Ok(Event::StopAsked) => close(opened, running, &events, &next),
        _ => Ok(()),
    }
}

/// Where it is a service of `Type=notify`: its start has come to an end.
fn tell_systemd() {
    if let Err(error) = sd_notify::notify(&[NotifyState::Ready]) {
        tracing::warn!("systemd was not told that the router is up: {error}");
    }
}

fn close(
    opened: Opened,
    running: Option<Running>,
    events: &Sender<Event>,
    next: &Receiver<Event>,
) -> Result<(), RouterError> {
    spawn("close", events, move || {
        let closed =
            robot::close(&opened.session, running).and_then(|()| opened.runtime.close().wait());
        if let Err(error) = closed {
            tracing::warn!("while closing: {error}");
        }
        Event::Closed
    })?;
    match next.recv_timeout(CLOSE_TIMEOUT) {
        Ok(_) => tracing::info!("closed"),
        Err(_) => tracing::warn!(
            "not all links were closed within {}; ending",
            wording::duration(CLOSE_TIMEOUT)
        ),
    }
    Ok(())
}

fn spawn(
    name: &str,
    events: &Sender<Event>,
    work: impl FnOnce() -> Event + Send + 'static,
) -> Result<(), RouterError> {
    let events = events.clone();
    thread::Builder::new()
        .name(name.into())
        // The other end is gone only when the program ends.
        .spawn(move || drop(events.send(work())))
        .map(drop)
        .map_err(RouterError::System)
}

/// Zenoh panics where a required plugin can't be loaded or started; here that is an error like any other.
fn open(config: Config, limits: &SessionLimits) -> Result<Opened, RouterError> {
    let opening = thread::current().id();
    let on_panic = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        if thread::current().id() != opening {
            on_panic(panic);
        }
    }));
    let opening = || ZRuntime::Application.block_in_place(open_runtime(config, limits));
    match panic::catch_unwind(AssertUnwindSafe(opening)) {
        Ok(opened) => opened.map_err(RouterError::Open),
        Err(panic) => Err(RouterError::Panic(with_advice(reason(panic)))),
    }
}

/// Does what `zenoh::open` does, and keeps the runtime: it tells of each session that begins.
async fn open_runtime(config: Config, limits: &SessionLimits) -> zenoh::Result<Opened> {
    let mut runtime = RuntimeBuilder::new(config).build().await?;
    let dynamic = DynamicRuntime::from(runtime.clone());
    dynamic.new_handler(Arc::new(limits.logins()));
    let session = zenoh::session::init(dynamic).await?;
    runtime.start().await?;
    Ok(Opened { runtime, session })
}

/// Says where a plugin comes from, if its library is what is missing.
fn with_advice(reason: String) -> String {
    if !(reason.contains("libzenoh_plugin_") && reason.contains("not found")) {
        return reason;
    }
    format!(
        "{reason}. Name its folder by --plugin-search-dir; scripts/build-plugins builds Zenoh's REST plugin together with a \
         router that loads it (config/README.md, \"Plugins\")"
    )
}

fn reason(panic: Box<dyn Any + Send>) -> String {
    match panic.downcast::<String>() {
        Ok(text) => *text,
        Err(panic) => panic
            .downcast::<&str>()
            .map_or_else(|_| "no reason given".into(), |text| (*text).to_owned()),
    }
}

/// Why the router does not run.
#[derive(Debug, thiserror::Error)]
pub enum RouterError {
    /// A listener, a connection that must be there, or the login file: the cause says which.
    #[error("can't start")]
    Open(#[source] zenoh::Error),
    /// Mostly a plugin: the text says which, and why.
    #[error("can't start: {0}")]
    Panic(String),
    /// The system refuses a thread or a signal handler.
    #[error("the system refuses what a program needs")]
    System(#[source] io::Error),
}

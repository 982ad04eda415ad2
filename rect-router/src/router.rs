//! The router's life: opened, running, closed within a bound.

use std::{
    any::Any,
    io,
    panic::{self, AssertUnwindSafe},
    sync::mpsc::{self, Receiver, Sender},
    thread,
    time::Duration,
};

use sd_notify::NotifyState;
use zenoh::{Config, Session, Wait};

use crate::{
    robot::{self, Robot, Running},
    signals, status,
};

/// How long peers are given to take note that the router ends.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

enum Event {
    Opened(Result<Session, RouterError>),
    Closed,
    StopAsked,
}

/// Runs a router until a signal ends it; `robot`: what RECT adds to it.
pub fn run(config: Config, robot: Option<Robot>) -> Result<(), RouterError> {
    let (events, next) = mpsc::channel();
    signals::watch(events.clone(), || Event::StopAsked).map_err(RouterError::System)?;

    // Opening can wait for peers, and so it has a thread of its own: a signal is heard all the while.
    spawn("open", &events, move || Event::Opened(open(config)))?;
    let session = match next.recv() {
        Ok(Event::Opened(opened)) => opened?,
        _ => return Ok(()),
    };
    status::serve(&session).map_err(RouterError::Open)?;
    let running = robot
        .map(|robot| robot.start(&session, None))
        .transpose()
        .map_err(RouterError::Open)?;
    tracing::info!("rect-router is up, with id {}", session.zid());
    tell_systemd();

    match next.recv() {
        Ok(Event::StopAsked) => close(session, running, &events, &next),
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
    session: Session,
    running: Option<Running>,
    events: &Sender<Event>,
    next: &Receiver<Event>,
) -> Result<(), RouterError> {
    spawn("close", events, move || {
        if let Err(error) = robot::close(&session, running) {
            tracing::warn!("while closing: {error}");
        }
        Event::Closed
    })?;
    match next.recv_timeout(CLOSE_TIMEOUT) {
        Ok(_) => tracing::info!("closed"),
        Err(_) => tracing::warn!("not all links were closed within {CLOSE_TIMEOUT:?}; ending"),
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
fn open(config: Config) -> Result<Session, RouterError> {
    let opening = thread::current().id();
    let on_panic = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        if thread::current().id() != opening {
            on_panic(panic);
        }
    }));
    match panic::catch_unwind(AssertUnwindSafe(|| zenoh::open(config).wait())) {
        Ok(opened) => opened.map_err(RouterError::Open),
        Err(panic) => Err(RouterError::Panic(reason(panic))),
    }
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

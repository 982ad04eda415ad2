//! Opens the router, runs it until a signal arrives, and closes it within a time limit.

use std::{
    any::Any,
    io, mem,
    panic::{self, AssertUnwindSafe},
    sync::{
        mpsc::{self, Receiver, RecvTimeoutError, Sender},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use rect_core::text::humanize;
use sd_notify::NotifyState;
use zenoh::{
    internal::runtime::{DynamicRuntime, Runtime, RuntimeBuilder, ZRuntime},
    Config, Session, Wait,
};
use zenoh_link_table::succession::ZenohNode;

use crate::{
    limits::SessionLimits,
    logging, memory,
    robot_services::{self, RobotServices, RunningServices},
    self_check::{self, Look, SelfCheck},
    sessions::SessionReports,
    signals, status,
};

/// Maximum time for closing the links, which notifies the peers.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(5);

/// A running Zenoh runtime, a session in it, and the services that answer on the session.
struct Opened {
    runtime: Runtime,
    session: Session,
    services: Option<RunningServices>,
}

enum Event {
    Opened(Result<Opened, RouterError>),
    Closed,
    StopRequested,
}

/// Runs a router until a signal stops it. `robot` contains the services that RECT adds to the router, if any.
///
/// # Errors
/// Fails if the router, a listener or a service cannot be started.
pub fn run(
    mut config: Config,
    limits: SessionLimits,
    robot: Option<RobotServices>,
) -> Result<(), RouterError> {
    limits
        .apply(&mut config)
        .map_err(|error| RouterError::Open(error.into()))?;
    let (events, next) = mpsc::channel();
    signals::watch(events.clone(), || Event::StopRequested).map_err(RouterError::System)?;

    // Opening may wait for peers; on a separate thread it does not delay the handling of signals.
    spawn("open", &events, move || {
        Event::Opened(open(config, &limits, robot))
    })?;
    let opened = match next.recv() {
        Ok(Event::Opened(opened)) => opened?,
        _ => return Ok(()),
    };
    tracing::info!("rect-router is up, with id {}", opened.session.zid());
    notify_systemd(NotifyState::Ready);

    let mut check = SelfCheck::start(&opened.session).map_err(RouterError::System)?;
    let mut freed_at = Instant::now();
    loop {
        match next.recv_timeout(self_check::EVERY) {
            Ok(Event::StopRequested) => return close(opened, &events, &next),
            Err(RecvTimeoutError::Timeout) => {}
            _ => return Ok(()),
        }
        match check.look() {
            Look::Answered => notify_systemd(NotifyState::Watchdog),
            Look::Unanswered => tracing::warn!("the router has not answered its own question yet"),
            Look::Failed => {
                // Closing would wait for the part that has failed.
                mem::forget(opened);
                return Err(RouterError::Failed);
            }
        }
        logging::sum_up_repeated();
        if freed_at.elapsed() >= memory::RETURNED_EVERY {
            memory::return_freed();
            freed_at = Instant::now();
        }
    }
}

/// Reports a state to systemd, if the router is a service of `Type=notify`.
fn notify_systemd(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!("cannot notify systemd: {error}");
    }
}

fn close(
    opened: Opened,
    events: &Sender<Event>,
    next: &Receiver<Event>,
) -> Result<(), RouterError> {
    spawn("close", events, move || {
        let closed = robot_services::close(&opened.session, opened.services)
            .and_then(|()| opened.runtime.close().wait());
        if let Err(error) = closed {
            tracing::warn!("error while closing the links: {error}");
        }
        Event::Closed
    })?;
    match next.recv_timeout(CLOSE_TIMEOUT) {
        Ok(_) => tracing::info!("closed"),
        Err(_) => tracing::warn!(
            "not all links were closed within {}; exiting anyway",
            humanize::duration(CLOSE_TIMEOUT)
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
        // Sending fails only while the program exits, when the receiver is dropped.
        .spawn(move || drop(events.send(work())))
        .map(drop)
        .map_err(RouterError::System)
}

/// Opens the router. Zenoh panics if a required plugin cannot be loaded or started; the panic is returned as an error.
fn open(
    config: Config,
    limits: &SessionLimits,
    robot: Option<RobotServices>,
) -> Result<Opened, RouterError> {
    let opening_thread = thread::current().id();
    let on_panic = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        if thread::current().id() != opening_thread {
            on_panic(panic);
        }
    }));
    match panic::catch_unwind(AssertUnwindSafe(|| open_services(config, limits, robot))) {
        Ok(opened) => opened.map_err(RouterError::Open),
        Err(panic) => Err(RouterError::Panic(with_advice(reason(panic)))),
    }
}

/// Opens a session as `zenoh::open` does, but keeps the runtime in order to observe the sessions that it accepts. The
/// services are started before the listeners, so that the first program that connects already finds them.
fn open_services(
    config: Config,
    limits: &SessionLimits,
    robot: Option<RobotServices>,
) -> zenoh::Result<Opened> {
    let (mut runtime, session) = ZRuntime::Application.block_in_place(async {
        let runtime = RuntimeBuilder::new(config).build().await?;
        let dynamic = DynamicRuntime::from(runtime.clone());
        dynamic.new_handler(Arc::new(limits.logins()));
        dynamic.new_handler(Arc::new(SessionReports::of(ZenohNode {
            zid: runtime.zid().into(),
            whatami: runtime.whatami(),
        })));
        let session = zenoh::session::init(dynamic).await?;
        zenoh::Result::Ok((runtime, session))
    })?;
    status::serve(&session)?;
    let services = robot.map(|robot| robot.start(&session, None)).transpose()?;
    ZRuntime::Application.block_in_place(runtime.start())?;
    Ok(Opened {
        runtime,
        session,
        services,
    })
}

/// Appends advice to the error of a missing plugin library.
fn with_advice(reason: String) -> String {
    if !(reason.contains("libzenoh_plugin_") && reason.contains("not found")) {
        return reason;
    }
    format!(
        "{reason}. Give its folder with --plugin-search-dir; scripts/build-plugins builds Zenoh's REST plugin together with \
         a router that loads it (docs/reference/configuration.md, \"Plugins\")"
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

/// The reason why the router could not be started.
#[derive(Debug, thiserror::Error)]
pub enum RouterError {
    /// A listener or a required connection failed, or the login file is invalid; the source says which.
    #[error("cannot start")]
    Open(#[source] zenoh::Error),
    /// Zenoh panicked, usually because of a plugin; the text names it and the reason.
    #[error("cannot start: {0}")]
    Panic(String),
    /// The running router no longer answers. The log before states what has failed.
    #[error(
        "the router has not answered its own questions for {} and ends, so that it can be started again; its log states what has failed",
        humanize::duration(self_check::EVERY * self_check::MAX_UNANSWERED)
    )]
    Failed,
    /// A thread or a signal handler could not be created.
    #[error("cannot create a thread or a signal handler")]
    System(#[source] io::Error),
}

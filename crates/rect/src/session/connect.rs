//! Opens a session with a router within a time limit, and queries the router for the name of its robot.
use std::{thread, time::Duration};

use rect_core::session::{
    router::{robot_of_router, ROBOT_TIMEOUT},
    settings::DIAGNOSIS,
};
use tokio::{
    runtime::{Handle, RuntimeFlavor},
    sync::oneshot,
};
use zenoh::{Config, Session, Wait};

use crate::error::Error;

/// Why an attempt to open a session failed.
pub(super) enum NotOpened {
    /// Zenoh's reason.
    Zenoh(zenoh::Error),
    /// It took longer than the limit.
    TimedOut,
}

/// Checks the runtime of the caller. In another one, Zenoh panics.
pub(super) fn check_runtime() -> Result<(), Error> {
    let flavor = Handle::try_current().map(|runtime| runtime.runtime_flavor());
    let found = match flavor {
        Ok(RuntimeFlavor::CurrentThread) => "this one has a single thread",
        Ok(_) => return Ok(()),
        Err(_) => "there is none here",
    };
    Err(Error::Runtime { found })
}

/// Makes one attempt to open a session.
///
/// # Errors
/// Returns why the session cannot be opened in time, or the error that no thread can be started.
pub(super) async fn open(
    config: Config,
    limit: Duration,
) -> Result<Result<Session, NotOpened>, Error> {
    let (done, opened) = oneshot::channel();
    // Zenoh blocks the thread, for minutes if the address does not respond. A separate thread can be abandoned, whereas a
    // runtime waits for its threads when it is dropped.
    let attempt = move || {
        if let Err(Ok(session)) = done.send(attempt(config)) {
            // The caller no longer waits for the session.
            if let Err(error) = session.close().wait() {
                tracing::debug!("cannot close the session: {error}");
            }
        }
    };
    let thread = thread::Builder::new().name("rect-open".into());
    thread.spawn(attempt).map_err(Error::thread)?;
    Ok(match tokio::time::timeout(limit, opened).await {
        Ok(Ok(opened)) => opened.map_err(NotOpened::Zenoh),
        Ok(Err(_)) => Err(NotOpened::Zenoh("Zenoh panicked".into())),
        Err(_) => Err(NotOpened::TimedOut),
    })
}

fn attempt(config: Config) -> zenoh::Result<Session> {
    let error = match zenoh::open(config.clone()).wait() {
        Ok(session) => return Ok(session),
        Err(error) => error,
    };
    Err(reason(config).unwrap_or(error))
}

/// Returns the reason why the router cannot be reached, or `None` if it is reachable by now.
fn reason(mut config: Config) -> Option<zenoh::Error> {
    for (key, value) in DIAGNOSIS {
        config.insert_json5(key, value).ok()?;
    }
    match zenoh::open(config).wait() {
        Ok(session) => {
            if let Err(error) = session.close().wait() {
                tracing::debug!("cannot close the session: {error}");
            }
            None
        }
        Err(error) => Some(error),
    }
}

/// How often it is examined whether the router closes the session, and the pause before that.
const LOOKS: usize = 3;
const PAUSE: Duration = Duration::from_millis(30);

/// Returns whether the router, which has not named its robot, has closed the session.
pub(super) async fn is_closed(session: &Session) -> bool {
    let info = session.info();
    for _ in 0..LOOKS {
        tokio::time::sleep(PAUSE).await;
        let is_open = info.routers_zid().await.next().is_some();
        if !is_open && info.peers_zid().await.next().is_none() {
            return true;
        }
    }
    false
}

/// Returns the keys of the liveliness tokens that name the robot of the session's router. The list is empty if the router
/// serves no robot or does not reply in time. The router replies itself, so the query is not sent over radio links.
pub(super) async fn tokens_of_router(session: &Session) -> Vec<String> {
    let Some(id) = session.info().routers_zid().await.next() else {
        return Vec::new();
    };
    let asked = session
        .liveliness()
        .get(robot_of_router(&id.to_string()))
        .timeout(ROBOT_TIMEOUT);
    let replies = match asked.await {
        Ok(replies) => replies,
        Err(error) => {
            tracing::debug!("cannot query the router for the name of its robot: {error}");
            return Vec::new();
        }
    };
    let mut tokens = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        tokens.extend(
            reply
                .into_result()
                .ok()
                .map(|sample| sample.key_expr().as_str().to_owned()),
        );
    }
    tokens
}

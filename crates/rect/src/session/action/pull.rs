//! Receives the large results of goals.
use std::{
    sync::{Arc, Mutex},
    time::Instant,
};

use rect_core::{
    action::{
        pull::{PullError, ResultPull},
        result::LargeResult,
        state::Phase,
    },
    message::payload::Payload,
    transfer::Progress,
};
use tokio::task::JoinHandle;

use super::run::Followed;
use crate::{
    error::Error,
    session::{
        executor::Executor,
        shared::{lock, NoItems, Shared},
    },
};

/// The large result of a goal, as far as it was received.
#[derive(Default)]
pub(super) struct Pulled {
    /// Locked by the task that waits for the result.
    state: tokio::sync::Mutex<PullState>,
    running: Mutex<Option<Arc<Shared<ResultPull>>>>,
}

type Outcome = Result<Result<Payload, PullError>, Error>;

#[derive(Default)]
enum PullState {
    #[default]
    None,
    Running(JoinHandle<Outcome>),
    Received(Payload),
}

impl Pulled {
    /// Returns how much of the result has arrived, while it does.
    pub(super) fn progress(&self) -> Option<Progress> {
        Some(lock(&self.running).as_ref()?.driver().progress())
    }

    /// Returns the description of the result, for the text of a timeout.
    pub(super) fn expected(&self) -> Option<String> {
        Some(lock(&self.running).as_ref()?.driver().expected())
    }

    fn stop(&self) {
        if let Some(running) = lock(&self.running).take() {
            running.driver().stop();
            running.wake();
        }
    }
}

impl Drop for Pulled {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Followed {
    /// Receives a large result. If the future is dropped, the reception goes on, and the next call waits for it.
    pub(super) async fn pull(&self, result: &LargeResult) -> Result<Payload, Error> {
        let mut state = self.pulled.state.lock().await;
        if let PullState::Received(payload) = &*state {
            return Ok(payload.clone());
        }
        if let PullState::None = &*state {
            *state = PullState::Running(self.start_pull(result)?);
        }
        let PullState::Running(running) = &mut *state else {
            return Err(Error::Closed);
        };
        let outcome = running.await.unwrap_or(Err(Error::Closed));
        *state = PullState::None;
        *lock(&self.pulled.running) = None;
        let payload = outcome?.map_err(unavailable)?;
        *state = PullState::Received(payload.clone());
        Ok(payload)
    }

    fn start_pull(&self, result: &LargeResult) -> Result<JoinHandle<Outcome>, Error> {
        let inner = &self.robot.inner;
        let (action, id) = (&self.action, &self.id);
        let now = Instant::now();
        let pull = ResultPull::new(&inner.place, &self.target, action, id, result, now);
        let executor = Executor::new(&inner.session, pull.map_err(unavailable)?, NoItems);
        *lock(&self.pulled.running) = Some(executor.shared().clone());
        // A request waits while a link has no room.
        Ok(inner
            .runtime
            .spawn_blocking(move || executor.run_blocking()))
    }
}

fn unavailable(error: PullError) -> Error {
    match error {
        PullError::Closed => Error::Closed,
        PullError::Unavailable(reason) => Error::Goal {
            phase: Phase::Done,
            reason,
        },
    }
}

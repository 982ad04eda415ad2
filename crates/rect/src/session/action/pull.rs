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
    name::Name,
    transfer::Progress,
};
use tokio::task::JoinHandle;

use crate::{
    error::Error,
    session::{
        executor::Executor,
        robot::Robot,
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

    /// Receives the large result of a goal. If the future is dropped, the reception goes on, and the next call waits for it.
    pub(super) async fn pull(
        &self,
        robot: &Robot,
        goal: (&Name, &str, &str),
        result: &LargeResult,
    ) -> Result<Payload, Error> {
        let mut state = self.state.lock().await;
        if let PullState::Received(payload) = &*state {
            return Ok(payload.clone());
        }
        if let PullState::None = &*state {
            *state = PullState::Running(self.start(robot, goal, result)?);
        }
        let PullState::Running(running) = &mut *state else {
            return Err(Error::Closed);
        };
        let outcome = running.await.unwrap_or(Err(Error::Closed));
        *state = PullState::None;
        *lock(&self.running) = None;
        let payload = outcome?.map_err(unavailable)?;
        *state = PullState::Received(payload.clone());
        Ok(payload)
    }

    fn start(
        &self,
        robot: &Robot,
        (target, action, id): (&Name, &str, &str),
        result: &LargeResult,
    ) -> Result<JoinHandle<Outcome>, Error> {
        let inner = &robot.inner;
        let pull = ResultPull::new(&inner.place, target, action, id, result, Instant::now());
        let executor = Executor::new(&inner.session, pull.map_err(unavailable)?, NoItems);
        *lock(&self.running) = Some(executor.shared().clone());
        // A request waits while a link has no room.
        Ok(inner
            .runtime
            .spawn_blocking(move || executor.run_blocking()))
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

fn unavailable(error: PullError) -> Error {
    match error {
        PullError::Closed => Error::Closed,
        PullError::Unavailable(reason) => Error::Goal {
            phase: Phase::Done,
            reason,
        },
    }
}

//! Stops an outgoing transfer.
use std::sync::{Arc, Mutex, PoisonError};

use rect_core::transfer::push::TransferPush;

use crate::session::shared::Shared;

/// Stops a transfer, also one whose thread has not begun to offer it. Clones stop the same transfer.
#[derive(Clone, Default)]
pub(super) struct Stop(Arc<Mutex<StopState>>);

#[derive(Default)]
struct StopState {
    is_stopped: bool,
    running: Option<Arc<Shared<TransferPush>>>,
}

/// Stops the transfer when dropped.
pub(super) struct StopOnDrop(pub(super) Stop);

impl Stop {
    fn stop(&self) {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.is_stopped = true;
        if let Some(running) = state.running.take() {
            running.driver().stop();
            running.wake();
        }
    }

    /// Makes the driver stoppable. Returns `false` if the transfer was stopped already.
    pub(super) fn on_running(&self, running: &Arc<Shared<TransferPush>>) -> bool {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.running = Some(running.clone());
        !state.is_stopped
    }
}

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.stop();
    }
}

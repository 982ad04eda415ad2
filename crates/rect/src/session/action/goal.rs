//! A goal as its handler sees it.
use std::{
    fmt,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    time::Duration,
};

use rect_core::{
    action::{state::Feedback, to_optional_value},
    message::payload::{Payload, ToPayload},
};
use tokio::sync::watch;

use crate::error::Error;

/// A goal that a handler carries out; see [`Robot::action`](crate::Robot::action). Clones are the same one.
#[derive(Clone)]
pub struct Goal {
    pub(super) on_feedback: Arc<dyn Fn(Feedback) + Send + Sync>,
    /// The id, which its client has chosen.
    pub id: String,
    /// The client, which has started it: `<robot>/<program>`. Zenoh does not verify the name.
    pub by: String,
    /// The goal itself: `goal.payload.value::<Target>()`. Empty if its client has given none.
    pub payload: Payload,
    pub(super) cancel: Cancel,
}

/// The wish that a goal ends.
#[derive(Clone)]
pub(super) struct Cancel {
    reason: watch::Receiver<Option<String>>,
    /// Whether the handler knows.
    is_noticed: Arc<AtomicBool>,
}

/// A goal was cancelled while its handler slept.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled: {0}")]
pub struct Cancelled(pub String);

impl ToPayload for Cancelled {
    fn to_payload(&self) -> Result<Payload, rect_core::message::payload::PayloadError> {
        self.to_string().to_payload()
    }
}

impl Goal {
    /// Reports news to those who follow the goal: a value, which may be empty, and how much is done, from 0 to 1. The newest counts, and it is sent 10 times a
    /// second at most, without delaying anything else. Does not wait.
    ///
    /// # Errors
    /// [`Error::Payload`] if the value cannot be serialized, and [`Error::Action`] if it has more than 48 kB.
    pub fn feedback(&self, value: impl ToPayload, progress: Option<f64>) -> Result<(), Error> {
        let payload = value.into_payload()?.sendable()?;
        let value = to_optional_value(&payload).map_err(|reason| Error::Action { reason })?;
        (self.on_feedback)(Feedback::new(value, progress));
        Ok(())
    }

    /// Returns whether the handler should end: somebody has cancelled the goal, a newer one takes its place, its client has been away for too long, or the
    /// fleet is stopped. If the handler returns after this was true, the goal counts as cancelled, and otherwise as done.
    pub fn is_cancelled(&self) -> bool {
        self.cancel_reason().is_some()
    }

    /// Returns why the handler should end, as [`is_cancelled`](Self::is_cancelled) describes.
    pub fn cancel_reason(&self) -> Option<String> {
        let reason = self.cancel.reason.borrow().clone();
        if reason.is_some() {
            self.cancel.is_noticed.store(true, Ordering::Relaxed);
        }
        reason
    }

    /// Waits until the handler should end, and returns why.
    ///
    /// ```no_run
    /// # async fn drive() {}
    /// # async fn carry_out(goal: rect::Goal) {
    /// tokio::select! {
    ///     () = drive() => {}
    ///     reason = goal.cancelled() => println!("stopped: {reason}"),
    /// }
    /// # }
    /// ```
    ///
    /// # Cancel safety
    /// The future can be dropped; the next call waits again.
    pub async fn cancelled(&self) -> String {
        let mut reason = self.cancel.reason.clone();
        loop {
            if let Some(reason) = self.cancel_reason() {
                return reason;
            }
            if reason.changed().await.is_err() {
                std::future::pending::<()>().await;
            }
        }
    }

    /// Sleeps.
    ///
    /// # Errors
    /// [`Cancelled`] as soon as the handler should end.
    ///
    /// # Cancel safety
    /// The future can be dropped.
    pub async fn sleep(&self, time: Duration) -> Result<(), Cancelled> {
        match tokio::time::timeout(time, self.cancelled()).await {
            Ok(reason) => Err(Cancelled(reason)),
            Err(_) => Ok(()),
        }
    }
}

impl Cancel {
    /// Creates a goal that nobody has cancelled, and the sender of the reason.
    pub(super) fn new() -> (watch::Sender<Option<String>>, Self) {
        let (sender, reason) = watch::channel(None);
        let is_noticed = Arc::default();
        (sender, Self { reason, is_noticed })
    }

    pub(super) fn is_noticed(&self) -> bool {
        self.is_noticed.load(Ordering::Relaxed)
    }
}

impl fmt::Debug for Goal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Goal")
            .field("id", &self.id)
            .field("by", &self.by)
            .field("payload", &self.payload)
            .finish_non_exhaustive()
    }
}

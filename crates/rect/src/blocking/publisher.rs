//! Defines the blocking form of a publisher.
use std::{sync::Arc, time::Duration};

use super::Runtime;
use crate::{session, Error, Payload, Topic, ValueOf};

/// Publishes on one topic, and reports whether subscribers receive the messages; created by
/// [`Robot::publisher`](super::Robot::publisher).
#[derive(Debug)]
pub struct Publisher<T = Payload> {
    pub(super) publisher: session::Publisher<T>,
    pub(super) runtime: Arc<Runtime>,
}

impl<T> Publisher<T> {
    /// Publishes `value` to every subscriber. Blocks while the queue of the link is full.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::publish`].
    pub fn publish(&self, value: impl ValueOf<T>) -> Result<(), Error> {
        self.runtime.complete(self.publisher.publish(value))
    }

    /// Returns whether at least one subscriber of another program receives the messages.
    pub fn has_subscribers(&self) -> bool {
        self.publisher.has_subscribers()
    }

    /// Blocks until a subscriber receives the messages, at most for `timeout`.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Publisher::wait_for_subscriber`].
    pub fn wait_for_subscriber(&self, timeout: Duration) -> Result<(), Error> {
        self.runtime
            .wait(self.publisher.wait_for_subscriber(timeout))
    }

    /// Returns the topic.
    pub fn topic(&self) -> &Topic {
        self.publisher.topic()
    }
}

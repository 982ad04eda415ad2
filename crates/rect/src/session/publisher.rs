//! Defines [`Publisher`], which publishes on one topic and knows whether there are subscribers.
use std::{fmt, marker::PhantomData, sync::Arc, time::Duration};

use rect_core::{
    message::payload::{Payload, ValueOf},
    name::topic::Topic,
    session::publication::PublicationKey,
};
use tokio::sync::watch;
use zenoh::{matching::MatchingListener, sample::Locality, Wait};

use super::{publication::Publication, robot::Robot};
use crate::error::{valid, Error};

/// Publishes on one topic, and reports whether subscribers receive the messages; created by [`Robot::publisher`].
///
/// [`Robot::publish`] needs no publisher. A publisher is for programs that wait until a subscriber is there, or that skip
/// work while nobody subscribes. `T` is the type of the values.
pub struct Publisher<T = Payload> {
    robot: Robot,
    key: PublicationKey,
    publication: Arc<Publication>,
    /// Whether there are subscribers; `None` until that is known.
    matching: watch::Receiver<Option<bool>>,
    _listener: MatchingListener<()>,
    _observer: zenoh::pubsub::Publisher<'static>,
    values: PhantomData<fn(T)>,
}

impl Robot {
    /// Declares a publisher of `topic`, with the urgency, codec and expiry of this handle.
    ///
    /// `T` is the type of the values: a type that serde serializes, which is published as JSON, or [`Payload`] for everything
    /// that is [`ToPayload`](crate::ToPayload).
    ///
    /// ```no_run
    /// # async fn publish(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let angles = robot.publisher::<f64>("arm/angle").await?;
    /// angles.wait_for_subscriber(std::time::Duration::from_secs(10)).await?;
    /// angles.publish(12.5).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the topic is invalid, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect, except that a session for the urgency of this handle may have been opened.
    pub async fn publisher<T>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<Publisher<T>, Error> {
        let key = self.publication_key(valid(topic)?, None);
        let publication = self.publication(key.clone()).await?;
        let refused = || Error::zenoh("cannot observe the subscribers");
        // It never publishes: the subscribers of this program match the other publisher, too.
        let observer = self
            .inner
            .session
            .declare_publisher(publication.publisher().key_expr().clone().into_owned())
            .allowed_destination(Locality::Remote)
            .wait()
            .map_err(refused())?;
        let (sender, matching) = watch::channel(None);
        let on_change = sender.clone();
        // Zenoh drops the callback with the session, which ends the waits.
        let listener = observer
            .matching_listener()
            .callback(move |status| {
                on_change.send_replace(Some(status.matching()));
            })
            .wait()
            .map_err(refused())?;
        let status = observer.matching_status().await;
        let is_matching = status.map_err(refused())?.matching();
        // A report of the listener in the meantime is newer.
        sender.send_if_modified(|known| {
            let is_first = known.is_none();
            known.get_or_insert(is_matching);
            is_first
        });
        Ok(Publisher {
            robot: self.clone(),
            key,
            publication,
            matching,
            _listener: listener,
            _observer: observer,
            values: PhantomData,
        })
    }
}

impl<T> Publisher<T> {
    /// Publishes `value` to every subscriber. Waits while the queue of the link is full.
    ///
    /// # Errors
    /// Returns the errors of [`Robot::publish`].
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the message may still be published: another thread may be about to
    /// send it.
    pub async fn publish(&self, value: impl ValueOf<T>) -> Result<(), Error> {
        let payload = self.robot.payload(value.payload()?)?;
        if let Some(retention) = self.robot.retention() {
            let topic = self.key.topic.clone();
            return self.robot.retain(retention, topic, payload).await;
        }
        let put = (self.robot).put(&self.publication, payload, Duration::ZERO)?;
        put.done().await
    }

    /// Returns whether at least one subscriber of another program receives the messages, on this or another robot.
    pub fn has_subscribers(&self) -> bool {
        *self.matching.borrow() == Some(true)
    }

    /// Waits until a subscriber receives the messages.
    ///
    /// # Errors
    /// [`Error::TimedOut`] if there is none within `timeout`, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future ends the wait. Nothing else changes.
    pub async fn wait_for_subscriber(&self, timeout: Duration) -> Result<(), Error> {
        let mut matching = self.matching.clone();
        let found = async { matching.wait_for(|now| *now == Some(true)).await.is_ok() };
        match tokio::time::timeout(timeout, found).await {
            Ok(true) => Ok(()),
            Ok(false) => Err(Error::Closed),
            Err(_) => Err(Error::TimedOut {
                expected: format!("subscriber of {}", self.key.topic),
                timeout,
            }),
        }
    }

    /// Returns the topic.
    pub fn topic(&self) -> &Topic {
        &self.key.topic
    }
}

impl<T> fmt::Debug for Publisher<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Publisher")
            .field("topic", &self.key.topic)
            .field("has_subscribers", &self.has_subscribers())
            .finish_non_exhaustive()
    }
}

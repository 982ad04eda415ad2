//! Publishes retained messages, asks for the last value of a topic, and forgets topics.
use std::time::{Instant, SystemTime};

use rect_core::{
    clock::unix::ms_since_1970,
    message::{
        attachment::Sent,
        encoding::Encoding,
        payload::{FromPayload, Payload},
        Message,
    },
    name::{topic::Topic, Name},
    state::{
        latest::Latest,
        page::Order,
        retain::{Outcome, Retain, NO_KEEPER},
    },
};

use super::{executor::Executor, robot::Robot, shared::NoItems, state::Retention};
use crate::error::{valid, Error};

impl Robot {
    /// Returns a handle that retains what it publishes: the router of this robot keeps the last value of each topic, and programs that
    /// start later, or whose link was interrupted, receive it.
    ///
    /// A subscription receives the value first, then each change, never one twice or an older one after a newer one
    /// ([`Message::retained`]). The value stays when this program ends. A robot's values have 256 kB at most, and one has 64 kB. Requests,
    /// streams and messages to one robot are not affected, and retained messages do not expire.
    ///
    /// ```no_run
    /// # async fn mode(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.retained().publish("mode", "auto").await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn retained(&self) -> Self {
        self.with_retention(Retention::InMemory)
    }

    /// Returns a handle as [`retained`](Self::retained) does, whose values also survive a restart of the robot. The router writes each one
    /// to its disk before it is published: for values that change rarely, such as a calibration.
    #[must_use]
    pub fn retained_on_disk(&self) -> Self {
        self.with_retention(Retention::OnDisk)
    }

    /// Returns the last value of a retained topic of `robot`, or nothing if that robot retains none or is not reachable. At once if a
    /// program of this robot subscribes to the topic; otherwise the other robot's router is asked.
    ///
    /// ```no_run
    /// # async fn mode(robot: rect::Robot) -> Result<(), rect::Error> {
    /// if let Some(message) = robot.latest::<String>("wombat-2", "mode").await? {
    ///     println!("{:?}", message.value);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Topic`] if an argument is invalid, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn latest<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<Option<Message<T::Value>>, Error> {
        let (robot, topic): (Name, Topic) = (valid(robot)?, valid(topic)?);
        let inner = &self.inner;
        let latest = Latest::new(inner.place.clone(), robot.clone(), topic, self.timeout);
        let found = Executor::new(&inner.session, latest, NoItems).run().await?;
        let Some(value) = found else {
            return match self.is_closed() {
                true => Err(Error::Closed),
                false => Ok(None),
            };
        };
        let mut message = value.message(robot);
        inner.decoder.decode_message(&mut message).await;
        Ok(Some(message.typed::<T>()))
    }

    /// Forgets a retained topic of this robot. Subscribers receive that as a message without a value ([`Retained::is_forgotten`]). Nothing
    /// happens if it has no value.
    ///
    /// # Errors
    /// [`Error::Topic`] if the topic is invalid, [`Error::NotRetained`] if no router keeps it, and [`Error::Closed`] if the session is
    /// closed.
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the topic may be forgotten or not.
    pub async fn forget(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<(), Error> {
        let topic: Topic = valid(topic)?;
        let running = self.inner.state.running()?;
        let order = running.driver().forget(&topic, now());
        self.give(topic, order).await
    }

    /// Gives a value to the router of this robot, which publishes it.
    pub(super) async fn retain(
        &self,
        retention: Retention,
        topic: Topic,
        payload: Payload,
    ) -> Result<(), Error> {
        self.retain_at(retention, topic, payload, now()).await
    }

    /// Retains the value of a recording again, or forgets its topic. `sent_ms`: when it was published, in milliseconds since 1970.
    #[cfg(feature = "recording")]
    pub(super) async fn replay_retained(
        &self,
        topic: Topic,
        value: Option<Payload>,
        sent_ms: u64,
    ) -> Result<(), Error> {
        let sent = Sent::Replayed(sent_ms);
        match value {
            Some(payload) => {
                self.retain_at(Retention::InMemory, topic, payload, sent)
                    .await
            }
            None => {
                let running = self.inner.state.running()?;
                let order = running.driver().forget(&topic, sent);
                self.give(topic, order).await
            }
        }
    }

    async fn retain_at(
        &self,
        retention: Retention,
        topic: Topic,
        payload: Payload,
        sent: Sent,
    ) -> Result<(), Error> {
        let running = self.inner.state.running()?;
        let size = payload.bytes.len();
        let (urgency, disk) = (self.urgency(), retention == Retention::OnDisk);
        let order = (running.driver()).set(&topic, payload, urgency, disk, sent);
        let given = self.give(topic, order).await;
        if given.is_ok() {
            self.inner.counting.on_sent(size);
        }
        given
    }

    async fn give(&self, topic: Topic, order: Order) -> Result<(), Error> {
        let inner = &self.inner;
        let running = inner.state.running()?;
        let retain = Retain::new(&inner.place, &order, Instant::now());
        let outcome = Executor::new(&inner.session, retain, NoItems).run().await?;
        match outcome {
            Outcome::Kept(kept) => {
                if let Some(warning) = &kept.warning {
                    inner.warnings.on_retention_problem(warning);
                }
                (running.driver()).on_kept(topic, &order, kept, Instant::now());
                running.wake();
                Ok(())
            }
            Outcome::Closed => Err(Error::Closed),
            Outcome::Refused(reason) => Err(Error::NotRetained {
                topic: topic.to_string(),
                reason,
            }),
            Outcome::NoKeeper => {
                if let Order::Set(value) = order {
                    let payload = Payload::new(value.bytes, Encoding::new(value.encoding));
                    self.send_plain(topic.clone(), payload).await?;
                }
                Err(Error::NotRetained {
                    topic: topic.to_string(),
                    reason: NO_KEEPER.to_owned(),
                })
            }
        }
    }
}

fn now() -> Sent {
    Sent::At(ms_since_1970(SystemTime::now()))
}

//! Sends requests to services and receives their replies.
use std::{
    fmt,
    future::{Future, IntoFuture},
    pin::pin,
    sync::Arc,
    task::{Context, Waker},
};

use rect_core::{
    message::{
        payload::{Payload, ToPayload},
        queue::{Queue, WhenFull},
    },
    name::{topic::Topic, Name},
    session::inquiry::{Inquiry, ReplyKind, MAX_REPLIES},
};
use zenoh::cancellation::CancellationToken;

use super::{
    convert,
    decoder::Decoder,
    queries,
    receive_queue::{QueueWriter, ReceiveQueue},
    robot::Robot,
};
use crate::error::Error;

/// The reply of a service to a request.
#[derive(Clone, Debug)]
pub struct Reply {
    /// The robot that replied.
    pub sender: Name,
    /// The value of the reply.
    pub payload: Payload,
}

/// Receives the replies to one request; created by [`Robot::request_all`]. Dropping it cancels the request.
pub struct Replies {
    queue: Arc<ReceiveQueue<zenoh::query::Reply>>,
    decoder: Arc<Decoder>,
    inquiry: Inquiry,
    /// The reply that is being decoded; the next call continues if the program has dropped the future of the last one.
    undecoded: Option<Reply>,
    cancellation: CancellationToken,
}

impl Robot {
    /// Sends a request to the service `topic` of `robot`, and waits for its first reply.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let reply = robot.request("wombat-2", "battery", "").await?;
    /// let volts: f64 = reply.payload.value()?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Service`] if the service replies with an error, [`Error::NoService`] if no program at `robot` serves
    /// the topic, [`Error::TimedOut`] if no reply arrives in time ([`with_timeout`](Self::with_timeout)); [`Error::Name`], [`Error::Topic`] or
    /// [`Error::Payload`] if an argument is invalid; [`Error::Codec`] if the codec of this handle does not support the
    /// value or the reply cannot be decoded; [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future cancels the request, whose reply is discarded. The service may have received it, and carry
    /// it out.
    pub async fn request<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        value: impl ToPayload,
    ) -> Result<Reply, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let robot = robot.try_into()?;
        let topic = topic.try_into()?;
        let (asked, service) = (robot.to_string(), topic.to_string());
        let mut replies = self.query(Some(robot), topic, value).await?;
        match replies.next().await {
            Some(reply) => reply,
            None => Err(self.no_service(asked, service).await),
        }
    }

    /// Sends a request to the service `topic` of all robots that provide it. Replies arrive until all services have replied
    /// or the time is up ([`with_timeout`](Self::with_timeout)).
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let mut replies = robot.request_all("battery", "").await?;
    /// while let Some(reply) = replies.next().await {
    ///     match reply {
    ///         Ok(reply) => println!("{}: {:?}", reply.sender, reply.payload),
    ///         Err(error) => eprintln!("{error}"),
    ///     }
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] or [`Error::Payload`] if an argument is invalid, [`Error::Codec`] if the codec of this handle
    /// does not support the value, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future cancels the request. Services may have received it, and carry it out.
    pub async fn request_all<T: TryInto<Topic>>(
        &self,
        topic: T,
        value: impl ToPayload,
    ) -> Result<Replies, Error>
    where
        Error: From<T::Error>,
    {
        self.query(None, topic.try_into()?, value).await
    }

    async fn query(
        &self,
        robot: Option<Name>,
        topic: Topic,
        value: impl ToPayload,
    ) -> Result<Replies, Error> {
        let inquiry = Inquiry::new(self.inner.place.clone(), robot, topic, self.timeout);
        let get = inquiry.get(self.payload(value)?, self.urgency());
        let queue = ReceiveQueue::new(Queue::new(MAX_REPLIES, WhenFull::Block));
        let cancellation = CancellationToken::default();
        // Zenoh drops the callback after the last reply.
        let writer = QueueWriter::new(&queue);
        let session = self.inner.urgency_sessions.of(self.urgency()).await;
        let asked = queries::builder(session, get)
            .cancellation_token(cancellation.clone())
            .callback(move |reply| {
                writer.push(reply);
            });
        asked
            .await
            .map_err(Error::zenoh("cannot send the request"))?;
        Ok(Replies {
            queue,
            decoder: self.inner.decoder.clone(),
            inquiry,
            undecoded: None,
            cancellation,
        })
    }

    /// Returns the error that no program of `robot` serves `topic`.
    pub(super) async fn no_service(&self, robot: String, topic: String) -> Error {
        let peers = self.peers().await.unwrap_or_default();
        Error::no_service(robot, topic, &peers)
    }
}

impl Replies {
    /// Waits for the next reply; returns `None` once all services have replied, or after the timeout was reported.
    ///
    /// # Errors
    /// [`Error::Service`] if a service replied with an error, [`Error::Codec`] if a reply cannot be decoded,
    /// [`Error::TimedOut`] if the timeout expired before all services had replied, and [`Error::Zenoh`] if the key of a
    /// reply is not that of a robot. Further calls return the other replies.
    ///
    /// # Cancel safety
    /// If the future is dropped, no reply is lost: the next call returns it.
    pub async fn next(&mut self) -> Option<Result<Reply, Error>> {
        if self.undecoded.is_none() {
            // Zenoh has a timer for each request; a second one would wake a thread each time.
            let reply = convert::reply(self.queue.pop().await?);
            match self.inquiry.on_reply(reply) {
                ReplyKind::Answer { sender, payload } => {
                    self.undecoded = Some(Reply { sender, payload });
                }
                ReplyKind::Error { robot, payload } => {
                    return Some(Err(Error::Service { robot, payload }));
                }
                ReplyKind::TimedOut => {
                    return Some(Err(Error::TimedOut {
                        expected: self.inquiry.expected(),
                        timeout: self.inquiry.timeout(),
                    }));
                }
                ReplyKind::NotOfARobot { key } => {
                    return Some(Err(Error::Zenoh {
                        operation: "the reply has no valid key of a robot",
                        source: format!("its key is {key:?}").into(),
                    }));
                }
            }
        }
        let Reply { sender, payload } = self.undecoded.as_mut()?;
        let decoded = self.decoder.decode(sender, payload).await;
        let reply = self.undecoded.take()?;
        Some(decoded.map(|()| reply).map_err(Error::from))
    }
}

impl fmt::Debug for Replies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Replies")
            .field("expected", &self.inquiry.expected())
            .finish_non_exhaustive()
    }
}

impl Drop for Replies {
    fn drop(&mut self) {
        // All services have replied.
        if self.queue.is_closed() {
            return;
        }
        self.queue.close();
        // Zenoh releases the request when this future is first polled. The rest of the future would wait for a callback that
        // is running now and finds the queue closed. That wait is not needed, and a task for it would wake a thread.
        let cancelled = pin!(self.cancellation.cancel().into_future());
        let _ = cancelled.poll(&mut Context::from_waker(Waker::noop()));
    }
}

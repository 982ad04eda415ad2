//! Sends requests to services and receives their replies.
use std::{
    fmt,
    future::{Future, IntoFuture},
    pin::{pin, Pin},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll, Waker},
};

use futures_core::Stream;
use rect_core::{
    driver::Get,
    message::{
        payload::{FromPayload, Payload, ToPayload},
        queue::{Queue, WhenFull},
    },
    name::{topic::Topic, Name},
    session::{
        inquiry::{Inquiry, ReplyKind, MAX_REPLIES},
        served::{Sent, Unanswered},
    },
};
use zenoh::cancellation::CancellationToken;

use super::{
    convert,
    next_item::NextItem,
    querier::Querier,
    queries,
    receive_queue::{QueueWriter, ReceiveQueue},
    retry::Retried,
    robot::Robot,
};
use crate::error::{valid, Error};

/// The reply of a service to a request.
#[derive(Clone, Debug)]
pub struct Reply<T = ()> {
    /// The robot that replied.
    pub sender: Name,
    /// The bytes of the reply with their encoding.
    pub payload: Payload,
    /// The value as the type that the program has stated.
    pub value: T,
    /// Whether the service shares its topic with other programs of the robot
    /// ([`allow_several`](crate::ServiceOptions::allow_several)). They have received the request, too, and carry it out.
    /// [`Robot::request`] discards their replies; [`Robot::request_all`] returns them.
    pub is_shared: bool,
}

/// Receives the replies to one request; created by [`Robot::request_all`] and [`Robot::request_stream`]. `T` is the type of their
/// values. It also implements [`futures_core::Stream`]. Dropping it cancels the request.
pub struct Replies<T: FromPayload = Payload> {
    pub(super) arriving: Arc<Arriving>,
    next: NextItem<Result<Reply<T::Value>, Error>>,
    cancellation: CancellationToken,
}

/// The replies to one request that the program has not read.
pub(super) struct Arriving {
    queue: Arc<ReceiveQueue<zenoh::query::Reply>>,
    pub(super) robot: Robot,
    topic: Topic,
    /// The robot that was asked; `None` if all were.
    asked: Option<Name>,
    state: Mutex<State>,
    querier: Arc<Querier>,
    sent: Sent,
}

struct State {
    inquiry: Inquiry,
    /// The replies that were being decoded when the program dropped the future; the next call continues.
    undecoded: Vec<Reply>,
    /// Whether the program has received the error with which a stream ended.
    is_end_reported: bool,
}

/// The robot that a reply comes from, if it is stated, and the reply or an error.
pub(super) type Received<T> = (Option<Name>, Result<Reply<T>, Error>);

/// A reply that is being decoded. It is kept for the next call unless it is taken.
struct Undecoded<'a> {
    /// Present until it is taken.
    reply: Option<Reply>,
    arriving: &'a Arriving,
}

impl Drop for Undecoded<'_> {
    fn drop(&mut self) {
        self.arriving.state().undecoded.extend(self.reply.take());
    }
}

impl Robot {
    /// Sends a request to the service `topic` of `robot`, and waits for its first reply. `T` is the type of the reply's value: a
    /// type that serde deserializes, or [`Payload`] for the payload as it is.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let volts = robot.request::<f64>("wombat-2", "battery", "").await?.value;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Service`] if the service replies with an error, [`Error::NoService`] if no program at `robot` serves
    /// the topic, [`Error::Interrupted`] if one may have received the request and does not reply because it ended, or a router or
    /// link did, [`Error::TimedOut`] if no reply arrives in time ([`with_timeout`](Self::with_timeout)); [`Error::Name`], [`Error::Topic`] or
    /// [`Error::Payload`] if an argument is invalid, or if the reply does not fit `T`; [`Error::Codec`] if the codec of this
    /// handle does not support the value or the reply cannot be decoded; [`Error::Option`] if the timeout of a
    /// [request that is repeated](Self::retrying) is too long; [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future cancels the request, whose reply is discarded. The service may have received it, and carry
    /// it out.
    pub async fn request<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<Reply<T::Value>, Error> {
        let (robot, topic): (Name, Topic) = (valid(robot)?, valid(topic)?);
        let payload = self.payload(value)?;
        let (mut once, mut rest) = (self, None);
        if self.retries {
            // Boxed: this future is large, and few requests need it.
            match Box::pin(self.retried(&robot, &topic, payload.clone())).await? {
                Retried::Ended { kind, inquiry } => {
                    let mut reply = Reply::of(kind, &inquiry)?;
                    let decoder = &self.inner.decoder;
                    decoder.decode(&reply.sender, &mut reply.payload).await?;
                    return reply.typed::<T>();
                }
                Retried::Plain { left } => once = rest.insert(self.with_timeout(left)),
            }
        }
        let replies = once.query::<T>(Some(robot), topic, payload, false).await?;
        match replies.next().await {
            Some(reply) => reply,
            None => Err(replies.arriving.unanswered().await),
        }
    }

    /// Sends a request to the service `topic` of `robot`, which sends several replies, such as the results of a scan.
    ///
    /// The stream ends with `None` only if all replies have arrived. If the program, a router or the link ends midway, the last item
    /// is [`Error::Interrupted`]. All replies have to arrive in time ([`with_timeout`](Self::with_timeout)). Dropping the stream ends
    /// the request, which its service learns ([`Request::is_wanted`](crate::Request::is_wanted)).
    ///
    /// ```no_run
    /// # async fn scan(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let replies = robot.request_stream::<f64>("wombat-2", "scan", "").await?;
    /// while let Some(reply) = replies.next().await {
    ///     println!("{}", reply?.value);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`], [`Error::Topic`] or [`Error::Payload`] if an argument is invalid, [`Error::Codec`] if the codec of this handle
    /// does not support the value, and [`Error::Closed`] if the session is closed. The stream returns the other errors of
    /// [`request`](Self::request).
    ///
    /// # Cancel safety
    /// Dropping the future cancels the request. The service may have received it, and carry it out.
    pub async fn request_stream<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<Replies<T>, Error> {
        let (robot, topic) = (valid(robot)?, valid(topic)?);
        let payload = self.payload(value)?;
        self.query(Some(robot), topic, payload, true).await
    }

    /// Sends a request to the service `topic` of all robots that provide it. Replies arrive until all services have replied
    /// or the time is up ([`with_timeout`](Self::with_timeout)). [`Replies::gather`] waits for all of them, and also names the robots
    /// that did not reply.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let replies = robot.request_all::<f64>("battery", "").await?;
    /// while let Some(reply) = replies.next().await {
    ///     match reply {
    ///         Ok(reply) => println!("{}: {}", reply.sender, reply.value),
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
    pub async fn request_all<T: FromPayload>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<Replies<T>, Error> {
        let topic = valid(topic)?;
        let payload = self.payload(value)?;
        self.query(None, topic, payload, false).await
    }

    async fn query<T: FromPayload>(
        &self,
        robot: Option<Name>,
        topic: Topic,
        payload: Payload,
        is_stream: bool,
    ) -> Result<Replies<T>, Error> {
        let inquiry = Inquiry::new(
            self.inner.place.clone(),
            robot.clone(),
            topic.clone(),
            self.timeout,
            &self.inner.request_ids,
        );
        let inquiry = if is_stream { inquiry.stream() } else { inquiry };
        let get = inquiry.get(payload, self.urgency());
        let queue = ReceiveQueue::new(Queue::new(MAX_REPLIES, WhenFull::Block));
        let cancellation = CancellationToken::default();
        // Zenoh drops the callback after the last reply.
        let writer = QueueWriter::new(&queue);
        let session = self.inner.urgency_sessions.of(self.urgency()).await;
        let querier = self.querier(session, &get.selector)?;
        let unsent = querier.served.unsent();
        let asked = queries::builder(session, get)
            .cancellation_token(cancellation.clone())
            .callback(move |reply| {
                writer.push(reply);
            });
        asked
            .await
            .map_err(Error::zenoh("cannot send the request"))?;
        let sent = unsent.taken(queue.is_finished_here(), || querier.is_served());
        let state = State {
            inquiry,
            undecoded: Vec::new(),
            is_end_reported: false,
        };
        Ok(Replies {
            arriving: Arc::new(Arriving {
                queue,
                robot: self.clone(),
                topic,
                asked: robot,
                state: Mutex::new(state),
                querier,
                sent,
            }),
            next: NextItem::default(),
            cancellation,
        })
    }

    /// Returns the error that no program of `robot`, or of the fleet (`None`), serves `topic`.
    pub(super) async fn no_service(&self, robot: Option<Name>, topic: String) -> Error {
        Error::NoService {
            robot,
            topic,
            available: self.peers().await.unwrap_or_default(),
        }
    }
}

impl Reply {
    /// Returns the reply that Zenoh has delivered, before it is decoded.
    fn of(kind: ReplyKind, inquiry: &Inquiry) -> Result<Self, Error> {
        match kind {
            ReplyKind::Answer {
                sender,
                payload,
                is_shared,
            } => Ok(Self {
                sender,
                payload,
                value: (),
                is_shared,
            }),
            ReplyKind::Error { robot, payload } => Err(Error::Service { robot, payload }),
            ReplyKind::TimedOut => Err(Error::TimedOut {
                expected: inquiry.expected(),
                timeout: inquiry.timeout(),
            }),
            ReplyKind::NotOfARobot { key } => Err(Error::Zenoh {
                operation: "the reply has no valid key of a robot",
                source: format!("its key is {key:?}").into(),
            }),
        }
    }

    fn typed<T: FromPayload>(self) -> Result<Reply<T::Value>, Error> {
        Ok(Reply {
            value: T::from_payload(&self.payload)?,
            sender: self.sender,
            payload: self.payload,
            is_shared: self.is_shared,
        })
    }
}

impl<T: FromPayload> Replies<T> {
    /// Waits for the next reply; returns `None` once all services have replied, or after the timeout was reported.
    ///
    /// # Errors
    /// [`Error::Interrupted`] and [`Error::NoService`] at the end of a [stream](Robot::request_stream) that is not complete;
    /// [`Error::Service`] if a service replied with an error, [`Error::Payload`] if a reply does not fit `T`, [`Error::Codec`] if
    /// it cannot be decoded, [`Error::TimedOut`] if the timeout expired before all services had replied, and [`Error::Zenoh`] if
    /// the key of a reply is not that of a robot. Further calls return the other replies.
    ///
    /// # Cancel safety
    /// If the future is dropped, no reply is lost: the next call returns it. The same holds for the [`Stream`], which keeps its
    /// wait.
    pub async fn next(&self) -> Option<Result<Reply<T::Value>, Error>> {
        self.arriving.next::<T>().await
    }
}

impl Arriving {
    async fn next<T: FromPayload>(&self) -> Option<Result<Reply<T::Value>, Error>> {
        let (_, reply) = self.received::<T>().await?;
        Some(reply)
    }

    /// Waits for the next reply or error.
    pub(super) async fn received<T: FromPayload>(&self) -> Option<Received<T::Value>> {
        let undecoded = self.state().undecoded.pop();
        let reply = match undecoded {
            Some(reply) => reply,
            None => match self.arrived().await? {
                Ok(reply) => reply,
                Err(error) => return Some((error.sender(), Err(error))),
            },
        };
        // The program may drop the future meanwhile.
        let mut undecoded = Undecoded {
            reply: Some(reply),
            arriving: self,
        };
        let Reply {
            sender, payload, ..
        } = undecoded.reply.as_mut()?;
        let decoder = &self.robot.inner.decoder;
        let decoded = decoder.decode(sender, payload).await;
        let reply = undecoded.reply.take()?;
        let sender = reply.sender.clone();
        let reply = decoded
            .map_err(Error::from)
            .and_then(|()| reply.typed::<T>());
        Some((Some(sender), reply))
    }

    /// Waits for the next reply that is not the mark of a stream's end.
    async fn arrived(&self) -> Option<Result<Reply, Error>> {
        loop {
            // Zenoh has a timer for each request; a second one would wake a thread each time.
            let Some(reply) = self.queue.pop().await else {
                let is_complete = {
                    let mut state = self.state();
                    let was_reported = std::mem::replace(&mut state.is_end_reported, true);
                    was_reported || state.inquiry.is_complete()
                };
                if is_complete {
                    return None;
                }
                return Some(Err(self.unanswered().await));
            };
            let inquiry = &mut self.state().inquiry;
            if let Some(kind) = inquiry.on_reply(convert::reply(reply)) {
                return Some(Reply::of(kind, inquiry));
            }
        }
    }

    /// Returns why the request ended without a reply, or without all replies of a stream.
    async fn unanswered(&self) -> Error {
        let is_started = self.state().inquiry.is_started();
        let unanswered = self.querier.served.unanswered(self.sent);
        match is_started || unanswered == Unanswered::Interrupted {
            true => self.interrupted(self.asked.clone()),
            false => self.no_service(self.asked.clone()).await,
        }
    }

    /// Returns the error that a robot, or one of all (`None`), may have carried out the request.
    pub(super) fn interrupted(&self, robot: Option<Name>) -> Error {
        Error::Interrupted {
            robot,
            topic: self.topic.to_string(),
        }
    }

    /// Returns the error that no program of a robot, or of the fleet (`None`), serves the topic.
    pub(super) async fn no_service(&self, robot: Option<Name>) -> Error {
        self.robot.no_service(robot, self.topic.to_string()).await
    }

    pub(super) fn topic(&self) -> &Topic {
        &self.topic
    }

    /// Closes the request. Returns the query that announces that, if the service waits for it.
    fn close(&self) -> Option<Get> {
        self.state().inquiry.close()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: FromPayload> Stream for Replies<T> {
    type Item = Result<Reply<T::Value>, Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let Self { arriving, next, .. } = &mut *self;
        next.poll(context, || {
            let arriving = arriving.clone();
            async move { arriving.next::<T>().await }
        })
    }
}

impl<T: FromPayload> fmt::Debug for Replies<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Replies")
            .field("expected", &self.arriving.state().inquiry.expected())
            .finish_non_exhaustive()
    }
}

impl<T: FromPayload> Drop for Replies<T> {
    fn drop(&mut self) {
        // All services have replied.
        if self.arriving.queue.is_closed() {
            return;
        }
        self.arriving.queue.close();
        // Zenoh releases the request when this future is first polled. The rest of the future would wait for a callback that
        // is running now and finds the queue closed. That wait is not needed, and a task for it would wake a thread.
        let cancelled = pin!(self.cancellation.cancel().into_future());
        let _ = cancelled.poll(&mut Context::from_waker(Waker::noop()));
        if let Some(get) = self.arriving.close() {
            let inner = &self.arriving.robot.inner;
            let session = inner.session.clone();
            // It must not block the program.
            (inner.runtime).spawn(async move { queries::get(&session, get, |_| {}, || {}) });
        }
    }
}

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
    driver::Sample,
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
    decoder::Decoder,
    next_item::NextItem,
    querier::Querier,
    queries,
    receive_queue::{QueueWriter, ReceiveQueue},
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
}

/// Receives the replies to one request; created by [`Robot::request_all`]. `T` is the type of their values. It also
/// implements [`futures_core::Stream`]. Dropping it cancels the request.
pub struct Replies<T: FromPayload = Payload> {
    arriving: Arc<Arriving>,
    next: NextItem<Result<Reply<T::Value>, Error>>,
    cancellation: CancellationToken,
}

/// The replies to one request that the program has not read.
struct Arriving {
    queue: Arc<ReceiveQueue<zenoh::query::Reply>>,
    decoder: Arc<Decoder>,
    state: Mutex<State>,
    querier: Arc<Querier>,
    sent: Sent,
}

struct State {
    inquiry: Inquiry,
    /// The replies that were being decoded when the program dropped the future; the next call continues.
    undecoded: Vec<Reply>,
}

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
    /// handle does not support the value or the reply cannot be decoded; [`Error::Closed`] if the session is closed.
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
        let (asked, service) = (robot.clone(), topic.to_string());
        let replies = self.query::<T>(Some(robot), topic, value).await?;
        match replies.next().await {
            Some(reply) => reply,
            None => match replies.arriving.unanswered() {
                Unanswered::NoService => Err(self.no_service(asked, service).await),
                Unanswered::Interrupted => Err(Error::Interrupted {
                    robot: asked,
                    topic: service,
                }),
            },
        }
    }

    /// Sends a request to the service `topic` of all robots that provide it. Replies arrive until all services have replied
    /// or the time is up ([`with_timeout`](Self::with_timeout)).
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
        self.query(None, valid(topic)?, value).await
    }

    async fn query<T: FromPayload>(
        &self,
        robot: Option<Name>,
        topic: Topic,
        value: impl ToPayload,
    ) -> Result<Replies<T>, Error> {
        let inquiry = Inquiry::new(
            self.inner.place.clone(),
            robot,
            topic,
            self.timeout,
            &self.inner.request_ids,
        );
        let get = inquiry.get(self.payload(value)?, self.urgency());
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
        };
        Ok(Replies {
            arriving: Arc::new(Arriving {
                queue,
                decoder: self.inner.decoder.clone(),
                state: Mutex::new(state),
                querier,
                sent,
            }),
            next: NextItem::default(),
            cancellation,
        })
    }

    /// Returns the error that no program of `robot` serves `topic`.
    pub(super) async fn no_service(&self, robot: Name, topic: String) -> Error {
        Error::NoService {
            robot,
            topic,
            available: self.peers().await.unwrap_or_default(),
        }
    }
}

impl Reply {
    fn typed<T: FromPayload>(self) -> Result<Reply<T::Value>, Error> {
        Ok(Reply {
            value: T::from_payload(&self.payload)?,
            sender: self.sender,
            payload: self.payload,
        })
    }
}

impl<T: FromPayload> Replies<T> {
    /// Waits for the next reply; returns `None` once all services have replied, or after the timeout was reported.
    ///
    /// # Errors
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
        let known = self.state().undecoded.pop();
        let reply = match known {
            Some(reply) => reply,
            // Zenoh has a timer for each request; a second one would wake a thread each time.
            None => match self.on_reply(convert::reply(self.queue.pop().await?)) {
                Ok(reply) => reply,
                Err(error) => return Some(Err(error)),
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
        let decoded = self.decoder.decode(sender, payload).await;
        let reply = undecoded.reply.take()?;
        Some(
            decoded
                .map_err(Error::from)
                .and_then(|()| reply.typed::<T>()),
        )
    }

    fn on_reply(&self, reply: Result<Sample, Payload>) -> Result<Reply, Error> {
        let inquiry = &mut self.state().inquiry;
        match inquiry.on_reply(reply) {
            ReplyKind::Answer { sender, payload } => Ok(Reply {
                sender,
                payload,
                value: (),
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

    /// Returns why the request ended without a reply.
    fn unanswered(&self) -> Unanswered {
        self.querier.served.unanswered(self.sent)
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
    }
}

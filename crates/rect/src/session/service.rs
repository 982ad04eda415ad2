//! Implements services: receives requests and sends the replies.
use std::{
    fmt,
    future::Future,
    pin::Pin,
    sync::{
        atomic::{AtomicBool, AtomicU32, Ordering},
        Arc, Weak,
    },
    task::{Context, Poll},
    time::Duration,
};

use futures_core::Stream;
use rect_core::{
    catalogue::{
        registration::{Registered, Registration},
        ServiceEntry,
    },
    driver::Answer,
    message::{
        encoding::Encoding,
        payload::{Payload, ToPayload},
        queue::{Queue, WhenFull},
        request::{end_of_replies, error_to_payload, SHARED_REPLY},
    },
    name::{topic::Topic, Name},
    retry::once::{Admission, Execution},
    session::service::{busy, Requester, ServiceQuery, CAPACITY, MAX_CONCURRENT},
};
use tokio::{sync::Semaphore, task::JoinHandle, time::Instant};
use zenoh::{
    bytes::ZBytes,
    query::{Query, Queryable},
    Wait,
};

use super::{
    decoder::Decoder,
    executor::Executor,
    next_item::NextItem,
    queries,
    receive_queue::{QueueWriter, ReceiveQueue},
    requester::{OpenRequests, WaitingRequester},
    robot::{Inner, Robot},
    shared::NoItems,
};
use crate::error::{valid, Error};

/// Receives the requests to a service; created by [`Robot::requests`]. It also implements [`futures_core::Stream`]. Dropping it
/// ends the service.
pub struct Requests {
    arriving: Arriving,
    next: NextItem<Request>,
    _declared: Queryable<()>,
    _serving: Serving,
}

/// A service in the catalogue. Dropping it removes it.
struct Serving {
    inner: Arc<Inner>,
    topic: Topic,
}

/// The description of a service, and whether it may have company.
#[derive(Clone, Debug, Default)]
pub struct ServiceOptions {
    /// The purpose of the service, for `rect service list` and the dashboard: at most 200 characters. Default: empty.
    pub about: String,
    /// Whether other programs of the robot may serve the same topic, which then have to allow it, too. Each of them answers every
    /// request, and the replies state that ([`Reply::is_shared`](crate::Reply::is_shared)). Default: no.
    pub allow_several: bool,
}

/// Ends a service if its robot's router refuses to register it again, because another program serves the topic.
async fn end_if_refused(inner: Weak<Inner>, queue: Arc<ReceiveQueue<Request>>, topic: Topic) {
    let Some(inner) = inner.upgrade() else { return };
    let registration = Registration::new(&inner.place, inner.program.driver().program());
    let executor = Executor::new(&inner.session, registration, NoItems);
    if !queue.is_closed() && matches!(executor.run().await, Ok(Registered::Refused(_))) {
        queue.close();
        inner.program.driver().on_taken_over(&topic);
        inner.program.wake();
    }
}

/// The requests that the program has not read.
#[derive(Clone)]
struct Arriving {
    queue: Arc<ReceiveQueue<Request>>,
    decoder: Arc<Decoder>,
}

/// A service that replies with a function; created by [`Robot::serve`]. Dropping it ends the service.
#[derive(Debug)]
pub struct Service {
    task: JoinHandle<()>,
}

/// A request to a service of this program. If it is dropped without a reply, the requester gets [`Error::Interrupted`].
pub struct Request {
    query: Query,
    waiting: WaitingRequester,
    /// The number of replies so far, if the requester counts them.
    replies: Option<AtomicU32>,
    me: Name,
    key: String,
    /// The robot that the request names as its sender; `None` if a stock Zenoh program sent it. Zenoh does not verify the
    /// name: do not base permissions on it.
    pub sender: Option<Name>,
    /// The value of the request.
    pub payload: Payload,
    /// The time of arrival plus the requester's timeout, or plus 10 s if a stock Zenoh program sent the request.
    pub deadline: Instant,
    /// Takes the result, if the request is carried out at most once.
    execution: Option<Execution<Query>>,
    /// Whether other programs of the robot may serve the topic.
    is_shared: bool,
}

impl Robot {
    /// Declares the service `topic`, which other robots use with [`request`](Robot::request), and returns its requests. Only
    /// the requester receives the reply. A query of a stock Zenoh program is a request unless its key has wildcards.
    ///
    /// ```no_run
    /// # async fn serve(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let requests = robot.requests("battery").await?;
    /// while let Some(request) = requests.next().await {
    ///     request.reply(rect::Json(11.9))?;
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the topic is invalid, [`Error::ServiceRefused`] if a program of this robot serves it already, and
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no service.
    pub async fn requests(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<Requests, Error> {
        self.requests_with(topic, ServiceOptions::default()).await
    }

    /// Does the same as [`requests`](Self::requests), with a description of the service and other options.
    ///
    /// # Errors
    /// Returns the same errors.
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no service.
    pub async fn requests_with(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        options: ServiceOptions,
    ) -> Result<Requests, Error> {
        let topic: Topic = valid(topic)?;
        let entry = ServiceEntry::new(topic, &options.about, options.allow_several);
        self.requests_of(entry).await
    }

    /// Declares a service of the catalogue, and returns its requests.
    pub(super) async fn requests_of(&self, entry: ServiceEntry) -> Result<Requests, Error> {
        let (topic, is_shared) = (entry.topic.clone(), entry.several);
        let serving = self.announce(entry).await?;
        let place = self.inner.place.clone();
        let key = place.publication(&topic);
        let queue = ReceiveQueue::new(Queue::new(CAPACITY, WhenFull::DropNewest));
        let writer = QueueWriter::new(&queue);
        let key_of_answers = key.clone();
        let instance = self.inner.program.driver().program().instance;
        let (inner, of) = (Arc::downgrade(&self.inner), topic.clone());
        let once = self.inner.once.clone();
        let (queue_of_service, runtime) = (queue.clone(), self.inner.runtime.clone());
        let checking = Arc::new(AtomicBool::new(false));
        let open = OpenRequests::default();
        let on_query = move |query: Query| {
            match ServiceQuery::of(query.parameters().as_str(), instance) {
                ServiceQuery::Request if !queue_of_service.is_closed() => {}
                ServiceQuery::Ping => {
                    let key = key_of_answers.clone();
                    let payload = Payload::new("", Encoding::BYTES);
                    return queries::answer(&query, Answer::Reply { key, payload });
                }
                ServiceQuery::Closed(id) => return open.on_closed(id),
                ServiceQuery::TakenOver if !checking.swap(true, Ordering::Relaxed) => {
                    let check = end_if_refused(inner.clone(), queue_of_service.clone(), of.clone());
                    let checking = checking.clone();
                    runtime.spawn(async move {
                        check.await;
                        checking.store(false, Ordering::Relaxed);
                    });
                    return;
                }
                _ => return,
            }
            let attachment = query.attachment().map(ZBytes::to_bytes);
            let requester = Requester::of(query.key_expr().as_str(), attachment.as_deref());
            // Any other query ends without a reply.
            let Some(requester) = requester else { return };
            let admission =
                once.on_request(Instant::now().into(), requester.header.as_ref(), query);
            let (query, execution) = match admission {
                Admission::Execute(query, execution) => (query, execution),
                // The query that is replaced ends.
                Admission::Wait(_) => return,
                Admission::Answer(query, answer) => return queries::answer(&query, answer),
            };
            let (me, key) = (place.robot.clone(), key_of_answers.clone());
            let deadline = Instant::now() + requester.timeout();
            let waiting = open.add(requester, deadline, &inner);
            let request = Request::new(query, waiting, me, key, execution, is_shared);
            let query = request.query.clone();
            if !writer.push(request) {
                queries::answer(&query, Answer::Error(busy(&place.robot)));
            }
        };
        let declared = self
            .inner
            .session
            .declare_queryable(key)
            .complete(true)
            .callback(on_query)
            .wait()
            .map_err(Error::zenoh("cannot declare the service"))?;
        Ok(Requests {
            arriving: Arriving {
                queue,
                decoder: self.inner.decoder.clone(),
            },
            next: NextItem::default(),
            _declared: declared,
            _serving: serving,
        })
    }

    /// Adds a service to the catalogue.
    async fn announce(&self, service: ServiceEntry) -> Result<Serving, Error> {
        let inner = &self.inner;
        let refused = |reason| Error::ServiceRefused { reason };
        let program = inner.program.driver().offer(&service).map_err(refused)?;
        let serving = Serving {
            inner: inner.clone(),
            topic: service.topic.clone(),
        };
        let registered = if inner.direct {
            Registered::Unanswered
        } else {
            let registration = Registration::new(&inner.place, &program);
            let executor = Executor::new(&inner.session, registration, NoItems);
            match executor.run().await? {
                Registered::Refused(reason) => return Err(refused(reason)),
                Registered::Closed => return Err(Error::Closed),
                registered => registered,
            }
        };
        (inner.program.driver()).on_served(service, &program, registered);
        inner.program.wake();
        Ok(serving)
    }

    /// Declares the service `topic`, and replies to each request with the result of `answer`, until the returned
    /// service is dropped. An error, or a panic of `answer`, arrives at the requester as [`Error::Service`].
    ///
    /// Up to 16 requests are processed concurrently. A request whose [deadline](Request::deadline) has passed while it
    /// waited is dropped.
    ///
    /// ```no_run
    /// # async fn serve(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let _service = robot.serve("double", |request| async move {
    ///     let number: f64 = request.payload.value().map_err(|error| error.to_string())?;
    ///     Ok::<_, String>(rect::Json(number * 2.0))
    /// }).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`requests`](Self::requests).
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no service.
    pub async fn serve<F, A, V, E>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        answer: F,
    ) -> Result<Service, Error>
    where
        F: Fn(Arc<Request>) -> A + Send + Sync + 'static,
        A: Future<Output = Result<V, E>> + Send,
        V: ToPayload + Send,
        E: ToPayload + Send,
    {
        self.serve_with(topic, ServiceOptions::default(), answer)
            .await
    }

    /// Does the same as [`serve`](Self::serve), with a description of the service and other options.
    ///
    /// # Errors
    /// Returns the same errors as [`requests`](Self::requests).
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no service.
    pub async fn serve_with<F, A, V, E>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        options: ServiceOptions,
        answer: F,
    ) -> Result<Service, Error>
    where
        F: Fn(Arc<Request>) -> A + Send + Sync + 'static,
        A: Future<Output = Result<V, E>> + Send,
        V: ToPayload + Send,
        E: ToPayload + Send,
    {
        let requests = self.requests_with(topic, options).await?;
        let answer = Arc::new(answer);
        let permits = Arc::new(Semaphore::new(MAX_CONCURRENT));
        let task = self.inner.runtime.spawn(async move {
            let mut working = tokio::task::JoinSet::new();
            while let Some(request) = requests.next().await {
                let Ok(permit) = permits.clone().acquire_owned().await else {
                    return;
                };
                while working.try_join_next().is_some() {}
                if request.waiting.has_left() {
                    continue;
                }
                let answer = answer.clone();
                working.spawn(async move {
                    let request = Arc::new(request);
                    let _on_panic = RefusesOnPanic(request.clone());
                    let sent = match answer(request.clone()).await {
                        Ok(value) => request.reply(value),
                        Err(error) => request.refuse(error),
                    };
                    if let Err(error) = sent {
                        tracing::warn!(
                            "cannot send a reply of the service {}: {error}",
                            request.key
                        );
                        // Without any reply the requester would get the error that the service does not exist.
                        let _ = request.refuse(error.to_string());
                    }
                    // This fails if the session is closed.
                    let _ = request.finish();
                    drop(permit);
                });
            }
        });
        Ok(Service { task })
    }
}

impl Requests {
    /// Waits for the next request; returns `None` once the session is closed. A request whose payload cannot be decoded
    /// is refused with the reason.
    ///
    /// # Cancel safety
    /// If the future is dropped, no request is lost: the next call returns it. The same holds for the [`Stream`], which keeps its
    /// wait.
    pub async fn next(&self) -> Option<Request> {
        self.arriving.next().await
    }
}

impl Arriving {
    async fn next(&self) -> Option<Request> {
        loop {
            // Decoding may wait for a dictionary, and the program may drop the future meanwhile.
            let mut popped = self.queue.pop_guarded().await?;
            let request = popped.item()?;
            let from = request.sender.as_ref().unwrap_or(&request.me);
            let decoded = self.decoder.decode(from, &mut request.payload).await;
            let request = popped.take()?;
            match decoded {
                Ok(()) => return Some(request),
                Err(error) => {
                    let _ = request.refuse(error.to_string());
                }
            }
        }
    }
}

impl Stream for Requests {
    type Item = Request;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Request>> {
        let Self { arriving, next, .. } = &mut *self;
        next.poll(context, || {
            let arriving = arriving.clone();
            async move { arriving.next().await }
        })
    }
}

impl fmt::Debug for Requests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Requests").finish_non_exhaustive()
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        self.inner.program.driver().on_ended(&self.topic);
        self.inner.program.wake();
    }
}

impl Drop for Requests {
    fn drop(&mut self) {
        self.arriving.queue.close();
    }
}

/// Replies with an error if the service's function panics.
struct RefusesOnPanic(Arc<Request>);

impl Drop for RefusesOnPanic {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let _ = self.0.refuse("the service's function panicked");
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl Request {
    /// Creates the request that a query makes.
    fn new(
        query: Query,
        waiting: WaitingRequester,
        me: Name,
        key: String,
        execution: Option<Execution<Query>>,
        is_shared: bool,
    ) -> Self {
        let header = waiting.requester().header.as_ref();
        Self {
            me,
            key,
            sender: waiting.requester().robot().cloned(),
            replies: header.and_then(|header| header.is_stream.then(AtomicU32::default)),
            payload: queries::payload_of(&query),
            deadline: waiting.deadline(),
            query,
            waiting,
            // Only one program carries out a request that is carried out at most once.
            is_shared: is_shared && execution.is_none(),
            execution,
        }
    }

    /// Returns whether the requester still waits for a reply, so that a service can stop working on a request that nobody waits for.
    ///
    /// It does not wait after its [deadline](Self::deadline), or if it has closed the request, or if its program or robot has
    /// ended. Except for the deadline, this is known within 0.5 s. The end of a program is known if the program has a name, and
    /// that of a stock Zenoh program never. The first call begins to observe the requester, which sends nothing on the air.
    pub fn is_wanted(&self) -> bool {
        self.waiting.is_waiting()
    }

    /// Waits until nobody waits for a reply any more, as [`is_wanted`](Self::is_wanted) describes.
    ///
    /// ```no_run
    /// # async fn work() {}
    /// # async fn answer(request: &rect::Request) {
    /// tokio::select! {
    ///     () = work() => {}
    ///     () = request.unwanted() => println!("stopped: nobody waits"),
    /// }
    /// # }
    /// ```
    ///
    /// # Cancel safety
    /// The future can be dropped; the next call waits again.
    pub async fn unwanted(&self) {
        self.waiting.left().await;
    }

    /// Ends a request after several replies: a requester that [expects them](Robot::request_stream) then knows that all have arrived.
    /// [`Robot::serve`] calls it. A request that is dropped without it is [`Error::Interrupted`] for that requester.
    ///
    /// # Errors
    /// [`Error::Closed`] if the session is closed.
    pub fn finish(&self) -> Result<(), Error> {
        let Some(replies) = &self.replies else {
            return Ok(());
        };
        let count = end_of_replies(replies.load(Ordering::Relaxed));
        let reply = self.query.reply(&self.key, "").attachment(count).wait();
        reply.map_err(Error::zenoh("cannot send the reply"))
    }

    /// Returns the time left until the [deadline](Self::deadline).
    pub fn remaining(&self) -> Duration {
        self.deadline.saturating_duration_since(Instant::now())
    }

    /// Sends a reply. A service may reply several times to one request, and then calls [`finish`](Self::finish).
    ///
    /// # Errors
    /// [`Error::Payload`] if the value cannot be serialized, and [`Error::Closed`] if the session is closed.
    pub fn reply(&self, value: impl ToPayload) -> Result<(), Error> {
        let payload = value.into_payload()?.sendable()?;
        let key = self.key.clone();
        self.answer(Answer::Reply { key, payload })?;
        if let Some(replies) = &self.replies {
            replies.fetch_add(1, Ordering::Relaxed);
        }
        Ok(())
    }

    /// Replies with an error, which the requester receives as [`Error::Service`].
    ///
    /// # Errors
    /// Returns the same errors as [`reply`](Self::reply).
    pub fn refuse(&self, error: impl ToPayload) -> Result<(), Error> {
        let error = error_to_payload(&self.me, error.into_payload()?.sendable()?);
        self.answer(Answer::Error(error))
    }

    fn answer(&self, answer: Answer) -> Result<(), Error> {
        let execution = self.execution.as_ref();
        if let Some(repeated) = execution.and_then(|execution| execution.on_result(&answer)) {
            queries::answer(&repeated, answer.clone());
        }
        let mark = self.is_shared.then_some(SHARED_REPLY);
        queries::try_answer(&self.query, answer, mark.as_ref().map(|mark| &mark[..]))
            .map_err(Error::zenoh("cannot send the reply"))
    }
}

impl fmt::Debug for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Request")
            .field("key", &self.key)
            .field("sender", &self.sender)
            .field("payload", &self.payload)
            .finish_non_exhaustive()
    }
}

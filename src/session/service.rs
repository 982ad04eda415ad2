//! Owns serving: the requests that come to a service of this program, and their answers.
use std::{fmt, future::Future, sync::Arc, time::Duration};

use tokio::{sync::Semaphore, task::JoinHandle, time::Instant};
use zenoh::{
    bytes::{Encoding, ZBytes},
    query::{Query, Queryable},
    Wait,
};

use super::{
    decoder::Decoder,
    inbox::{Filling, Inbox},
    robot::Robot,
    subscriber,
};
use crate::{
    core::{
        encoding,
        name::Name,
        payload::{Payload, ToPayload},
        queue::{Queue, WhenFull},
        request::{error_to_payload, Asking, DEFAULT_TIMEOUT_MS},
        topic::Topic,
    },
    error::Error,
};

/// How many requests wait for the program; more are answered with an error at once.
const WAITING: usize = 256;
/// How many are worked on at a time by [`Robot::serve`].
const AT_A_TIME: usize = 16;

/// The requests to a service, as they come. It ends when it is dropped, or the session is closed.
pub struct Requests {
    inbox: Arc<Inbox<Request>>,
    decoder: Arc<Decoder>,
    _declared: Queryable<()>,
}

/// A service that answers by a function, until this is dropped.
#[derive(Debug)]
pub struct Service {
    task: JoinHandle<()>,
}

/// A request. Dropped without an answer it tells the asker that there is none.
pub struct Request {
    query: Query,
    me: Name,
    key: String,
    /// The robot that the request names as its sender; `None` from a stock program. Zenoh does not verify it: do not
    /// let permissions depend on it.
    pub from: Option<Name>,
    /// What is asked.
    pub payload: Payload,
    /// Until when an answer is of use.
    pub deadline: Instant,
}

impl Robot {
    /// Serves `topic`: others ask for it with [`request`](Robot::request). One asker gets the answer, nobody else.
    ///
    /// # Errors
    /// [`Error::Topic`]; [`Error::Zenoh`] when the session is closed.
    pub async fn requests<T: TryInto<Topic>>(&self, topic: T) -> Result<Requests, Error>
    where
        Error: From<T::Error>,
    {
        let place = self.inner.place.clone();
        let key = place.publication(&topic.try_into()?);
        let inbox = Inbox::new(Queue::new(WAITING, WhenFull::OldestWins));
        let filling = Filling::new(&inbox);
        let key_of_answers = key.clone();
        let on_query = move |query: Query| {
            let request = Request::new(query, place.robot.clone(), key_of_answers.clone());
            let busy = request.query.clone();
            if !filling.push(request) {
                let said = format!("{WAITING} requests wait already: ask later");
                let error =
                    error_to_payload(&place.robot, Payload::new(said, encoding::Encoding::TEXT));
                let _ = reply_error(&busy, error);
            }
        };
        let declared = self
            .inner
            .session
            .declare_queryable(key)
            .complete(true)
            .callback(on_query)
            .wait()
            .map_err(Error::zenoh("the service is refused"))?;
        Ok(Requests {
            inbox,
            decoder: self.inner.decoder.clone(),
            _declared: declared,
        })
    }

    /// Serves `topic` by a function: what it returns is the answer, and an error arrives as [`Error::Service`]. Up to 16
    /// requests are worked on at a time.
    ///
    /// ```no_run
    /// # async fn served(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let _service = robot.serve("double", |request| async move {
    ///     let number: f64 = request.payload.value().map_err(|error| error.to_string())?;
    ///     Ok::<_, String>(rect::Json(number * 2.0))
    /// }).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// As [`requests`](Self::requests).
    pub async fn serve<T, F, A, V, E>(&self, topic: T, answer: F) -> Result<Service, Error>
    where
        T: TryInto<Topic>,
        Error: From<T::Error>,
        F: Fn(Arc<Request>) -> A + Send + Sync + 'static,
        A: Future<Output = Result<V, E>> + Send,
        V: ToPayload + Send,
        E: ToPayload + Send,
    {
        let requests = self.requests(topic).await?;
        let answer = Arc::new(answer);
        let room = Arc::new(Semaphore::new(AT_A_TIME));
        let task = self.inner.runtime.spawn(async move {
            let mut working = tokio::task::JoinSet::new();
            while let Some(request) = requests.next().await {
                let Ok(permit) = room.clone().acquire_owned().await else {
                    return;
                };
                while working.try_join_next().is_some() {}
                if request.remaining().is_zero() {
                    continue;
                }
                let answer = answer.clone();
                working.spawn(async move {
                    let request = Arc::new(request);
                    let _on_panic = RefusesOnPanic(request.clone());
                    let said = match answer(request.clone()).await {
                        Ok(value) => request.reply(value),
                        Err(error) => request.refuse(error),
                    };
                    if let Err(error) = said {
                        tracing::warn!("an answer was not sent: {error}");
                        // Without any answer the requester would be told that nobody serves this.
                        let _ = request.refuse(error.to_string());
                    }
                    drop(permit);
                });
            }
        });
        Ok(Service { task })
    }
}

impl Requests {
    /// The next request, once there is one; `None`: the session was closed. One that can't be unpacked is answered with
    /// that error.
    pub async fn next(&self) -> Option<Request> {
        loop {
            let mut request = self.inbox.pop().await?;
            let from = request.from.as_ref().unwrap_or(&request.me);
            match self.decoder.unpack(from, &mut request.payload).await {
                Ok(()) => return Some(request),
                Err(error) => {
                    let _ = request.refuse(error.to_string());
                }
            }
        }
    }
}

impl fmt::Debug for Requests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Requests").finish_non_exhaustive()
    }
}

impl Drop for Requests {
    fn drop(&mut self) {
        self.inbox.close();
    }
}

/// Answers with an error if the service's function panics.
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
    fn new(query: Query, me: Name, key: String) -> Self {
        let attachment = query.attachment().map(ZBytes::to_bytes);
        let asking = attachment.and_then(|bytes| Asking::decode(&bytes));
        let timeout_ms = asking
            .as_ref()
            .map_or(DEFAULT_TIMEOUT_MS, |asking| asking.timeout_ms);
        let empty = (ZBytes::new(), Encoding::default());
        let bytes = query.payload().unwrap_or(&empty.0);
        let payload = subscriber::payload(bytes, query.encoding().unwrap_or(&empty.1));
        let timeout = Duration::from_millis(timeout_ms.into());
        Self {
            me,
            key,
            from: asking.map(|asking| asking.from),
            payload,
            deadline: Instant::now() + timeout,
            query,
        }
    }

    /// How long an answer is of use still.
    pub fn remaining(&self) -> Duration {
        self.deadline.saturating_duration_since(Instant::now())
    }

    /// Answers; several answers are several calls.
    ///
    /// # Errors
    /// [`Error::Payload`]; [`Error::Zenoh`] when the session is closed.
    pub fn reply(&self, value: impl ToPayload) -> Result<(), Error> {
        let payload = value.into_payload()?.sendable()?;
        let reply = self.query.reply(&self.key, payload.bytes);
        let reply = reply.encoding(payload.encoding.as_str()).wait();
        reply.map_err(Error::zenoh("the answer is not sent"))
    }

    /// Answers with an error, which the asker gets as [`Error::Service`].
    ///
    /// # Errors
    /// As [`reply`](Self::reply).
    pub fn refuse(&self, error: impl ToPayload) -> Result<(), Error> {
        let error = error_to_payload(&self.me, error.into_payload()?.sendable()?);
        reply_error(&self.query, error).map_err(Error::zenoh("the answer is not sent"))
    }
}

fn reply_error(query: &Query, error: Payload) -> zenoh::Result<()> {
    let reply = query.reply_err(error.bytes);
    reply.encoding(error.encoding.as_str()).wait()
}

impl fmt::Debug for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Request")
            .field("key", &self.key)
            .field("from", &self.from)
            .field("payload", &self.payload)
            .finish_non_exhaustive()
    }
}

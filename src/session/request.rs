//! Sends requests to services and receives their replies.
use std::{
    fmt,
    future::{Future, IntoFuture},
    pin::pin,
    sync::Arc,
    task::{Context, Waker},
    time::Duration,
};

use zenoh::{
    cancellation::CancellationToken,
    query::{ConsolidationMode, QueryTarget},
};

use super::{
    decoder::Decoder,
    publication::priority,
    receive_queue::{QueueWriter, ReceiveQueue},
    robot::Robot,
    subscriber::payload,
};
use crate::{
    core::{
        key::{Address, KeySpace},
        name::Name,
        payload::{Payload, ToPayload},
        queue::{Queue, WhenFull},
        request::{error_from_payload, RequestHeader},
        topic::Topic,
    },
    error::Error,
};

/// Capacity of the queue of replies; when it is full, Zenoh waits for the program.
const REPLIES: usize = 64;

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
    place: KeySpace,
    /// The robot that the request was sent to; `None` for all robots.
    asked: Option<Name>,
    /// The expected reply, for the text of a timeout.
    expected: String,
    timeout: Duration,
    cancellation: CancellationToken,
}

impl Robot {
    /// Sends a request to the service `topic` of `robot`, and waits for its first reply.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let timeout = std::time::Duration::from_secs(1);
    /// let reply = robot.request("wombat-2", "battery", "", timeout).await?;
    /// let volts: f64 = reply.payload.value()?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Service`] if the service replies with an error, [`Error::NoService`] if no program at `robot` serves
    /// the topic, [`Error::TimedOut`] if no reply arrives within `timeout`; [`Error::Name`], [`Error::Topic`] or
    /// [`Error::Payload`] if an argument is invalid; [`Error::Codec`] if the codec of this handle does not support the
    /// value or the reply cannot be decoded; [`Error::Zenoh`] if the session is closed.
    pub async fn request<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Reply, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let robot = robot.try_into()?;
        let topic = topic.try_into()?;
        let (asked, service) = (robot.to_string(), topic.to_string());
        let mut replies = self.query(Some(robot), topic, value, timeout).await?;
        match replies.next().await {
            Some(reply) => reply,
            None => Err(self.no_service(asked, service).await),
        }
    }

    /// Sends a request to the service `topic` of all robots that provide it. Replies arrive until all services have replied
    /// or `timeout` has expired.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let timeout = std::time::Duration::from_secs(1);
    /// let mut replies = robot.request_all("battery", "", timeout).await?;
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
    /// does not support the value, and [`Error::Zenoh`] if the session is closed.
    pub async fn request_all<T: TryInto<Topic>>(
        &self,
        topic: T,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Replies, Error>
    where
        Error: From<T::Error>,
    {
        self.query(None, topic.try_into()?, value, timeout).await
    }

    async fn query(
        &self,
        robot: Option<Name>,
        topic: Topic,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Replies, Error> {
        let place = &self.inner.place;
        let payload = self.payload(value)?;
        let queue = ReceiveQueue::new(Queue::new(REPLIES, WhenFull::Block));
        let asking = RequestHeader {
            sender: place.robot.clone(),
            timeout_ms: u32::try_from(timeout.as_millis()).unwrap_or(u32::MAX),
        };
        let cancellation = CancellationToken::default();
        let qos = self.urgency().qos();
        // Zenoh drops the callback after the last reply.
        let writer = QueueWriter::new(&queue);
        let session = self.inner.urgency_sessions.of(self.urgency()).await;
        let asked = session
            .get(place.service(robot.as_ref(), &topic))
            .payload(payload.bytes)
            .encoding(payload.encoding.as_str())
            .attachment(asking.encode())
            .priority(priority(qos))
            .express(qos.express)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .timeout(timeout)
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
            place: place.clone(),
            asked: robot,
            expected: format!("reply about {topic}"),
            timeout,
            cancellation,
        })
    }

    pub(super) async fn no_service(&self, robot: String, topic: String) -> Error {
        let peers = self.peers().await.unwrap_or_default();
        let peers: Vec<&str> = peers.iter().map(Name::as_str).collect();
        let available = if peers.is_empty() {
            "none".to_owned()
        } else {
            peers.join(", ")
        };
        Error::NoService {
            robot,
            topic,
            available,
        }
    }
}

impl Replies {
    /// Waits for the next reply; returns `None` once all services have replied, or after the timeout was reported.
    ///
    /// # Errors
    /// [`Error::Service`] if a service replied with an error, [`Error::Codec`] if a reply cannot be decoded,
    /// [`Error::TimedOut`] if the timeout expired before all services had replied, and [`Error::Zenoh`] if the key of a
    /// reply is not that of a robot. Further calls return the other replies.
    pub async fn next(&mut self) -> Option<Result<Reply, Error>> {
        let timed_out = || Error::TimedOut {
            expected: self.expected.clone(),
            timeout: self.timeout,
        };
        // Zenoh has a timer for each request; a second one would wake a thread each time.
        let answer = match self.queue.pop().await?.into_result() {
            Ok(sample) => {
                let address = self.place.address(sample.key_expr().as_str());
                let mut payload = payload(sample.payload(), sample.encoding());
                match address {
                    Some(Address { sender, .. }) => {
                        let decoded = self.decoder.decode(&sender, &mut payload).await;
                        decoded
                            .map(|()| Reply { sender, payload })
                            .map_err(Error::from)
                    }
                    None => Err(Error::Zenoh {
                        operation: "the reply has no valid key of a robot",
                        reason: format!("its key is {:?}", sample.key_expr().as_str()),
                    }),
                }
            }
            Err(error) => {
                let (robot, payload) =
                    error_from_payload(payload(error.payload(), error.encoding()));
                if is_timeout(robot.as_ref(), &payload) {
                    Err(timed_out())
                } else {
                    // Only the robot that was asked can reply, whichever name the error contains.
                    let robot = robot.map(|robot| self.asked.clone().unwrap_or(robot));
                    Err(Error::Service { robot, payload })
                }
            }
        };
        Some(answer)
    }
}

/// Returns whether an error reply of `robot` is Zenoh's own: the timeout of the query has expired.
pub(super) fn is_timeout(robot: Option<&Name>, error: &Payload) -> bool {
    robot.is_none() && error.bytes == b"Timeout"[..]
}

impl fmt::Debug for Replies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Replies")
            .field("expected", &self.expected)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::encoding::Encoding;

    #[test]
    fn only_an_error_without_a_robot_is_a_timeout() {
        let timeout = Payload::new("Timeout", Encoding::TEXT);
        let other = Payload::new("the arm is stuck", Encoding::TEXT);
        let robot = Name::new("wombat-2").expect("a name");
        assert!(is_timeout(None, &timeout));
        assert!(!is_timeout(Some(&robot), &timeout));
        assert!(!is_timeout(None, &other));
    }
}

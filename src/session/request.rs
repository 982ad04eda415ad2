//! Owns asking a service, and its answers.
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
    inbox::{Filling, Inbox},
    publication::priority,
    robot::Robot,
    subscriber::payload,
};
use crate::{
    core::{
        key::{Address, Place},
        name::Name,
        payload::{Payload, ToPayload},
        queue::{Queue, WhenFull},
        request::{error_from_payload, Asking},
        topic::Topic,
    },
    error::Error,
};

/// How many answers wait for the program; a service that sends more waits.
const REPLIES: usize = 64;

/// An answer.
#[derive(Clone, Debug)]
pub struct Reply {
    /// Who answers.
    pub from: Name,
    /// What it says.
    pub payload: Payload,
}

/// The answers to one request, as they come. Dropping it cancels the request.
pub struct Replies {
    inbox: Arc<Inbox<zenoh::query::Reply>>,
    decoder: Arc<Decoder>,
    place: Place,
    /// The robot that was asked; `None`: all.
    asked: Option<Name>,
    what: String,
    timeout: Duration,
    cancellation: CancellationToken,
}

impl Robot {
    /// Asks a service of `robot`, and waits for its first answer.
    ///
    /// # Errors
    /// [`Error::Service`]: it answers with an error; [`Error::NoService`]: nobody serves that there;
    /// [`Error::TimedOut`]; [`Error::Name`], [`Error::Topic`], [`Error::Payload`].
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
        let (asked, about) = (robot.to_string(), topic.to_string());
        let mut replies = self.ask(Some(robot), topic, value, timeout).await?;
        match replies.next().await {
            Some(reply) => reply,
            None => Err(self.nobody(asked, about).await),
        }
    }

    /// Asks a service of all robots that have it; answers come until all have answered, or the time is over.
    ///
    /// # Errors
    /// [`Error::Topic`], [`Error::Payload`]; [`Error::Zenoh`] when the session is closed.
    pub async fn request_all<T: TryInto<Topic>>(
        &self,
        topic: T,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Replies, Error>
    where
        Error: From<T::Error>,
    {
        self.ask(None, topic.try_into()?, value, timeout).await
    }

    async fn ask(
        &self,
        robot: Option<Name>,
        topic: Topic,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Replies, Error> {
        let place = &self.inner.place;
        let payload = self.payload(value)?;
        let inbox = Inbox::new(Queue::new(REPLIES, WhenFull::Wait));
        let asking = Asking {
            from: place.robot.clone(),
            timeout_ms: u32::try_from(timeout.as_millis()).unwrap_or(u32::MAX),
        };
        let cancellation = CancellationToken::default();
        let qos = self.urgency().qos();
        // Zenoh drops the callback when the last answer has come.
        let filling = Filling::new(&inbox);
        let session = self.inner.lanes.of(self.urgency()).await;
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
                filling.push(reply);
            });
        asked
            .await
            .map_err(Error::zenoh("the request is not sent"))?;
        Ok(Replies {
            inbox,
            decoder: self.inner.decoder.clone(),
            place: place.clone(),
            asked: robot,
            what: format!("answer about {topic}"),
            timeout,
            cancellation,
        })
    }

    pub(super) async fn nobody(&self, robot: String, topic: String) -> Error {
        let there = self.peers().await.unwrap_or_default();
        let there: Vec<&str> = there.iter().map(Name::as_str).collect();
        let there = if there.is_empty() {
            "none".to_owned()
        } else {
            there.join(", ")
        };
        Error::NoService {
            robot,
            topic,
            there,
        }
    }
}

impl Replies {
    /// The next answer, or the error that a service answers with; [`Error::TimedOut`] when the time is over and some have
    /// not answered; `None`: all have.
    pub async fn next(&mut self) -> Option<Result<Reply, Error>> {
        let timed_out = || Error::TimedOut {
            what: self.what.clone(),
            after: self.timeout,
        };
        // Zenoh has a timer for each request: one more would wake a thread each time.
        let answer = match self.inbox.pop().await?.into_result() {
            Ok(sample) => {
                let address = self.place.address(sample.key_expr().as_str());
                let mut payload = payload(sample.payload(), sample.encoding());
                match address {
                    Some(Address { from, .. }) => {
                        let unpacked = self.decoder.unpack(&from, &mut payload).await;
                        unpacked
                            .map(|()| Reply { from, payload })
                            .map_err(Error::from)
                    }
                    None => Err(Error::Zenoh {
                        what: "the answer is none of a robot",
                        reason: format!("its key is {:?}", sample.key_expr().as_str()),
                    }),
                }
            }
            Err(error) => {
                let (robot, payload) =
                    error_from_payload(payload(error.payload(), error.encoding()));
                // Zenoh's own, when the time is over.
                if robot.is_none() && payload.bytes == b"Timeout"[..] {
                    Err(timed_out())
                } else {
                    // Only the robot that was asked can answer, whatever name the answer has.
                    let robot = robot.map(|robot| self.asked.clone().unwrap_or(robot));
                    Err(Error::Service { robot, payload })
                }
            }
        };
        Some(answer)
    }
}

impl fmt::Debug for Replies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Replies")
            .field("what", &self.what)
            .finish_non_exhaustive()
    }
}

impl Drop for Replies {
    fn drop(&mut self) {
        // All have answered.
        if self.inbox.is_closed() {
            return;
        }
        self.inbox.close();
        // Zenoh lets go of the request when this is first looked at. What it goes on with is waiting for a callback that
        // runs just now, which finds the inbox closed: nobody needs that, and a task for it would wake a thread each time.
        let cancelled = pin!(self.cancellation.cancel().into_future());
        let _ = cancelled.poll(&mut Context::from_waker(Waker::noop()));
    }
}

//! Waits for the replies of all robots that serve a topic, and names those that did not reply.
use std::{collections::BTreeSet, time::Instant};

use rect_core::{
    message::payload::FromPayload,
    name::{topic::Topic, Name},
    registry::servers_query::Servers,
};

use super::{
    executor::Executor,
    request::{Replies, Reply},
    robot::Robot,
    shared::NoItems,
};
use crate::error::Error;

/// The outcomes of a request to all robots; created by [`Replies::gather`].
#[derive(Debug)]
pub struct Gathered<T = ()> {
    /// The outcomes: first the replies and errors in the order of their arrival, and then an error for each missing robot. A robot
    /// whose programs have several services of the topic has one for each of them.
    pub outcomes: Vec<Outcome<T>>,
    /// The robots that serve the topic: those whose catalogue lists it, and those that replied.
    pub expected: BTreeSet<Name>,
    /// The robots that serve the topic and did not reply.
    pub missing: BTreeSet<Name>,
}

/// The outcome of a request at one robot.
#[derive(Debug)]
pub struct Outcome<T = ()> {
    /// The robot. `None` if a stock Zenoh program replied with an error, which does not name it.
    pub robot: Option<Name>,
    /// Its reply, or the error.
    pub result: Result<Reply<T>, Error>,
}

impl Robot {
    /// Asks which robots serve a topic; a moment later, if a request has just ended at that time.
    async fn servers(self, topic: Topic, ended: Option<Instant>) -> Result<Servers, Error> {
        let inner = &self.inner;
        let query = inner.catalogues.servers(inner.place.clone(), topic);
        let query = match ended {
            Some(now) => query.after_end(now),
            None => query,
        };
        let found = Executor::new(&inner.session, query, NoItems).run().await?;
        let found = found.filter(|_| !inner.session.is_closed());
        found.ok_or(Error::Closed)
    }
}

impl<T: FromPayload> Replies<T> {
    /// Waits until all robots have replied that serve the topic, or the time is up, and returns the outcome of each of them. An error
    /// of one robot does not end the wait.
    ///
    /// The robots that serve the topic are those whose catalogue lists it when this method is called. A missing one has
    /// [`Error::TimedOut`], or [`Error::Interrupted`] if its program, a router or the link ended.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let gathered = robot.request_all::<f64>("battery", "").await?.gather().await?;
    /// for outcome in &gathered.outcomes {
    ///     match &outcome.result {
    ///         Ok(reply) => println!("{}: {} V", reply.sender, reply.value),
    ///         Err(error) => eprintln!("{error}"),
    ///     }
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::NoService`] if no program of the fleet serves the topic; [`Error::Interrupted`] if nobody replied and a program has begun,
    /// ended or changed its services meanwhile, so that one may have carried the request out; [`Error::TimedOut`] if nobody has
    /// replied in time that a catalogue lists; and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future cancels the request. Services may have received it, and carry it out.
    pub async fn gather(self) -> Result<Gathered<T::Value>, Error> {
        let arriving = &self.arriving;
        let (robot, topic) = (&arriving.robot, arriving.topic());
        let runtime = &robot.inner.runtime;
        // The replies arrive meanwhile.
        let asked = runtime.spawn(robot.clone().servers(topic.clone(), None));
        let (mut outcomes, mut replied) = (Vec::new(), BTreeSet::new());
        let mut timed_out = None;
        while let Some((robot, result)) = arriving.received::<T>().await {
            match result {
                Err(Error::TimedOut { expected, timeout }) => timed_out = Some((expected, timeout)),
                result => {
                    replied.extend(robot.clone());
                    outcomes.push(Outcome { robot, result });
                }
            }
        }
        let serving = asked.await.map_err(|_| Error::Closed)??;
        let mut expected = serving.robots.clone();
        let missing: BTreeSet<_> = expected.difference(&replied).cloned().collect();
        expected.extend(replied);
        outcomes.extend(missing.iter().map(|robot| Outcome {
            robot: Some(robot.clone()),
            result: Err(match &timed_out {
                Some((_, timeout)) => Error::TimedOut {
                    expected: format!("reply of {robot} about {topic}"),
                    timeout: *timeout,
                },
                None => arriving.interrupted(Some(robot.clone())),
            }),
        }));
        if outcomes.is_empty() {
            if let Some((expected, timeout)) = timed_out {
                return Err(Error::TimedOut { expected, timeout });
            }
            // A program that served the topic may have ended, whose token ends a moment later.
            let again = robot.clone().servers(topic.clone(), Some(Instant::now()));
            let again = runtime.spawn(again).await.map_err(|_| Error::Closed)??;
            return Err(match again == serving {
                true => arriving.no_service(None).await,
                false => arriving.interrupted(None),
            });
        }
        Ok(Gathered {
            outcomes,
            expected,
            missing,
        })
    }
}

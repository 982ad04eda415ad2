//! Waits for the replies of all robots that serve a topic, and names those that did not reply.
use std::collections::BTreeSet;

use rect_core::{message::payload::FromPayload, name::Name};

use super::{
    executor::Executor,
    request::{Replies, Reply},
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
    /// [`Error::NoService`] if no program of the fleet serves the topic, [`Error::Interrupted`] or [`Error::TimedOut`] if one did when
    /// the request was sent, and no catalogue lists it any more, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future cancels the request. Services may have received it, and carry it out.
    pub async fn gather(self) -> Result<Gathered<T::Value>, Error> {
        let arriving = &self.arriving;
        let inner = &arriving.robot.inner;
        let query = (inner.catalogues).servers(inner.place.clone(), arriving.topic().clone());
        let executor = Executor::new(&inner.session, query, NoItems);
        // The replies arrive meanwhile.
        let asked = inner.runtime.spawn(executor.run());
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
        let mut expected = serving.ok_or(Error::Closed)?;
        if inner.session.is_closed() {
            return Err(Error::Closed);
        }
        let missing: BTreeSet<_> = expected.difference(&replied).cloned().collect();
        expected.extend(replied);
        outcomes.extend(missing.iter().map(|robot| Outcome {
            robot: Some(robot.clone()),
            result: Err(match &timed_out {
                Some((_, timeout)) => Error::TimedOut {
                    expected: format!("reply of {robot} about {}", arriving.topic()),
                    timeout: *timeout,
                },
                None => arriving.interrupted(Some(robot.clone())),
            }),
        }));
        if outcomes.is_empty() {
            return Err(match timed_out {
                Some((expected, timeout)) => Error::TimedOut { expected, timeout },
                None => arriving.unanswered().await,
            });
        }
        Ok(Gathered {
            outcomes,
            expected,
            missing,
        })
    }
}

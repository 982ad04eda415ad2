//! Waits until a robot is reachable, and until the other robots know the subscriptions and services of this program.
use std::time::{Duration, Instant};

use rect_core::{
    driver::Driver,
    name::Name,
    session::peers::{expected_connection, EstablishedWait, PeerWait, Waited},
};

use super::{executor::Executor, robot::Robot, shared::NoItems};
use crate::error::Error;

impl Robot {
    /// Waits until `robot` is reachable. Returns at once if it is.
    ///
    /// A robot is reachable while its router, or a program without a router, is connected with this one. Its programs may
    /// start later: [`Publisher::wait_for_subscriber`](crate::Publisher::wait_for_subscriber) waits for one that subscribes.
    ///
    /// ```no_run
    /// # async fn wait(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.wait_for_peer("wombat-2", std::time::Duration::from_secs(30)).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::TimedOut`] if the robot is not reachable within `timeout`, with the names of those that are; [`Error::Name`] if the name is invalid;
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future ends the wait. Nothing else changes.
    pub async fn wait_for_peer<N: TryInto<Name>>(
        &self,
        robot: N,
        timeout: Duration,
    ) -> Result<(), Error>
    where
        Error: From<N::Error>,
    {
        let robot = robot.try_into()?;
        let wait = PeerWait::new(&self.inner.place, &robot, Instant::now(), timeout);
        match self.wait(wait, String::new(), timeout).await {
            Err(Error::TimedOut { timeout, .. }) => {
                let reachable = self.peers().await.unwrap_or_default();
                let expected = expected_connection(&robot, &reachable);
                Err(Error::TimedOut { expected, timeout })
            }
            waited => waited,
        }
    }

    /// Waits until every reachable router knows the subscriptions and services of this program, so that messages and
    /// requests that other robots send from now on arrive.
    ///
    /// Declarations reach the other robots a moment after the calls that made them, later over a slow link. Programs
    /// without a router answer themselves.
    ///
    /// ```no_run
    /// # async fn wait(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let subscriber = robot.subscribe("*/greeting").await?;
    /// robot.wait_until_established(std::time::Duration::from_secs(5)).await?;
    /// robot.publish("ready", "").await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::TimedOut`] if a router does not answer within `timeout`; [`Error::Closed`] if the
    /// session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future ends the wait. Nothing else changes.
    pub async fn wait_until_established(&self, timeout: Duration) -> Result<(), Error> {
        let inner = &self.inner;
        let wait = EstablishedWait::new(&inner.place, Instant::now(), timeout);
        self.wait(wait, "answer of every router".to_owned(), timeout)
            .await
    }

    async fn wait<D>(&self, wait: D, expected: String, timeout: Duration) -> Result<(), Error>
    where
        D: Driver<Item = std::convert::Infallible, Output = Waited> + Send + 'static,
    {
        match Executor::new(&self.inner.session, wait, NoItems)
            .run()
            .await?
        {
            Waited::Ready => Ok(()),
            Waited::TimedOut => Err(Error::TimedOut { expected, timeout }),
            Waited::Closed => Err(Error::Closed),
        }
    }
}

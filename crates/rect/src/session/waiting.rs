//! Waits until a robot is reachable, and until the other robots know the subscriptions and services of this program.
use std::time::{Duration, Instant};

use rect_core::{
    driver::Driver,
    name::Name,
    session::name_check::Used,
    session::peers::{expected_connection, EstablishedWait, PeerWait, Waited},
};

use super::{executor::Executor, robot::Robot, shared::NoItems};
use crate::error::{valid, Error};

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
    /// [`Error::TimedOut`] if the robot is not reachable within `timeout`, with the names of those that are; [`Error::Name`] if
    /// the name is invalid; [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future ends the wait. Nothing else changes.
    pub async fn wait_for_peer(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        timeout: Duration,
    ) -> Result<(), Error> {
        let robot: Name = valid(robot)?;
        self.check_name(Used::Robot(robot.clone()));
        let wait = PeerWait::new(&self.inner.place, &robot, Instant::now(), timeout);
        if self.wait(wait).await? {
            return Ok(());
        }
        let reachable = self.peers().await.unwrap_or_default();
        let expected = expected_connection(&robot, &reachable);
        Err(Error::TimedOut { expected, timeout })
    }

    /// Waits until every reachable router knows the subscriptions and services of this program, so that messages and
    /// requests that other robots send from now on arrive.
    ///
    /// Declarations reach the other robots a moment after the calls that made them, later over a slow link. Programs
    /// without a router answer themselves.
    ///
    /// ```no_run
    /// # async fn wait(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let subscriber = robot.subscribe::<String>("*/greeting").await?;
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
        if self.wait(wait).await? {
            return Ok(());
        }
        let expected = "answer of every router".to_owned();
        Err(Error::TimedOut { expected, timeout })
    }

    /// Runs a wait. Returns whether it was successful before its time was up.
    async fn wait<D>(&self, wait: D) -> Result<bool, Error>
    where
        D: Driver<Item = std::convert::Infallible, Output = Waited> + Send + 'static,
    {
        match Executor::new(&self.inner.session, wait, NoItems)
            .run()
            .await?
        {
            Waited::Ready => Ok(true),
            Waited::TimedOut => Ok(false),
            Waited::Closed => Err(Error::Closed),
        }
    }
}

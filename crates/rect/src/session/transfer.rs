//! Implements the transfers of a session: sending ([`Robot::transfer`]) and receiving ([`Robot::receive_transfers`]).
//!
//! The protocol's decisions are made in [`core::transfer`](rect_core::transfer). Each transfer has a separate thread at
//! either end, since file access and a full link block. On a slow link, the thread wakes up a few times per second.
mod incoming;
mod options;
mod outgoing;
mod received;
mod receiving;
mod sending;
mod stop;

pub use incoming::Transfers;
pub use options::{Destination, IncomingTransfer, ReceiveOptions};
pub use outgoing::{Transfer, TransferSource};
pub use received::Received;
use rect_core::name::{
    topic::{Pattern, Topic},
    Name,
};

use super::robot::Robot;
use crate::error::{valid, Error};

impl Robot {
    /// Prepares a transfer of a file or buffer of any size to `robot`. It starts when the returned [`Transfer`] is awaited,
    /// and completes when the receiver has verified the whole content.
    ///
    /// Urgent and normal messages overtake transfers. A transfer resumes after a link is lost. It also resumes after the
    /// receiving program restarts, if that program receives into a folder, and after this program restarts and makes
    /// the same call again. Dropping the future stops the transfer; a receiver with a folder keeps the received part.
    ///
    /// ```no_run
    /// # async fn send(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot
    ///     .transfer("wombat-2", "maps/kitchen", std::path::Path::new("kitchen.pcd"))?
    ///     .on_progress(|progress| println!("{:.0} %", progress.fraction() * 100.0))
    ///     .await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`] or [`Error::Topic`] if an argument is invalid. The awaited transfer returns
    /// [`Error::TransferRefused`] if the receiver refuses it, [`Error::TransferFailed`] if it fails, [`Error::File`] if
    /// the file cannot be read, [`Error::Offer`] if the file [name](Transfer::name) is invalid, [`Error::Payload`] if
    /// the encoding is too long, [`Error::TimedOut`] if a [timeout](Transfer::timeout) was set and has expired, and
    /// [`Error::Closed`] if the session is closed.
    pub fn transfer(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        source: impl Into<TransferSource>,
    ) -> Result<Transfer, Error> {
        let inner = &self.inner;
        let (session, place) = (inner.session.clone(), inner.place.clone());
        Ok(Transfer::new(
            session,
            place,
            valid(robot)?,
            valid(topic)?,
            source.into(),
        ))
    }

    /// Receives the transfers to this robot that match `pattern`, such as `*/maps/*`, until the returned value is dropped.
    ///
    /// A transfer is refused if programs of this robot receive transfers, but the pattern of none matches it. While no
    /// program receives any, senders wait.
    ///
    /// ```no_run
    /// # async fn receive(robot: rect::Robot) -> Result<(), rect::Error> {
    /// use rect::ReceiveOptions;
    /// let maps = robot.receive_transfers("*/maps/*", ReceiveOptions::in_folder("/var/lib/maps", 100 << 20)).await?;
    /// while let Some(map) = maps.next().await {
    ///     let map = map?;
    ///     println!("{} of {}: {:?}", map.topic, map.sender, map.content);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the pattern is invalid, [`Error::File`] if the folder cannot be created, and [`Error::Closed`] if
    /// the session is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn receive_transfers(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        options: ReceiveOptions,
    ) -> Result<Transfers, Error> {
        let inner = &self.inner;
        Transfers::start(
            inner.session.clone(),
            inner.place.clone(),
            inner.runtime.clone(),
            valid(pattern)?,
            options,
        )
    }
}

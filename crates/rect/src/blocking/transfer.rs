//! Implements transfers in blocking form.
use std::{sync::Arc, time::Duration};

use super::{Robot, Runtime};
use crate::{
    session, Error, Name, Pattern, ReceiveOptions, Received, Topic, Transfer, TransferSource,
};

/// Receives transfers; created by [`Robot::receive_transfers`].
///
/// The iterator blocks until the next transfer ends, and ends when the session is closed. Dropping it stops receiving.
#[derive(Debug)]
pub struct Transfers {
    transfers: session::Transfers,
    runtime: Arc<Runtime>,
}

impl Robot {
    /// Prepares a transfer of a file or buffer of any size to `robot`. [`Transfer::wait`] starts it, and blocks until the
    /// receiver has verified the whole content.
    ///
    /// ```no_run
    /// # fn send(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// robot.transfer("wombat-2", "maps/hall", std::path::Path::new("hall.png"))?.wait()?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::transfer`].
    pub fn transfer(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        source: impl Into<TransferSource>,
    ) -> Result<Transfer, Error> {
        self.robot.transfer(robot, topic, source)
    }

    /// Receives the transfers to this robot that match `pattern`, such as `*/maps/*`.
    ///
    /// ```no_run
    /// # fn receive(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// let options = rect::ReceiveOptions::in_folder("/var/lib/maps", 100 << 20);
    /// for map in robot.receive_transfers("*/maps/*", options)? {
    ///     let map = map?;
    ///     println!("{} of {}: {:?}", map.topic, map.sender, map.content);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::receive_transfers`].
    pub fn receive_transfers(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        options: ReceiveOptions,
    ) -> Result<Transfers, Error> {
        let received = self.robot.receive_transfers(pattern, options);
        Ok(Transfers {
            transfers: self.runtime.wait(received)?,
            runtime: self.runtime.clone(),
        })
    }
}

impl Transfers {
    /// Blocks until the next transfer ends, and returns it; returns `None` if none ends within `timeout`, or if the session
    /// is closed.
    ///
    /// # Errors
    /// [`Error::TransferFailed`] if the transfer failed. Further calls return the other transfers.
    pub fn next_timeout(&mut self, timeout: Duration) -> Option<Result<Received, Error>> {
        let next = async { tokio::time::timeout(timeout, self.transfers.next()).await };
        self.runtime.wait(next).ok().flatten()
    }
}

impl Iterator for Transfers {
    type Item = Result<Received, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        self.runtime.wait(self.transfers.next())
    }
}

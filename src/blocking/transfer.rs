//! Owns transfers in blocking form.
use std::{sync::Arc, time::Duration};

use tokio::time::timeout;

use super::{Robot, Runtime};
use crate::{
    session, Error, Name, Pattern, ReceiveTransfers, Received, Topic, Transfer, TransferSource,
};

/// The transfers that come; an iterator that waits for the next one that ends. It ends when the session is closed.
#[derive(Debug)]
pub struct Transfers {
    transfers: session::Transfers,
    runtime: Arc<Runtime>,
}

impl Robot {
    /// Sends a file or bytes of any size; [`Transfer::wait`] begins it, and waits until the robot has all of it.
    ///
    /// ```no_run
    /// # fn sent(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// robot.transfer("wombat-2", "maps/hall", std::path::Path::new("hall.png"))?.wait()?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// As [`crate::Robot::transfer`].
    pub fn transfer<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        to: N,
        topic: T,
        source: impl Into<TransferSource>,
    ) -> Result<Transfer, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        self.robot.transfer(to, topic, source)
    }

    /// Takes what robots send of a pattern.
    ///
    /// # Errors
    /// As [`crate::Robot::receive_transfers`].
    pub fn receive_transfers<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        options: ReceiveTransfers,
    ) -> Result<Transfers, Error>
    where
        Error: From<P::Error>,
    {
        let received = self.robot.receive_transfers(pattern, options);
        Ok(Transfers {
            transfers: self.runtime.wait(received)?,
            runtime: self.runtime.clone(),
        })
    }
}

impl Transfers {
    /// The next one that ends; `None`: none did within that time, or the session was closed.
    pub fn next_within(&mut self, time: Duration) -> Option<Result<Received, Error>> {
        let next = async { timeout(time, self.transfers.next()).await };
        self.runtime.wait(next).ok().flatten()
    }
}

impl Iterator for Transfers {
    type Item = Result<Received, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        self.runtime.wait(self.transfers.next())
    }
}

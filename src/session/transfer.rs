//! Owns the transfers of a session: what a program says ([`Robot::transfer`]) and takes ([`Robot::receive_transfers`]).
//!
//! What is decided is in [`core::transfer`](crate::core::transfer). Each transfer has a thread of its own on either side,
//! since files and a full link make it wait; a slow link's transfer costs it a few wake-ups per second.
mod inbox;
mod incoming;
mod offering;
mod options;
mod outgoing;
mod pull;
mod queries;
mod told;

pub use incoming::{Received, Transfers};
pub use options::{Incoming, Keep, ReceiveTransfers};
pub use outgoing::{Transfer, TransferSource};

use super::robot::Robot;
use crate::{
    core::{
        name::Name,
        topic::{Pattern, Topic},
    },
    error::Error,
};

impl Robot {
    /// Transfers a file or bytes of any size to one robot, and waits until all is there and right. Everything else overtakes
    /// it. Links may come and go meanwhile, and either side may be restarted: it goes on where it was. Dropped before its
    /// end, it stops; what is there is kept where it is kept in a file.
    ///
    /// ```no_run
    /// # async fn sent(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot
    ///     .transfer("wombat-2", "maps/kitchen", std::path::Path::new("kitchen.pcd"))?
    ///     .on_progress(|progress| println!("{:.0} %", progress.fraction() * 100.0))
    ///     .await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Name`], [`Error::Topic`]; when awaited, [`Error::TransferRefused`], [`Error::TransferFailed`],
    /// [`Error::TimedOut`] where a [patience](Transfer::patience) was set, [`Error::File`].
    pub fn transfer<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        to: N,
        topic: T,
        source: impl Into<TransferSource>,
    ) -> Result<Transfer, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let inner = &self.inner;
        let (session, place) = (inner.session.clone(), inner.place.clone());
        Ok(Transfer::new(
            session,
            place,
            to.try_into()?,
            topic.try_into()?,
            source.into(),
        ))
    }

    /// Takes the transfers of `pattern` (`*/maps/*`) that others send to this robot, until what is returned is dropped.
    /// Without it none is taken.
    ///
    /// ```no_run
    /// # async fn received(robot: rect::Robot) -> Result<(), rect::Error> {
    /// use rect::ReceiveTransfers;
    /// let maps = robot.receive_transfers("*/maps/*", ReceiveTransfers::in_folder("/var/lib/maps", 100 << 20)).await?;
    /// while let Some(map) = maps.next().await {
    ///     let map = map?;
    ///     println!("{} of {}: {:?}", map.topic, map.from, map.content);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`]; [`Error::File`]: the folder can't be made; [`Error::Zenoh`] when the session is closed.
    pub async fn receive_transfers<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        options: ReceiveTransfers,
    ) -> Result<Transfers, Error>
    where
        Error: From<P::Error>,
    {
        let inner = &self.inner;
        Transfers::start(
            inner.session.clone(),
            inner.place.clone(),
            inner.runtime.clone(),
            pattern.try_into()?,
            options,
        )
    }
}

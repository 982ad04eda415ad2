//! Defines what the drivers of transfers ask of the storage.
use std::{ops::Range, time::Instant};

use bytes::Bytes;

use super::{ranges::Ranges, Checksum, Fault};
use crate::driver::QueryId;

/// A driver that needs storage. An executor performs the file actions before it polls the driver.
pub trait UsesFiles {
    /// An action that it asks of the storage.
    type Action;
    /// The outcome of an action.
    type Event;

    /// Returns the next action on the storage, if there is one.
    fn poll_file(&mut self) -> Option<Self::Action>;

    /// Handles the outcome of an action.
    fn on_file(&mut self, now: Instant, event: Self::Event);
}

/// Asks for a piece of an outgoing transfer, for the answer to a query.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadPiece {
    /// The query.
    pub query: QueryId,
    /// The bytes to read.
    pub range: Range<u64>,
}

/// The outcome of a [`ReadPiece`].
#[derive(Clone, Debug, PartialEq)]
pub struct PieceRead {
    /// The query.
    pub query: QueryId,
    /// The piece.
    pub result: Result<Bytes, Fault>,
}

/// An action on the storage of an incoming transfer.
#[derive(Clone, Debug, PartialEq)]
pub enum StoreAction {
    /// Write a piece.
    Write {
        /// Offset of the piece.
        at: u64,
        /// The piece.
        bytes: Bytes,
    },
    /// Record which ranges are stored, so that the transfer can be continued after a restart.
    Save(Ranges),
    /// Compute the checksum of everything.
    Checksum,
}

/// The outcome of a [`StoreAction`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoreEvent {
    /// A piece was written, or could not be for this reason.
    Written {
        /// The range of the piece.
        range: Range<u64>,
        /// The reason if that failed.
        result: Result<(), String>,
    },
    /// The ranges were recorded, or could not be for this reason.
    Saved(Result<(), String>),
    /// The checksum, or the reason why it could not be computed.
    Checksum(Result<Checksum, String>),
}

//! Performs the file actions of the drivers of transfers.
use super::{Content, Source, Store};
use crate::transfer::{
    files::{PieceRead, ReadPiece, StoreAction, StoreEvent},
    ranges::Ranges,
    Fault,
};

/// The storage of one transfer.
pub trait Files {
    /// An action that a driver asks of the storage.
    type Action;
    /// The outcome of an action.
    type Event;

    /// Performs an action, and returns its outcome. Blocks while it accesses the disk.
    fn perform(&mut self, action: Self::Action) -> Self::Event;
}

impl Files for Source {
    type Action = ReadPiece;
    type Event = PieceRead;

    fn perform(&mut self, ReadPiece { query, range }: ReadPiece) -> PieceRead {
        let result = self.read(range);
        PieceRead { query, result }
    }
}

impl Files for Store {
    type Action = StoreAction;
    type Event = StoreEvent;

    fn perform(&mut self, action: StoreAction) -> StoreEvent {
        let text = |error: std::io::Error| error.to_string();
        match action {
            StoreAction::Write { at, bytes } => StoreEvent::Written {
                range: at..at + bytes.len() as u64,
                result: self.write(at, &bytes).map_err(text),
            },
            StoreAction::Save(held) => StoreEvent::Saved(self.save(&held).map_err(text)),
            StoreAction::Checksum => StoreEvent::Checksum(self.checksum().map_err(text)),
        }
    }
}

/// The result of an incoming transfer that has ended.
#[derive(Debug)]
pub struct Concluded {
    /// The content, or why there is none.
    pub result: Result<Content, Fault>,
    /// Why the received part could not be kept for later, for a log.
    pub warning: Option<String>,
}

impl Store {
    /// Ends the storage of a transfer: finishes a complete one, and otherwise keeps the ranges that were `held` if the
    /// transfer can continue later.
    pub fn conclude(self, result: Result<(), Fault>, held: &Ranges) -> Concluded {
        match result {
            Ok(()) => Concluded {
                result: self
                    .finish()
                    .map_err(|error| Fault::NotStored(error.to_string())),
                warning: None,
            },
            Err(fault) => {
                let kept = self.interrupt(held, &fault);
                let warning = kept.err().map(|error| {
                    format!("cannot keep the received part of a transfer for later: {error}")
                });
                Concluded {
                    result: Err(fault),
                    warning,
                }
            }
        }
    }
}

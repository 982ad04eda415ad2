//! Owns how a program takes transfers: where to, how large, how many.
use std::{fmt, path::PathBuf, sync::Arc, time::Duration};

use crate::core::{
    encoding::Encoding,
    name::Name,
    topic::Topic,
    transfer::{Offer, Progress},
};

/// How long a sender may be silent.
const PATIENCE: Duration = Duration::from_secs(600);
const AT_ONCE: usize = 4;

/// Where what comes is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Keep {
    /// In memory. What was there is lost in a restart.
    Memory,
    /// In a folder for each sender in this one, under the name that the sender gives, replacing a file of that name. What
    /// came goes on after a restart; what nothing was added to for a week is removed, and of one sender all but the newest 16
    /// parts. What fails for good leaves nothing behind. One taker for a folder.
    Folder(PathBuf),
}

/// How a program takes transfers.
#[derive(Clone)]
pub struct ReceiveTransfers {
    pub(super) keep: Keep,
    pub(super) max_bytes: u64,
    pub(super) at_once: usize,
    pub(super) patience: Duration,
    pub(super) on_progress: Option<OnProgress>,
}

type OnProgress = Arc<dyn Fn(&Incoming, Progress) + Send + Sync>;

/// A transfer that comes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Incoming {
    /// Of whom.
    pub from: Name,
    /// About what.
    pub topic: Topic,
    /// What its sender calls it; may be empty.
    pub name: String,
    /// What it is.
    pub encoding: Encoding,
    /// How long it is.
    pub size_bytes: u64,
}

impl ReceiveTransfers {
    /// Into memory, each of at most so many bytes.
    pub fn in_memory(max_bytes: u64) -> Self {
        Self::kept(Keep::Memory, max_bytes)
    }

    /// Into files, each of at most so many bytes.
    pub fn in_folder(folder: impl Into<PathBuf>, max_bytes: u64) -> Self {
        Self::kept(Keep::Folder(folder.into()), max_bytes)
    }

    fn kept(keep: Keep, max_bytes: u64) -> Self {
        Self {
            keep,
            max_bytes,
            at_once: AT_ONCE,
            patience: PATIENCE,
            on_progress: None,
        }
    }

    /// How many at once, half of them (rounded up) of one sender at most; others wait. Default 4. On a slow link fewer wait for
    /// each other less.
    #[must_use]
    pub fn at_once(self, at_once: usize) -> Self {
        Self {
            at_once: at_once.max(1),
            ..self
        }
    }

    /// How long nothing may come before one is given up, to make room for others. Offered again it goes on. Default 10
    /// minutes.
    #[must_use]
    pub fn patience(self, patience: Duration) -> Self {
        Self { patience, ..self }
    }

    /// Calls this with what is there, up to ten times a second for each transfer, on the transfer's thread.
    #[must_use]
    pub fn on_progress(
        self,
        callback: impl Fn(&Incoming, Progress) + Send + Sync + 'static,
    ) -> Self {
        Self {
            on_progress: Some(Arc::new(callback)),
            ..self
        }
    }
}

impl From<&Offer> for Incoming {
    fn from(offer: &Offer) -> Self {
        Self {
            from: offer.from.clone(),
            topic: offer.topic.clone(),
            name: offer.name.as_str().to_owned(),
            encoding: offer.encoding.clone(),
            size_bytes: offer.size_bytes,
        }
    }
}

impl fmt::Debug for ReceiveTransfers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReceiveTransfers")
            .field("keep", &self.keep)
            .field("max_bytes", &self.max_bytes)
            .field("at_once", &self.at_once)
            .field("patience", &self.patience)
            .finish_non_exhaustive()
    }
}

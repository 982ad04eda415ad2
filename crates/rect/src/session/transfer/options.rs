//! Defines the options with which a program receives transfers: their destination, their size, their number.
use std::{fmt, path::PathBuf, sync::Arc, time::Duration};

use rect_core::{
    message::encoding::Encoding,
    name::{topic::Topic, Name},
    transfer::{Offer, Progress},
};

/// Default time without progress after which a transfer is abandoned.
const TIMEOUT: Duration = Duration::from_secs(600);
const MAX_CONCURRENT: usize = 4;

/// Where received transfers are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Destination {
    /// In memory. Incomplete transfers are lost when the program ends.
    Memory,
    /// In this folder, which contains a folder for each sender. The file has the name that the sender chose, or the id
    /// of the transfer if the sender chose none, and replaces a file of that name.
    ///
    /// An incomplete transfer resumes after a restart. Its part file is removed after a week without progress, and the
    /// part files of at most 16 incomplete transfers are kept for each sender. A transfer that failed permanently
    /// leaves no files. Only one receiver may use a folder.
    Folder(PathBuf),
}

/// The options with which a program receives transfers, for [`Robot::receive_transfers`](crate::Robot::receive_transfers).
///
/// ```
/// use rect::ReceiveOptions;
/// let options = ReceiveOptions::in_folder("/var/lib/maps", 100 << 20)
///     .max_concurrent(2)
///     .on_progress(|transfer, progress| println!("{}: {:.0} %", transfer.name, progress.fraction() * 100.0));
/// ```
#[derive(Clone)]
pub struct ReceiveOptions {
    pub(super) destination: Destination,
    pub(super) max_bytes: u64,
    pub(super) max_concurrent: usize,
    pub(super) timeout: Duration,
    pub(super) on_progress: Option<OnProgress>,
}

/// Called with the progress of an outgoing transfer.
pub(super) type OnSendProgress = Box<dyn FnMut(Progress) + Send>;

type OnProgress = Arc<dyn Fn(&IncomingTransfer, Progress) + Send + Sync>;

/// The properties of a transfer that is being received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IncomingTransfer {
    /// The robot that sends the transfer.
    pub sender: Name,
    /// The topic of the transfer.
    pub topic: Topic,
    /// The file name that the sender chose; may be empty.
    pub name: String,
    /// The encoding of the content.
    pub encoding: Encoding,
    /// The size of the content, in bytes.
    pub size_bytes: u64,
}

impl ReceiveOptions {
    /// Receives transfers of at most `max_bytes` each into memory.
    pub fn in_memory(max_bytes: u64) -> Self {
        Self::kept(Destination::Memory, max_bytes)
    }

    /// Receives transfers of at most `max_bytes` each into files below `folder`; see [`Destination::Folder`].
    pub fn in_folder(folder: impl Into<PathBuf>, max_bytes: u64) -> Self {
        Self::kept(Destination::Folder(folder.into()), max_bytes)
    }

    fn kept(destination: Destination, max_bytes: u64) -> Self {
        Self {
            destination,
            max_bytes,
            max_concurrent: MAX_CONCURRENT,
            timeout: TIMEOUT,
            on_progress: None,
        }
    }

    /// Sets the largest number of concurrent transfers, at least 1; default: 4. Further transfers wait. One sender gets at
    /// most half of the number, rounded up. On a slow link, a smaller number completes single transfers sooner.
    #[must_use]
    pub fn max_concurrent(self, max_concurrent: usize) -> Self {
        Self {
            max_concurrent: max_concurrent.max(1),
            ..self
        }
    }

    /// Sets the time without progress after which a transfer is abandoned, to make room for others; default: 10
    /// minutes. The program gets [`Error::TransferFailed`](crate::Error::TransferFailed). The transfer resumes when the
    /// sender offers it again.
    #[must_use]
    pub fn timeout(self, timeout: Duration) -> Self {
        Self { timeout, ..self }
    }

    /// Calls `callback` with the progress of each transfer, at most ten times per second, on the transfer's thread.
    #[must_use]
    pub fn on_progress(
        self,
        callback: impl Fn(&IncomingTransfer, Progress) + Send + Sync + 'static,
    ) -> Self {
        Self {
            on_progress: Some(Arc::new(callback)),
            ..self
        }
    }
}

impl From<&Offer> for IncomingTransfer {
    fn from(offer: &Offer) -> Self {
        Self {
            sender: offer.sender.clone(),
            topic: offer.topic.clone(),
            name: offer.name.as_str().to_owned(),
            encoding: offer.encoding.clone(),
            size_bytes: offer.size_bytes,
        }
    }
}

impl fmt::Debug for ReceiveOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReceiveOptions")
            .field("destination", &self.destination)
            .field("max_bytes", &self.max_bytes)
            .field("max_concurrent", &self.max_concurrent)
            .field("timeout", &self.timeout)
            .finish_non_exhaustive()
    }
}

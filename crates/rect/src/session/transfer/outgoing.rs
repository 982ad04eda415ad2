//! Defines [`Transfer`], the builder and future of a transfer that a program sends.
use std::{
    fmt,
    future::{Future, IntoFuture},
    path::{Path, PathBuf},
    pin::Pin,
    thread,
    time::Duration,
};

use bytes::Bytes;
use rect_core::{
    message::{
        encoding::Encoding,
        payload::{Payload, PayloadError},
    },
    name::{key::KeySpace, topic::Topic, Name},
    transfer::Progress,
};
use tokio::sync::oneshot;
use zenoh::Session;

use super::{
    options::OnSendProgress,
    stop::{Stop, StopOnDrop},
};
use crate::error::Error;

/// The content of a transfer: a file or a buffer.
#[derive(Clone, Debug)]
pub enum TransferSource {
    /// The path of a file. The file must not change until the transfer is complete.
    File(PathBuf),
    /// A buffer with its encoding.
    Bytes(Bytes, Encoding),
}

/// A transfer to a robot; created by [`Robot::transfer`](crate::Robot::transfer). It does nothing until it is awaited
/// or [`wait`](Self::wait) is called.
#[must_use = "a transfer starts when it is awaited"]
pub struct Transfer {
    pub(super) session: Session,
    pub(super) place: KeySpace,
    pub(super) recipient: Name,
    pub(super) topic: Topic,
    pub(super) source: TransferSource,
    pub(super) name: Option<String>,
    pub(super) encoding: Option<Encoding>,
    pub(super) timeout: Option<Duration>,
    pub(super) on_progress: Option<OnSendProgress>,
}

type Outcome = oneshot::Receiver<Result<(), Error>>;

impl Transfer {
    pub(super) fn new(
        session: Session,
        place: KeySpace,
        recipient: Name,
        topic: Topic,
        source: TransferSource,
    ) -> Self {
        Self {
            session,
            place,
            recipient,
            topic,
            source,
            name: None,
            encoding: None,
            timeout: None,
            on_progress: None,
        }
    }

    /// Sets the file name at the receiver; default: the name of the file, or an empty name for a buffer. An invalid
    /// name, such as one with a `/`, makes the transfer fail with [`Error::Offer`].
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// Sets the encoding of the content; default: the encoding of the payload, and [`Encoding::BYTES`] for files and raw
    /// buffers.
    pub fn encoding(mut self, encoding: Encoding) -> Self {
        self.encoding = Some(encoding);
        self
    }

    /// Sets the time after which the transfer fails with [`Error::TimedOut`] if the receiver sends no message, or if its program
    /// takes none of the transfers that have arrived. By default, there is no limit: the transfer waits until the receiver is
    /// reachable again. The program may still take a transfer that has failed in this way.
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = Some(timeout);
        self
    }

    /// Calls `callback` with the receiver's progress, at most ten times per second, on the transfer's thread.
    pub fn on_progress(mut self, callback: impl FnMut(Progress) + Send + 'static) -> Self {
        self.on_progress = Some(Box::new(callback));
        self
    }

    /// Starts the transfer and blocks until it ends, for programs without `async`.
    ///
    /// # Errors
    /// Returns the same errors as the awaited transfer; see [`Robot::transfer`](crate::Robot::transfer).
    ///
    /// # Panics
    /// Panics if it is called from an asynchronous runtime.
    pub fn wait(self) -> Result<(), Error> {
        let (_stop, outcome) = self.begin()?;
        outcome.blocking_recv().unwrap_or(Err(Error::Closed))
    }

    /// Starts the transfer. Dropping the returned [`StopOnDrop`] ends it; the other value resolves to its outcome.
    fn begin(self) -> Result<(StopOnDrop, Outcome), Error> {
        let of_source = match &self.source {
            TransferSource::Bytes(_, encoding) => Some(encoding),
            TransferSource::File(_) => None,
        };
        if let Some(encoding) = self.encoding.as_ref().or(of_source) {
            encoding.check_length().map_err(PayloadError::from)?;
        }
        let (done, outcome) = oneshot::channel();
        let stop = Stop::default();
        let stopped = stop.clone();
        let thread = thread::Builder::new().name("rect-transfer".into());
        let started = thread.spawn(move || {
            // Fails if the future was dropped and no one waits for the outcome.
            let _ = done.send(self.run(&stopped));
        });
        started.map_err(Error::thread)?;
        Ok((StopOnDrop(stop), outcome))
    }
}

impl IntoFuture for Transfer {
    type Output = Result<(), Error>;
    type IntoFuture = Pin<Box<dyn Future<Output = Result<(), Error>> + Send>>;

    fn into_future(self) -> Self::IntoFuture {
        let begun = self.begin();
        Box::pin(async move {
            let (_stop, outcome) = begun?;
            outcome.await.unwrap_or(Err(Error::Closed))
        })
    }
}

impl From<&Path> for TransferSource {
    fn from(path: &Path) -> Self {
        Self::File(path.to_owned())
    }
}

impl From<&PathBuf> for TransferSource {
    fn from(path: &PathBuf) -> Self {
        Self::File(path.clone())
    }
}

impl From<PathBuf> for TransferSource {
    fn from(path: PathBuf) -> Self {
        Self::File(path)
    }
}

impl From<Payload> for TransferSource {
    fn from(payload: Payload) -> Self {
        Self::Bytes(payload.bytes, payload.encoding)
    }
}

impl From<Bytes> for TransferSource {
    fn from(bytes: Bytes) -> Self {
        Self::Bytes(bytes, Encoding::BYTES)
    }
}

impl From<Vec<u8>> for TransferSource {
    fn from(bytes: Vec<u8>) -> Self {
        Bytes::from(bytes).into()
    }
}

impl fmt::Debug for Transfer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            recipient,
            topic,
            source,
            ..
        } = self;
        f.debug_struct("Transfer")
            .field("recipient", recipient)
            .field("topic", topic)
            .field("source", source)
            .finish_non_exhaustive()
    }
}

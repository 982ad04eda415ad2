//! Owns what a program says of a transfer that it sends.
use std::{
    fmt,
    future::{Future, IntoFuture},
    path::{Path, PathBuf},
    pin::Pin,
    sync::mpsc,
    thread,
    time::Duration,
};

use bytes::Bytes;
use tokio::sync::oneshot;
use zenoh::Session;

use super::offering::{Stop, WAITING};
use crate::{
    core::{
        encoding::Encoding,
        key::Place,
        name::Name,
        payload::{Payload, PayloadError},
        topic::Topic,
        transfer::Progress,
    },
    error::Error,
};

/// What is transferred: a file by its path, or bytes.
#[derive(Clone, Debug)]
pub enum TransferSource {
    /// A file. It must not change before all is there.
    File(PathBuf),
    /// Bytes.
    Bytes(Bytes, Encoding),
}

/// A transfer to a robot. Does nothing until awaited.
#[must_use = "a transfer begins when it is awaited"]
pub struct Transfer {
    pub(super) session: Session,
    pub(super) place: Place,
    pub(super) to: Name,
    pub(super) topic: Topic,
    pub(super) source: TransferSource,
    pub(super) name: Option<String>,
    pub(super) encoding: Option<Encoding>,
    pub(super) patience: Option<Duration>,
    pub(super) on_progress: Option<Box<dyn FnMut(Progress) + Send>>,
}

type Outcome = oneshot::Receiver<Result<(), Error>>;

impl Transfer {
    pub(super) fn new(
        session: Session,
        place: Place,
        to: Name,
        topic: Topic,
        source: TransferSource,
    ) -> Self {
        Self {
            session,
            place,
            to,
            topic,
            source,
            name: None,
            encoding: None,
            patience: None,
            on_progress: None,
        }
    }

    /// What it is called there. Default: the file's name; bytes have none.
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.name = Some(name.into());
        self
    }

    /// What it is. Default: the payload's encoding; files and other bytes are bytes.
    pub fn encoding(mut self, encoding: Encoding) -> Self {
        self.encoding = Some(encoding);
        self
    }

    /// How long nothing may be heard of the receiver. Default: it may come back whenever it likes.
    pub fn patience(mut self, patience: Duration) -> Self {
        self.patience = Some(patience);
        self
    }

    /// Calls this with what the receiver holds, up to ten times a second, on the transfer's thread.
    pub fn on_progress(mut self, callback: impl FnMut(Progress) + Send + 'static) -> Self {
        self.on_progress = Some(Box::new(callback));
        self
    }

    /// Begins it, and waits for its end: for programs without `async`. Panics inside of an async runtime.
    ///
    /// # Errors
    /// As when awaited.
    pub fn wait(self) -> Result<(), Error> {
        let (_stop, outcome) = self.begin()?;
        outcome.blocking_recv().unwrap_or(Err(Error::Closed))
    }

    /// Begins; the first that is returned ends it when dropped, the other has how it ended.
    fn begin(self) -> Result<(Stop, Outcome), Error> {
        let of_source = match &self.source {
            TransferSource::Bytes(_, encoding) => Some(encoding),
            TransferSource::File(_) => None,
        };
        if let Some(encoding) = self.encoding.as_ref().or(of_source) {
            encoding.check_length().map_err(PayloadError::from)?;
        }
        let (events, incoming) = mpsc::sync_channel(WAITING);
        let (done, outcome) = oneshot::channel();
        let stop = Stop::new(&events);
        let thread = thread::Builder::new().name("rect-transfer".into());
        let started = thread.spawn(move || {
            let how = self.run(&events, &incoming);
            // Nobody waits any more where it was dropped.
            let _ = done.send(how);
        });
        started.map_err(|error| Error::Zenoh {
            what: "no thread for the transfer",
            reason: error.to_string(),
        })?;
        Ok((stop, outcome))
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
            to, topic, source, ..
        } = self;
        f.debug_struct("Transfer")
            .field("to", to)
            .field("topic", topic)
            .field("source", source)
            .finish_non_exhaustive()
    }
}

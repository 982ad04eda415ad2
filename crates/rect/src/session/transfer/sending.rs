//! Runs the thread of an outgoing transfer, which offers it and serves its pieces until it ends.
use std::{
    sync::{Mutex, PoisonError},
    time::Instant,
};

use rect_core::{
    message::encoding::Encoding,
    storage::Source,
    transfer::{
        offer::FileName,
        push::{SendError, TransferPush},
        Offer, Progress,
    },
};

use super::{
    options::OnSendProgress,
    outgoing::{Transfer, TransferSource},
    stop::Stop,
};
use crate::{
    error::Error,
    session::{executor::Executor, shared::Sink},
};

struct ProgressSink(Mutex<Option<OnSendProgress>>);

impl Sink<Progress> for ProgressSink {
    fn deliver(&self, progress: Progress) {
        let mut callback = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(callback) = callback.as_mut() {
            callback(progress);
        }
    }
}

impl Transfer {
    /// Runs the transfer, from computing the checksum to its end.
    pub(super) fn run(mut self, stop: &Stop) -> Result<(), Error> {
        let (mut source, offer) = self.prepare()?;
        let (recipient, timeout) = (self.recipient.clone(), self.timeout);
        let push = TransferPush::new(&self.place, recipient, offer, timeout, Instant::now());
        let sink = ProgressSink(Mutex::new(self.on_progress.take()));
        let executor = Executor::new(&self.session, push, sink);
        if !stop.on_running(executor.shared()) {
            return Err(Error::Closed);
        }
        let sent = executor.run_with_files(&mut source)?;
        sent.map_err(|error| self.error(error))
    }

    fn prepare(&mut self) -> Result<(Source, Offer), Error> {
        let (source, name, encoding) = match &self.source {
            TransferSource::File(path) => {
                let source = Source::of_file(path).map_err(|reason| Error::File {
                    path: path.clone(),
                    reason,
                })?;
                let name = path
                    .file_name()
                    .map(|name| name.to_string_lossy().into_owned());
                (source, name, Encoding::BYTES)
            }
            TransferSource::Bytes(bytes, encoding) => {
                (Source::of_bytes(bytes.clone()), None, encoding.clone())
            }
        };
        let name = self.name.take().or(name).unwrap_or_default();
        let offer = Offer {
            sender: self.place.robot.clone(),
            topic: self.topic.clone(),
            name: FileName::new(&name)?,
            encoding: self.encoding.take().unwrap_or(encoding),
            size_bytes: source.size_bytes(),
            checksum: source.checksum(),
            call: rand::random(),
        };
        Ok((source, offer))
    }

    fn error(self, error: SendError) -> Error {
        let (robot, topic) = (self.recipient, self.topic);
        match error {
            SendError::Refused(refusal) => Error::TransferRefused {
                robot,
                topic,
                refusal,
            },
            SendError::Failed(fault) => Error::TransferFailed {
                robot,
                topic,
                fault,
            },
            SendError::TimedOut { expected, timeout } => Error::TimedOut { expected, timeout },
            SendError::Closed => Error::Closed,
        }
    }
}

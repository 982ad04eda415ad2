//! Defines [`Transfers`], through which a program receives transfers, and starts its threads.
use std::{fmt, fs, sync::Arc, thread, time::SystemTime};

use tokio::{
    runtime::Handle,
    sync::{
        mpsc::{self, Receiver},
        Mutex,
    },
};
use zenoh::{query::Queryable, Session, Wait};

use super::{
    options::{Destination, IncomingTransfer, ReceiveOptions},
    receiver::{self, Shared},
};
use crate::{
    core::{
        key::KeySpace,
        topic::Pattern,
        transfer::{
            admission::{Admission, AdmissionRules},
            OFFERS,
        },
    },
    error::Error,
    storage::{Content, Store},
};

/// A complete transfer whose checksum was verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// The properties of the transfer, which are also accessible through `Deref`: `received.sender`.
    pub transfer: IncomingTransfer,
    /// The content: a file or a buffer.
    pub content: Content,
}

/// Receives transfers; created by [`Robot::receive_transfers`](crate::Robot::receive_transfers).
///
/// Dropping it stops receiving. Incomplete transfers are kept only if they are received into a folder.
pub struct Transfers {
    ended: Mutex<Receiver<Result<Received, Error>>>,
    shared: Arc<Shared>,
    _declared: Queryable<()>,
}

impl Received {
    pub(super) fn new(transfer: IncomingTransfer, content: Content) -> Self {
        Self { transfer, content }
    }
}

impl std::ops::Deref for Received {
    type Target = IncomingTransfer;

    fn deref(&self) -> &IncomingTransfer {
        &self.transfer
    }
}

impl Transfers {
    pub(super) fn start(
        session: Session,
        place: KeySpace,
        runtime: Handle,
        pattern: Pattern,
        options: ReceiveOptions,
    ) -> Result<Self, Error> {
        if let Destination::Folder(folder) = &options.destination {
            fs::create_dir_all(folder).map_err(|reason| Error::File {
                path: folder.clone(),
                reason,
            })?;
            Store::clean(folder, SystemTime::now());
        }
        let (ended, waiting) = mpsc::channel(options.max_concurrent);
        let rules = AdmissionRules {
            pattern,
            max_bytes: options.max_bytes,
            max_concurrent: options.max_concurrent,
        };
        let admission = Admission::new(place.robot.clone(), rules);
        let key = place.own(Some(&place.robot), OFFERS);
        let shared = Shared::new(session.clone(), place, options, runtime, admission, ended);
        let (offers, incoming) = receiver::events();
        let (this, reply_key) = (shared.clone(), key.clone());
        let thread = thread::Builder::new().name("rect-admission".into());
        let started = thread.spawn(move || this.answer_all(&incoming, &reply_key));
        started.map_err(|error| Error::Zenoh {
            operation: "cannot start a thread for transfers",
            reason: error.to_string(),
        })?;
        // The thread ends with the queryable, which owns the other end of the channel.
        let declared = session
            .declare_queryable(key)
            .callback(move |query| offers.push(query))
            .wait()
            .map_err(Error::zenoh("cannot declare the queryable for transfers"))?;
        Ok(Self {
            ended: Mutex::new(waiting),
            shared,
            _declared: declared,
        })
    }

    /// Waits for the next transfer that ends, and returns it; returns `None` once the session is closed.
    ///
    /// # Errors
    /// [`Error::TransferFailed`] if the transfer failed. Further calls return the other transfers.
    pub async fn next(&self) -> Option<Result<Received, Error>> {
        self.ended.lock().await.recv().await
    }
}

impl Drop for Transfers {
    fn drop(&mut self) {
        self.shared.stop();
        if let Ok(mut ended) = self.ended.try_lock() {
            ended.close();
        }
    }
}

impl fmt::Debug for Transfers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Transfers")
    }
}

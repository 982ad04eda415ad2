//! Defines [`Transfers`], through which a program receives transfers.
use std::{
    fmt, fs,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    time::SystemTime,
};

use futures_core::Stream;
use rect_core::{
    name::{key::KeySpace, topic::Pattern},
    storage::Store,
    transfer::admission::AdmissionRules,
};
use tokio::{
    runtime::Handle,
    sync::{
        mpsc::{self, Receiver},
        Mutex,
    },
};
use zenoh::Session;

use super::{
    options::{Destination, ReceiveOptions},
    received::Received,
    receiving::Reception,
};
use crate::{error::Error, session::next_item::NextItem};

/// Receives transfers; created by [`Robot::receive_transfers`](crate::Robot::receive_transfers).
///
/// It also implements [`futures_core::Stream`]. Dropping it stops receiving. Incomplete transfers are kept only if they are received into a folder.
pub struct Transfers {
    ended: Arc<Mutex<Receiver<Result<Received, Error>>>>,
    next: NextItem<Result<Received, Error>>,
    receiving: Arc<Reception>,
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
        Ok(Self {
            receiving: Reception::start(session, place, runtime, rules, options, ended)?,
            ended: Arc::new(Mutex::new(waiting)),
            next: NextItem::default(),
        })
    }

    /// Waits for the next transfer that ends, and returns it; returns `None` once the session is closed.
    ///
    /// # Errors
    /// [`Error::TransferFailed`] if the transfer failed. Further calls return the other transfers.
    ///
    /// # Cancel safety
    /// If the future is dropped, no transfer is lost: the next call returns it. The same holds for the [`Stream`], which keeps its
    /// wait.
    pub async fn next(&self) -> Option<Result<Received, Error>> {
        self.ended.lock().await.recv().await
    }
}

impl Stream for Transfers {
    type Item = Result<Received, Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let Self { ended, next, .. } = &mut *self;
        next.poll(context, || {
            let ended = ended.clone();
            async move { ended.lock().await.recv().await }
        })
    }
}

impl Drop for Transfers {
    fn drop(&mut self) {
        self.receiving.stop();
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

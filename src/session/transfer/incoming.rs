//! Owns taking transfers: what a program gets.
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
    inbox::{self, Shared},
    options::{Incoming, Keep, ReceiveTransfers},
};
use crate::{
    core::{
        key::Place,
        topic::Pattern,
        transfer::{
            inbox::{Inbox, Wanted},
            INBOX,
        },
    },
    error::Error,
    storage::{Content, Store},
};

/// A transfer that came, with the right checksum.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// Of whom, about what, and what it is.
    pub about: Incoming,
    /// What came.
    pub content: Content,
}

/// The transfers that come. Dropped, it takes no more; what came of those that run is kept where it is kept in files.
pub struct Transfers {
    ended: Mutex<Receiver<Result<Received, Error>>>,
    shared: Arc<Shared>,
    _declared: Queryable<()>,
}

impl Received {
    pub(super) fn new(about: Incoming, content: Content) -> Self {
        Self { about, content }
    }
}

impl std::ops::Deref for Received {
    type Target = Incoming;

    fn deref(&self) -> &Incoming {
        &self.about
    }
}

impl Transfers {
    pub(super) fn start(
        session: Session,
        place: Place,
        runtime: Handle,
        pattern: Pattern,
        options: ReceiveTransfers,
    ) -> Result<Self, Error> {
        if let Keep::Folder(folder) = &options.keep {
            fs::create_dir_all(folder).map_err(|reason| Error::File {
                path: folder.clone(),
                reason,
            })?;
            Store::clean(folder, SystemTime::now());
        }
        let (ended, waiting) = mpsc::channel(options.at_once);
        let wanted = Wanted {
            pattern,
            max_bytes: options.max_bytes,
            max_running: options.at_once,
        };
        let inbox = Inbox::new(place.robot.clone(), wanted);
        let key = place.own(Some(&place.robot), INBOX);
        let shared = Shared::new(session.clone(), place, options, runtime, inbox, ended);
        let (offers, incoming) = inbox::events();
        let (this, reply_key) = (shared.clone(), key.clone());
        let thread = thread::Builder::new().name("rect-inbox".into());
        let started = thread.spawn(move || this.answer_all(&incoming, &reply_key));
        started.map_err(|error| Error::Zenoh {
            what: "no thread for transfers",
            reason: error.to_string(),
        })?;
        // The thread ends with the queryable, which has the only other end.
        let declared = session
            .declare_queryable(key)
            .callback(move |query| offers.push(query))
            .wait()
            .map_err(Error::zenoh("transfers can't be taken"))?;
        Ok(Self {
            ended: Mutex::new(waiting),
            shared,
            _declared: declared,
        })
    }

    /// The next one that ended, once there is one: all of it, or why it is not. `None`: the session was closed.
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

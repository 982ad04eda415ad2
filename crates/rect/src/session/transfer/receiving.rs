//! Receives transfers: starts a thread for each one that is accepted, and passes the outcomes to the program.
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread,
    time::Instant,
};

use rect_core::{
    name::key::KeySpace,
    storage::{Concluded, Content, Store},
    transfer::{
        admission::AdmissionRules,
        pull::TransferPull,
        reception::{Arrival, TransferReception},
        Fault, Offer, Progress, TransferId,
    },
};
use tokio::{runtime::Handle, sync::mpsc::Sender};
use zenoh::Session;

use super::{
    options::{Destination, IncomingTransfer, ReceiveOptions},
    received::Received,
};
use crate::{
    error::Error,
    session::{
        executor::Executor,
        shared::{NoItems, Shared, Sink},
    },
};

/// The reception of transfers by one program.
pub(super) struct Reception {
    session: Session,
    place: KeySpace,
    options: ReceiveOptions,
    runtime: Handle,
    state: Mutex<State>,
}

struct State {
    /// Answers offers; `None` before it has started.
    reception: Option<Arc<Shared<TransferReception>>>,
    running: HashMap<TransferId, Arc<Shared<TransferPull>>>,
    is_stopped: bool,
    /// Ended transfers, to be read by the program; `None` once no more are received.
    ended: Option<Sender<Result<Received, Error>>>,
}

impl Reception {
    pub(super) fn start(
        session: Session,
        place: KeySpace,
        runtime: Handle,
        rules: AdmissionRules,
        options: ReceiveOptions,
        ended: Sender<Result<Received, Error>>,
    ) -> Result<Arc<Self>, Error> {
        let reception = TransferReception::new(place.clone(), rules);
        let state = State {
            reception: None,
            running: HashMap::new(),
            is_stopped: false,
            ended: Some(ended),
        };
        let receiving = Arc::new(Self {
            session,
            place,
            options,
            runtime,
            state: Mutex::new(state),
        });
        let sink = ArrivalSink(receiving.clone());
        let executor = Executor::new(&receiving.session, reception, sink);
        receiving.state().reception = Some(executor.shared().clone());
        // A thread, because a question waits while a link has no room.
        executor.start_thread("rect-admission")?;
        Ok(receiving)
    }

    /// Stops the running transfers and accepts no further ones.
    pub(super) fn stop(&self) {
        let mut state = self.state();
        state.is_stopped = true;
        for running in state.running.values() {
            running.driver().stop();
            running.wake();
        }
        if let Some(reception) = &state.reception {
            reception.driver().stop();
            reception.wake();
        }
    }

    fn begin(self: &Arc<Self>, id: TransferId, offer: Offer) {
        let this = self.clone();
        let thread = thread::Builder::new().name("rect-transfer".into());
        let started = thread.spawn(move || this.receive(id, &offer));
        if let Err(error) = started {
            let fault = Fault::NotStored(format!("it cannot start a thread: {error}"));
            self.on_ended(id, Err(fault), true);
        }
    }

    /// Receives a transfer, from opening its storage to its end.
    fn receive(self: &Arc<Self>, id: TransferId, offer: &Offer) {
        let opened = match &self.options.destination {
            Destination::Memory => {
                Store::in_memory(offer.size_bytes).map(|store| (store, Default::default()))
            }
            Destination::Folder(folder) => Store::in_folder(folder, id, offer),
        };
        let (store, held, unusable) = match opened {
            Ok((store, held)) => (Some(store), held, None),
            Err(error) => {
                let fault = Fault::NotStored(error.to_string());
                (None, Default::default(), Some(fault))
            }
        };
        let timeout = self.options.timeout;
        let pull = TransferPull::new(&self.place, id, offer, held, timeout, Instant::now());
        let report = pull.end_report();
        let about = IncomingTransfer::from(offer);
        let sink = ProgressSink {
            receiving: self.clone(),
            id,
            about: about.clone(),
        };
        let content = match (store, unusable) {
            (Some(store), None) => self.pull(id, Executor::new(&self.session, pull, sink), store),
            (_, fault) => Err(fault.unwrap_or(Fault::Stopped)),
        };
        self.conclude(id, about, content, || {
            let report = Executor::new(&self.session, report, NoItems);
            if let Err(error) = report.run_blocking() {
                tracing::debug!("cannot report the end of a transfer: {error}");
            }
        });
    }

    fn pull(
        &self,
        id: TransferId,
        executor: Executor<TransferPull>,
        mut store: Store,
    ) -> Result<Content, Fault> {
        let mut state = self.state();
        state.running.insert(id, executor.shared().clone());
        if state.is_stopped {
            executor.shared().driver().stop();
        }
        drop(state);
        let pulled = executor.run_with_files(&mut store);
        let result = pulled.unwrap_or(Err(Fault::Stopped));
        let held = executor.shared().driver().held().clone();
        let Concluded { result, warning } = store.conclude(result, &held);
        if let Some(warning) = warning {
            tracing::warn!("{warning}");
        }
        result
    }

    /// Reports the end of a transfer to the sender, by `report_end`, and to the program.
    fn conclude(
        &self,
        id: TransferId,
        about: IncomingTransfer,
        content: Result<Content, Fault>,
        report_end: impl FnOnce(),
    ) {
        // A transfer is complete only if the program will receive it. Until a slow program reads the previous ones, this
        // thread waits, and the transfer keeps its place.
        if let Some(reception) = &self.state().reception {
            reception.driver().on_untaken(id);
        }
        let room = match &content {
            Err(Fault::Stopped) => None,
            _ => {
                let ended = self.state().ended.clone();
                ended.and_then(|ended| self.runtime.block_on(ended.reserve_owned()).ok())
            }
        };
        let result = content.as_ref().map(drop).map_err(Clone::clone);
        self.on_ended(id, result, room.is_some());
        // The sender is notified first, because the program may exit as soon as it receives the transfer.
        report_end();
        if let Some(room) = room {
            room.send(match content {
                Ok(content) => Ok(Received::new(about, content)),
                Err(fault) => Err(Error::TransferFailed {
                    robot: about.sender,
                    topic: about.topic,
                    fault,
                }),
            });
        }
    }

    fn on_ended(&self, id: TransferId, result: Result<(), Fault>, has_room: bool) {
        let mut state = self.state();
        state.running.remove(&id);
        if let Some(reception) = &state.reception {
            reception.driver().on_ended(id, result, has_room);
            reception.wake();
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Starts the transfers that arrive.
struct ArrivalSink(Arc<Reception>);

impl Sink<Arrival> for ArrivalSink {
    fn deliver(&self, arrival: Arrival) {
        match arrival {
            Arrival::Begin(id, offer) => self.0.begin(id, *offer),
            Arrival::OfferedAgain(id) => {
                let running = self.0.state().running.get(&id).cloned();
                if let Some(running) = running {
                    running.driver().on_offered(Instant::now());
                    running.wake();
                }
            }
        }
    }

    fn end(&self) {
        let mut state = self.0.state();
        state.ended = None;
        // The driver and this value refer to each other.
        state.reception = None;
    }
}

/// Reports the progress of a transfer to the driver that answers offers, and to the program.
struct ProgressSink {
    receiving: Arc<Reception>,
    id: TransferId,
    about: IncomingTransfer,
}

impl Sink<Progress> for ProgressSink {
    fn deliver(&self, progress: Progress) {
        let reception = self.receiving.state().reception.clone();
        if let Some(reception) = reception {
            let mut reception = reception.driver();
            reception.on_received_bytes(self.id, progress.received_bytes);
        }
        if let Some(callback) = &self.receiving.options.on_progress {
            callback(&self.about, progress);
        }
    }
}

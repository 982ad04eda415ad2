//! The state of one link, which Zenoh and the tasks of its paths share.
use std::{
    collections::{BTreeMap, HashMap},
    future::Future,
    net::{IpAddr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use link_lanes::{
    hello::NodeId,
    lanes::{report::Count, Lane, LANES},
    usage::{
        keys::{self, Side},
        UsageReport,
    },
};
use parking_lot::Mutex;
use tokio::{
    sync::{watch, Notify},
    time::Instant,
};
use tokio_util::sync::CancellationToken;

use crate::{
    error::AnyError,
    frame::{self, Frame},
    multipath::{Change, LaneReport, Multipath, Options, PathId, PathReport, Switch, Violation},
    observers, offer,
    path::{Medium, PathState},
    proof::{Proof, Role},
};

/// A link over several paths.
pub(crate) struct Shared {
    /// The number of the link, which both sides know.
    pub(crate) id: u64,
    pub(crate) peer: String,
    /// The peer's Zenoh runtime.
    pub(crate) node: NodeId,
    pub(crate) role: Role,
    /// The keys that prove that a connection belongs to the link; `None` without a secret.
    pub(crate) proof: Option<Proof>,
    /// Whether the peer accepts compressed batches.
    pub(crate) is_compressed: bool,
    pub(crate) since: Instant,
    options: Options,
    state: Mutex<State>,
    /// Notified when a writer may try again.
    room: Notify,
    arrived: [Notify; LANES],
    /// The addresses that this side offers, encoded.
    own_offer: watch::Sender<Vec<u8>>,
    /// The addresses that the peer has offered.
    offered: watch::Sender<Vec<SocketAddr>>,
    /// Notified whenever a path is added or removed, or may have become suspect.
    pub(crate) paths_changed: Notify,
    /// Notified whenever the network interfaces of this computer have changed.
    pub(crate) networks_changed: Notify,
    ended: CancellationToken,
}

struct State {
    multipath: Multipath,
    /// The tasks of the paths.
    tasks: HashMap<PathId, Task>,
    /// The primary path that was reported last.
    reported: Option<PathId>,
    end: Option<Arc<AnyError>>,
}

/// The task that runs a path.
#[derive(Clone, Default)]
pub(crate) struct Task {
    /// Notified when there may be something to send.
    pub(crate) waker: Arc<Notify>,
    /// Cancelled when the path is not needed any more.
    pub(crate) end: CancellationToken,
    /// Cancelled when this side has lost the network of the path.
    pub(crate) network_lost: CancellationToken,
    /// The path's address on this side, if it has one.
    local: Option<IpAddr>,
}

/// One path of a link. Dropping it removes the path.
pub(crate) struct PathGuard {
    pub(crate) shared: Arc<Shared>,
    pub(crate) id: PathId,
    pub(crate) task: Task,
}

/// The next step of a task that sends on a path.
pub(crate) enum Next {
    /// Send the frame, on that lane.
    Frame(Lane),
    /// Wait until the path is woken or, if given, until that time.
    Wait(Option<Instant>),
}

impl Shared {
    pub(crate) fn new(
        id: u64,
        peer: String,
        node: NodeId,
        role: Role,
        proof: Option<Proof>,
        is_compressed: bool,
        options: Options,
    ) -> Arc<Self> {
        let now = Instant::now();
        let options = Options {
            is_encrypted: proof.is_some(),
            ..options
        };
        Arc::new(Self {
            id,
            peer,
            node,
            role,
            proof,
            is_compressed,
            since: now,
            options,
            state: Mutex::new(State {
                multipath: Multipath::new(options, now.into_std()),
                tasks: HashMap::new(),
                reported: None,
                end: None,
            }),
            room: Notify::new(),
            arrived: Default::default(),
            own_offer: watch::Sender::new(Vec::new()),
            offered: watch::Sender::new(Vec::new()),
            paths_changed: Notify::new(),
            networks_changed: Notify::new(),
            ended: CancellationToken::new(),
        })
    }

    /// Adds a path.
    pub(crate) fn add_path(
        self: &Arc<Self>,
        medium: Medium,
        max_frame: usize,
        is_proven: bool,
        local: Option<IpAddr>,
    ) -> PathGuard {
        let task = Task {
            local,
            ..Task::default()
        };
        let mut state = self.state.lock();
        let now = Instant::now().into_std();
        let id = (state.multipath).add_path(medium, max_frame, is_proven, now);
        state.tasks.insert(id, task.clone());
        drop(state);
        tracing::info!("any: {} has a path over {medium}", self.peer);
        self.paths_changed.notify_waiters();
        PathGuard {
            shared: Arc::clone(self),
            id,
            task,
        }
    }

    /// Ends network paths that work, but are not needed beside another one. There are two after the network was silent for a
    /// while: the old connection, and the one that should have replaced it.
    pub(crate) fn end_spare_paths(&self) {
        let state = self.state.lock();
        let live: Vec<_> = (state.multipath.paths())
            .filter(|(_, path)| path.is_live_network())
            .collect();
        let kept = live.iter().find(|(_, path)| path.is_primary);
        let Some((kept, _)) = kept.or(live.last()) else {
            return;
        };
        let spare = live.iter().filter(|(id, _)| id != kept);
        for task in spare.filter_map(|(id, _)| state.tasks.get(id)) {
            task.end.cancel();
        }
    }

    /// Ends the paths whose own address works no more. `working` are the addresses of interfaces that are up.
    pub(crate) fn on_networks_changed(&self, working: &[IpAddr]) {
        let state = self.state.lock();
        for task in state.tasks.values() {
            if task.local.is_some_and(|local| !working.contains(&local)) {
                task.network_lost.cancel();
            }
        }
        drop(state);
        self.networks_changed.notify_waiters();
    }

    /// Ends the Bluetooth path.
    pub(crate) fn end_bluetooth(&self) {
        let state = self.state.lock();
        let mut paths = state.multipath.paths();
        let found = paths.find(|(_, path)| path.medium == Medium::Bluetooth);
        if let Some(task) = found.and_then(|(id, _)| state.tasks.get(&id)) {
            task.end.cancel();
        }
    }

    /// Returns whether the link has a network path that works.
    pub(crate) fn has_live_network(&self) -> bool {
        self.paths().iter().any(PathReport::is_live_network)
    }

    /// Returns whether the link has a Bluetooth path.
    pub(crate) fn has_bluetooth(&self) -> bool {
        let is_bluetooth = |path: &PathReport| path.medium == Medium::Bluetooth;
        self.paths().iter().any(is_bluetooth)
    }

    /// Returns whether the link needs a network path: it has none, or the only one is suspected. After a change of the
    /// network, a new connection works long before the old one ends.
    pub(crate) fn needs_network(&self) -> bool {
        let paths = self.paths().into_iter();
        let mut network = paths.filter(|path| path.medium == Medium::Network);
        match (network.next(), network.next()) {
            (None, _) => true,
            (Some(only), None) => only.state == PathState::Suspected,
            (Some(_), Some(_)) => false,
        }
    }

    /// Returns whether the peer evidently has the link, too.
    pub(crate) fn is_shared(&self) -> bool {
        let now = Instant::now().into_std();
        !self.has_ended() && self.state.lock().multipath.is_shared(now)
    }

    /// Returns the paths of the link.
    pub(crate) fn paths(&self) -> Vec<PathReport> {
        let state = self.state.lock();
        let paths = state.multipath.paths();
        paths.map(|(_, report)| report).collect()
    }

    /// Returns the batches sent and received.
    pub(crate) fn traffic(&self) -> (Count, Count) {
        self.state.lock().multipath.traffic()
    }

    /// Returns the lanes that were used, the most urgent first.
    pub(crate) fn lanes(&self) -> Vec<(Lane, LaneReport)> {
        self.state.lock().multipath.lanes()
    }

    /// Returns how often the path that carries the bulk was replaced, and the last time.
    pub(crate) fn switches(&self) -> (u64, Option<Switch>) {
        let multipath = &self.state.lock().multipath;
        (multipath.switches(), multipath.last_switch())
    }

    /// Keeps the keys that a batch of Zenoh's own messages declares.
    pub(crate) fn on_declarations(&self, from: Side, batch: &[u8]) {
        if keys::may_declare(batch) {
            self.state.lock().multipath.keys().on_batch(from, batch);
        }
    }

    /// Returns what was sent over each medium for each key: see [`Multipath::usage`].
    pub(crate) fn usage(&self, keep: Duration) -> BTreeMap<Medium, UsageReport> {
        let now = Instant::now().into_std();
        self.state.lock().multipath.usage(now, keep)
    }

    /// Queues a batch on its lane. Waits while there is no room.
    pub(crate) async fn write(&self, lane: Lane, batch: &[u8]) -> Result<(), AnyError> {
        let max = self.options.max_batch;
        if batch.len() > max {
            return Err(AnyError::BatchTooLarge {
                size: batch.len(),
                max,
            });
        }
        loop {
            let room = self.room.notified();
            let retry_at = {
                let (mut state, now) = (self.state.lock(), Instant::now().into_std());
                state.check()?;
                if state.multipath.push(lane, batch, now) {
                    state.wake_all();
                    return Ok(());
                }
                state.multipath.retry_at(lane, batch, now)
            };
            let until_room = async {
                match retry_at {
                    Some(at) => drop(tokio::time::timeout_at(at.into(), room).await),
                    None => room.await,
                }
            };
            self.unless_ended(until_room).await;
        }
    }

    /// Returns the next batch of a lane. Waits until there is one.
    pub(crate) async fn read(&self, lane: Lane) -> Result<Vec<u8>, AnyError> {
        loop {
            {
                let (mut state, now) = (self.state.lock(), Instant::now().into_std());
                if let Some(batch) = state.take(lane, now) {
                    return Ok(batch);
                }
                state.check()?;
            }
            let arrived = self.arrived[lane.index()].notified();
            self.unless_ended(arrived).await;
        }
    }

    /// Writes the next frame for a path into `frame`.
    pub(crate) fn next_frame(&self, id: PathId, least_urgent: Lane, frame: &mut Vec<u8>) -> Next {
        let (mut state, now) = (self.state.lock(), Instant::now().into_std());
        let before = state.multipath.wakeups();
        let lane = (state.multipath).next_frame(id, least_urgent, frame, now);
        if state.multipath.wakeups() != before {
            state.wake_all();
            state.report_switch(&self.peer);
            self.paths_changed.notify_waiters();
        }
        self.end_if_due(&mut state);
        match lane {
            Some(lane) => Next::Frame(lane),
            None => Next::Wait(state.multipath.next_time(id).map(Instant::from_std)),
        }
    }

    /// Handles a frame that has arrived on a path.
    ///
    /// # Errors
    /// Fails if the path has to end.
    pub(crate) fn on_frame(&self, id: PathId, bytes: &[u8]) -> Result<(), AnyError> {
        if let Ok(Frame::Offer(body)) = frame::decode(bytes) {
            let offered = offer::decode(body).map_err(|error| self.protocol(&error))?;
            set(&self.offered, offered);
            return Ok(());
        }
        let (mut state, now) = (self.state.lock(), Instant::now().into_std());
        let (before, ack_at) = (state.multipath.wakeups(), state.multipath.ack_at(id));
        let mut has_room = false;
        match state.multipath.on_frame(id, bytes, now) {
            Ok(Change::Batch(lane)) => self.arrived[lane.index()].notify_one(),
            Ok(Change::Credits) => {
                self.room.notify_waiters();
                has_room = true;
            }
            Ok(Change::Nothing) => {}
            Err(violation @ Violation::Lane { .. }) => {
                let error = self.protocol(&violation);
                self.end(&mut state, error);
            }
            Err(violation) => return Err(self.protocol(&violation)),
        }
        self.end_if_due(&mut state);
        if state.multipath.wakeups() != before {
            state.wake_all();
            state.report_switch(&self.peer);
        } else if has_room || state.multipath.ack_at(id) != ack_at {
            state.wake(id);
        }
        Ok(())
    }

    /// Returns the size of the largest batch, in bytes.
    pub(crate) fn max_batch(&self) -> u16 {
        u16::try_from(self.options.max_batch).unwrap_or(u16::MAX)
    }

    /// Offers these addresses to the peer, over Bluetooth.
    pub(crate) fn offer(&self, offer: Vec<u8>) {
        set(&self.own_offer, offer);
    }

    /// Returns the offer of this side.
    pub(crate) fn own_offer(&self) -> watch::Receiver<Vec<u8>> {
        self.own_offer.subscribe()
    }

    /// Returns the addresses that the peer has offered.
    pub(crate) fn offered(&self) -> watch::Receiver<Vec<SocketAddr>> {
        self.offered.subscribe()
    }

    /// Sends what is queued and then the goodbye, within `limit`.
    pub(crate) async fn finish(&self, limit: Duration) {
        {
            let mut state = self.state.lock();
            state.multipath.close(0);
            state.wake_all();
        }
        let finished = self.ended.cancelled();
        if tokio::time::timeout(limit, finished).await.is_err() {
            tracing::warn!(
                "any: {} did not read the waiting messages within {limit:?}",
                self.peer
            );
        }
    }

    /// Ends the link at once.
    pub(crate) fn fail(&self, error: AnyError) {
        self.end(&mut self.state.lock(), error);
    }

    /// Waits until the link has ended.
    pub(crate) async fn ended(&self) {
        self.ended.cancelled().await;
    }

    pub(crate) fn has_ended(&self) -> bool {
        self.ended.is_cancelled()
    }

    /// Waits for a future, or for the end of the link.
    pub(crate) async fn unless_ended(&self, waiting: impl Future<Output = ()>) {
        tokio::select! {
            () = waiting => {}
            () = self.ended.cancelled() => {}
        }
    }

    /// Ends the link if its logic says so.
    fn end_if_due(&self, state: &mut State) {
        if let Some(end) = state.multipath.end() {
            let peer = self.peer.clone();
            self.end(state, AnyError::Ended { peer, end });
        }
    }

    fn end(&self, state: &mut State, error: AnyError) {
        if state.end.is_none() {
            tracing::info!("any: {error}");
            state.end = Some(Arc::new(error));
            self.ended.cancel();
        }
    }

    pub(crate) fn protocol(&self, what: &dyn std::fmt::Display) -> AnyError {
        AnyError::Protocol {
            peer: self.peer.clone(),
            what: what.to_string(),
        }
    }
}

/// Sets a value, and notifies those who watch it if it is another one.
fn set<T: PartialEq>(watched: &watch::Sender<T>, value: T) {
    watched.send_if_modified(|before| {
        let is_new = *before != value;
        *before = value;
        is_new
    });
}

impl State {
    fn check(&self) -> Result<(), AnyError> {
        match &self.end {
            Some(end) => Err(Arc::clone(end).into()),
            None => Ok(()),
        }
    }

    fn take(&mut self, lane: Lane, now: std::time::Instant) -> Option<Vec<u8>> {
        let before = self.multipath.wakeups();
        let batch = self.multipath.take(lane, now);
        if self.multipath.wakeups() != before {
            self.wake_all();
        }
        batch
    }

    /// Logs and reports the primary path if it has changed.
    fn report_switch(&mut self, peer: &str) {
        let primary = self.multipath.primary();
        if primary == self.reported {
            return;
        }
        self.reported = primary;
        match self.multipath.paths().find(|(_, path)| path.is_primary) {
            Some((_, path)) => tracing::info!("any: the load to {peer} is on {} now", path.medium),
            None => tracing::info!("any: no path to {peer} works now"),
        }
        observers::report();
    }

    fn wake(&self, id: PathId) {
        if let Some(task) = self.tasks.get(&id) {
            task.waker.notify_one();
        }
    }

    fn wake_all(&self) {
        for task in self.tasks.values() {
            task.waker.notify_one();
        }
    }
}

impl Drop for PathGuard {
    fn drop(&mut self) {
        let mut state = self.shared.state.lock();
        state.tasks.remove(&self.id);
        let now = Instant::now().into_std();
        state.multipath.remove_path(self.id, now);
        state.wake_all();
        state.report_switch(&self.shared.peer);
        drop(state);
        self.shared.room.notify_waiters();
        self.shared.paths_changed.notify_waiters();
    }
}

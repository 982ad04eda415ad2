//! Runs the two tasks of a link with lanes. One sends the SDUs of the lanes. The other reads the channel at all times, so that
//! the kernel loses nothing and signals arrive. Zenoh's writers and readers use only the lanes.
use std::{future::Future, sync::Arc, time::Duration};

use link_lanes::{
    goodbye::Goodbye,
    lanes::{
        ack_timer::ACK_TIMEOUT,
        receiver::Violation,
        report::Count,
        scheduler::{Bounds, Next, Sent},
        sdu::Protection,
        Change, Lane, Lanes, LANES,
    },
    usage::{keys::Side, UsageReport},
};
use parking_lot::Mutex;
use tokio::{sync::Notify, time::Instant};
use tokio_util::{sync::CancellationToken, task::AbortOnDropHandle};
use zenoh_link_ble_radio::{interval::ConnectionInterval, Channel, RadioError};

use crate::{
    error::{describe, BleError},
    handshake::drain_until_closed,
    link::{close_once::CloseOnce, interval_events::IntervalEvents, status::LanesStatus},
};

/// How long an SDU may wait for room in the controller before the link ends. Zenoh's own lease (10 s) ends a silent link
/// sooner; this limit is for a link whose radio works but accepts nothing.
pub(crate) const SEND_TIMEOUT: Duration = Duration::from_secs(20);
/// How long an SDU waits for room in the controller if the radio serves another connection instead: more than ten events of
/// the intervals that RECT uses.
const STARVED: Duration = Duration::from_millis(600);
/// How long the peer may take to read a goodbye after an error before the channel is closed.
const GOODBYE_TIMEOUT: Duration = Duration::from_millis(500);

/// The parameters of a link's lanes.
pub(crate) struct TrafficOptions {
    pub(crate) bounds: Bounds,
    /// The largest batch, in bytes.
    pub(crate) mtu: u16,
    /// Number of bytes that this side accepts unacknowledged.
    pub(crate) own_window: u16,
    /// Number of bytes that the peer accepts unacknowledged.
    pub(crate) peer_window: u16,
    pub(crate) protection: Protection,
    pub(crate) intervals: IntervalEvents,
}

/// The lanes of a link, with the notifications for the tasks that wait for them.
pub(crate) struct Traffic {
    channel: Arc<dyn Channel>,
    peer: String,
    mtu: usize,
    /// Number of bytes that an SDU has in addition to its batch.
    overhead: usize,
    state: Mutex<State>,
    to_send: Notify,
    room: Notify,
    arrived: [Notify; LANES],
    /// Notified when a batch arrives on another lane than the first, for readers of Zenoh's handshake.
    arrived_elsewhere: Notify,
    /// Notified when [`State::failure`] is set, for the receiving task.
    failed: Notify,
    close_once: Arc<CloseOnce>,
    intervals: IntervalEvents,
    /// Cancelled when the link has ended.
    ended: CancellationToken,
}

struct State {
    lanes: Lanes,
    /// Why this side is ending the link. The next SDU is the goodbye.
    failure: Option<Arc<BleError>>,
    /// Why the link has ended.
    end: Option<Arc<BleError>>,
}

impl State {
    fn check(&self) -> Result<(), BleError> {
        match &self.end {
            Some(end) => Err(Arc::clone(end).into()),
            None => Ok(()),
        }
    }
}

/// The tasks of a link, which end when this is dropped.
pub(crate) struct Tasks {
    _sending: AbortOnDropHandle<()>,
    _receiving: AbortOnDropHandle<()>,
}

impl Traffic {
    /// Starts the tasks of a link. Cancelling `replaced` ends the link in favour of a newer one.
    pub(crate) fn start(
        channel: Arc<dyn Channel>,
        peer: String,
        options: TrafficOptions,
        close_once: Arc<CloseOnce>,
        replaced: CancellationToken,
    ) -> (Arc<Self>, Tasks) {
        let TrafficOptions {
            bounds,
            mtu,
            own_window,
            peer_window,
            protection,
            intervals,
        } = options;
        let mtu = usize::from(mtu);
        let overhead = protection.overhead();
        let lanes = Lanes::new(bounds, mtu, own_window, peer_window, protection);
        let traffic = Arc::new(Self {
            channel,
            peer,
            mtu,
            overhead,
            close_once,
            intervals,
            state: Mutex::new(State {
                lanes,
                failure: None,
                end: None,
            }),
            to_send: Notify::new(),
            room: Notify::new(),
            arrived: Default::default(),
            arrived_elsewhere: Notify::new(),
            failed: Notify::new(),
            ended: CancellationToken::new(),
        });
        let (sender, receiver) = (Arc::clone(&traffic), Arc::clone(&traffic));
        let tasks = Tasks {
            _sending: AbortOnDropHandle::new(tokio::spawn(async move { sender.send().await })),
            _receiving: AbortOnDropHandle::new(tokio::spawn(async move {
                receiver.receive(replaced).await;
            })),
        };
        (traffic, tasks)
    }

    /// Queues a batch on its lane. Waits while there is no room.
    ///
    /// # Errors
    /// Fails if the batch is larger than the MTU, or if the link has ended.
    pub(crate) async fn write(&self, lane: Lane, batch: &[u8]) -> Result<(), BleError> {
        if batch.len() > self.mtu {
            return Err(BleError::BatchTooLarge {
                size: batch.len(),
                mtu: self.mtu,
            });
        }
        loop {
            let room = self.room.notified();
            let retry_at = {
                let (mut state, now) = (self.state.lock(), Instant::now().into_std());
                state.check()?;
                if state.lanes.push(lane, batch, now) {
                    break;
                }
                state.lanes.retry_at(lane, batch, now)
            };
            self.unless_ended(until_room(room, retry_at)).await;
        }
        self.to_send.notify_one();
        Ok(())
    }

    /// Returns the next batch of a lane. Waits until there is one.
    ///
    /// # Errors
    /// Fails if the link has ended and all batches that arrived before its end were read.
    pub(crate) async fn read(&self, lane: Lane) -> Result<Vec<u8>, BleError> {
        loop {
            {
                let mut state = self.state.lock();
                if let Some(batch) = state.lanes.take(lane) {
                    if state.lanes.has_signal() {
                        self.to_send.notify_one();
                    }
                    return Ok(batch);
                }
                state.check()?;
            }
            self.unless_ended(self.arrived[lane.index()].notified())
                .await;
        }
    }

    /// Returns the next batch of Zenoh's own handshake. Ends the link if the peer sends it on the wrong lane.
    ///
    /// # Errors
    /// Fails if the link has ended.
    pub(crate) async fn read_handshake(&self) -> Result<Vec<u8>, BleError> {
        let on_first = &self.arrived[Lane::first().index()];
        loop {
            let elsewhere = self.arrived_elsewhere.notified();
            let violation = {
                let mut state = self.state.lock();
                let taken = state.lanes.take_handshake_batch();
                if let Ok(Some(batch)) = taken {
                    if state.lanes.has_signal() {
                        self.to_send.notify_one();
                    }
                    return Ok(batch);
                }
                state.check()?;
                taken.err()
            };
            if let Some(violation) = violation {
                self.fail_for(violation);
            }
            let arrived = async {
                tokio::select! {
                    () = on_first.notified() => {}
                    () = elsewhere => {}
                }
            };
            self.unless_ended(arrived).await;
        }
    }

    /// Returns the next batch of any lane, the most urgent one first. Waits until there is one.
    ///
    /// # Errors
    /// Fails if the link has ended and all batches that arrived before its end were read.
    pub(crate) async fn read_any(&self) -> Result<Vec<u8>, BleError> {
        let on_first = &self.arrived[Lane::first().index()];
        loop {
            let elsewhere = self.arrived_elsewhere.notified();
            {
                let mut state = self.state.lock();
                let taken = Lane::all().find_map(|lane| state.lanes.take(lane));
                if let Some(batch) = taken {
                    if state.lanes.has_signal() {
                        self.to_send.notify_one();
                    }
                    return Ok(batch);
                }
                state.check()?;
            }
            let arrived = async {
                tokio::select! {
                    () = on_first.notified() => {}
                    () = elsewhere => {}
                }
            };
            self.unless_ended(arrived).await;
        }
    }

    /// Returns the number of batches that wait to be sent.
    pub(crate) fn waiting(&self) -> u64 {
        let (state, now) = (self.state.lock(), Instant::now().into_std());
        let reports = Lane::all().map(|lane| state.lanes.lane_report(lane, now).0);
        reports.map(|report| report.waiting.sdus).sum()
    }

    /// Waits until a batch is sent, or until the link has ended.
    pub(crate) async fn sent(&self) {
        self.unless_ended(self.room.notified()).await;
    }

    /// Waits for a future or for the end of the link, whichever is first. Any number of tasks may wait.
    async fn unless_ended(&self, waiting: impl Future<Output = ()>) {
        tokio::select! {
            () = waiting => {}
            () = self.ended.cancelled() => {}
        }
    }

    /// Returns an error if the link has ended.
    pub(crate) fn check(&self) -> Result<(), BleError> {
        self.state.lock().check()
    }

    /// Sends what is queued and then the goodbye, and waits until the peer has read it and closes the channel. All of
    /// this takes at most `limit`.
    pub(crate) async fn finish(&self, limit: Duration) {
        self.state.lock().lanes.close(Goodbye::Closing.code());
        self.to_send.notify_one();
        if tokio::time::timeout(limit, self.ended.cancelled())
            .await
            .is_err()
        {
            tracing::warn!(
                "ble: closing the link with {}: it did not read the waiting messages within {limit:?}",
                self.peer
            );
        }
        self.channel.shutdown();
    }

    /// Sends a connection interval to the peer: the one that this side has set, or one that it requests.
    pub(crate) fn send_interval(&self, interval: ConnectionInterval) {
        self.state.lock().lanes.send_interval(interval.units());
        self.to_send.notify_one();
    }

    /// Returns the state of the lanes, and the totals of what was sent and received.
    pub(crate) fn status(&self) -> (LanesStatus, Count, Count) {
        LanesStatus::of(&self.state.lock().lanes, Instant::now().into_std())
    }

    /// Keeps the keys that a batch of Zenoh's own messages declares.
    pub(crate) fn on_declarations(&self, from: Side, batch: &[u8]) {
        self.state.lock().lanes.keys().on_batch(from, batch);
    }

    /// Returns what was sent for each key, which is counted from the first question on until `keep` after the last one; and the
    /// rate of the path, once it was measured.
    pub(crate) fn usage(&self, keep: Duration) -> (UsageReport, Option<f64>) {
        let mut state = self.state.lock();
        let report = (state.lanes.usage()).ask(Instant::now().into_std(), keep);
        (report, state.lanes.path().rate_bytes_per_s())
    }

    /// Sends SDUs until the goodbye is sent or the link has ended.
    async fn send(&self) {
        loop {
            match self.send_next() {
                Ok(Some(Sent::Nothing)) => {
                    let more = self.to_send.notified();
                    self.until_ack_deadline(more).await;
                }
                Ok(Some(Sent::Sdu(Next::Batch(_)))) => {
                    // All lanes share one bound, so the writers of all lanes are notified.
                    self.room.notify_waiters();
                }
                Ok(Some(Sent::Sdu(Next::Signal))) => {}
                Ok(Some(Sent::Sdu(Next::Goodbye))) => return,
                Ok(Some(Sent::NoRoom)) => {
                    let since = Instant::now();
                    let room = tokio::time::timeout(SEND_TIMEOUT, self.channel.writable());
                    if let Some(Err(_)) = self.until_ack_deadline(room).await {
                        return self.end(send_timed_out());
                    }
                    if since.elapsed() >= STARVED {
                        self.intervals.on_starved();
                    }
                }
                Ok(None) => {
                    let error = BleError::Unacknowledged {
                        peer: self.peer.clone(),
                        limit: ACK_TIMEOUT,
                    };
                    self.fail(Goodbye::Unacknowledged, error);
                }
                Err(error) => return self.end(BleError::from(error)),
            }
        }
    }

    /// Waits for `event`. Returns `None` if the deadline for the peer's next acknowledgement passes before.
    async fn until_ack_deadline<T>(&self, event: impl Future<Output = T>) -> Option<T> {
        let deadline = self.state.lock().lanes.ack_deadline();
        match deadline {
            Some(deadline) => tokio::time::timeout_at(deadline.into(), event).await.ok(),
            None => Some(event.await),
        }
    }

    /// Tries to send the most urgent SDU. The SDU is selected again for each attempt, so that a queued batch can be
    /// overtaken until the channel accepts it. Returns `None` if the peer has acknowledged nothing for too long.
    fn send_next(&self) -> Result<Option<Sent>, RadioError> {
        let (mut state, now) = (self.state.lock(), Instant::now().into_std());
        let deadline = state.lanes.ack_deadline();
        if deadline.is_some_and(|deadline| now >= deadline) {
            return Ok(None);
        }
        let send = |sdu: &[u8]| self.channel.try_send(sdu);
        state.lanes.send(now, send).map(Some)
    }

    /// Receives SDUs until the link ends, and then ends it for all waiting tasks.
    async fn receive(&self, replaced: CancellationToken) {
        // One byte more than is allowed, so that a larger SDU is detected instead of being truncated.
        let mut sdu = vec![0; self.mtu + self.overhead + 1];
        let error: Arc<BleError> = loop {
            let received = tokio::select! {
                size = self.channel.recv(&mut sdu) => size,
                () = replaced.cancelled() => {
                    let peer = self.peer.clone();
                    self.fail(Goodbye::Replaced, BleError::Replaced { peer });
                    break self.failure().await;
                }
                error = self.failure() => break error,
            };
            let change = match received {
                Ok(size) => self.on_sdu(sdu.get_mut(..size).unwrap_or_default()),
                // The simulated radio reports an SDU that is too large; a kernel truncates it to the buffer, which is
                // one byte larger than allowed. Both end the link in the same way.
                Err(RadioError::SduTooLarge { size, .. }) => Err(self.too_large(size)),
                Err(error) => break BleError::from(error).into(),
            };
            match change {
                Ok(Change::Batch(lane)) => {
                    self.arrived[lane.index()].notify_one();
                    if lane != Lane::first() {
                        self.arrived_elsewhere.notify_waiters();
                    }
                }
                Ok(Change::Credits) => self.to_send.notify_one(),
                Ok(Change::Interval(units)) => {
                    if let Some(interval) = ConnectionInterval::from_units(units) {
                        self.intervals.on_message(interval);
                    }
                }
                Ok(Change::Goodbye(code)) => {
                    break self.closed_by_peer(Goodbye::from_code(code)).into()
                }
                Err(violation) => {
                    self.fail_for(violation);
                    break self.failure().await;
                }
            }
        };
        let failure = self.state.lock().failure.clone();
        if failure.is_some() {
            // The peer closes the channel when it has read the goodbye.
            let _ = tokio::time::timeout(GOODBYE_TIMEOUT, drain_until_closed(&self.channel)).await;
        }
        self.end(failure.unwrap_or(error));
    }

    /// Hands a received SDU to the lanes.
    fn on_sdu(&self, sdu: &mut [u8]) -> Result<Change, Violation> {
        let mut state = self.state.lock();
        let change = state.lanes.on_sdu(sdu, Instant::now().into_std())?;
        if state.lanes.has_signal() {
            self.to_send.notify_one();
        }
        Ok(change)
    }

    fn too_large(&self, sdu_bytes: usize) -> Violation {
        Violation::TooLarge {
            size: sdu_bytes.saturating_sub(self.overhead),
            mtu: self.mtu,
        }
    }

    /// Ends the link because of a violation by the peer.
    fn fail_for(&self, violation: Violation) {
        let error = BleError::Protocol {
            peer: self.channel.peer(),
            what: violation.to_string(),
        };
        self.fail(violation.goodbye(), error);
    }

    /// Ends the link because of a violation by the peer. Returns the reason when it has ended.
    pub(crate) async fn end_for(&self, violation: Violation) -> BleError {
        let what = violation.to_string();
        self.fail_for(violation);
        self.ended.cancelled().await;
        let peer = self.channel.peer();
        BleError::Protocol { peer, what }
    }

    /// Ends the link from this side: discards what is queued and sends `goodbye`. The receiving task does the rest. Only the
    /// first reason counts.
    fn fail(&self, goodbye: Goodbye, error: BleError) {
        let mut state = self.state.lock();
        if state.failure.is_none() {
            self.close_once.end_here();
            state.failure = Some(error.into());
            state.lanes.abort(goodbye.code());
            self.failed.notify_one();
            self.to_send.notify_one();
        }
    }

    /// Waits until this side ends the link, and returns the reason. The future may be dropped at any time.
    async fn failure(&self) -> Arc<BleError> {
        loop {
            let failed = self.failed.notified();
            if let Some(error) = &self.state.lock().failure {
                return Arc::clone(error);
            }
            failed.await;
        }
    }

    fn closed_by_peer(&self, goodbye: Goodbye) -> BleError {
        BleError::ClosedByPeer {
            peer: self.peer.clone(),
            reason: goodbye.reason(),
        }
    }

    /// Ends the link and notifies all waiting tasks.
    fn end(&self, error: impl Into<Arc<BleError>>) {
        let error = error.into();
        self.channel.shutdown();
        if matches!(*error, BleError::Radio(RadioError::ChannelDown { .. })) {
            self.intervals.on_lost();
        }
        self.close_once.close(&describe(&error));
        self.state.lock().end.get_or_insert(error);
        self.ended.cancel();
    }
}

/// Waits until something was sent, or until `retry_at`.
async fn until_room(room: impl Future<Output = ()>, retry_at: Option<std::time::Instant>) {
    match retry_at {
        Some(at) => drop(tokio::time::timeout_at(at.into(), room).await),
        None => room.await,
    }
}

/// Returns the error for an SDU that has waited for [`SEND_TIMEOUT`].
pub(crate) fn send_timed_out() -> BleError {
    BleError::Radio(RadioError::TimedOut {
        action: "sending to a peer that accepts nothing",
        limit: SEND_TIMEOUT,
    })
}

//! Owns the two tasks of a link: one sends what the lanes give out, the other empties the channel into them, always, so
//! that nothing is lost in the kernel and signals get through. Zenoh's writers and readers meet the lanes only.
use std::{future::Future, sync::Arc, time::Duration};

use parking_lot::Mutex;
use tokio::{sync::Notify, time::Instant};
use tokio_util::{sync::CancellationToken, task::AbortOnDropHandle};

use crate::{
    bye::Bye,
    ending::Ending,
    error::{in_words, BleError},
    lanes::{
        ack_timer::ACK_TIMEOUT,
        receiver::Violation,
        report::Count,
        scheduler::{Bounds, Next},
        sdu::SduError,
        Change, Lane, Lanes, HEADER, LANES,
    },
    opening::until_closed,
    radio::{Channel, RadioError},
    status::LanesStatus,
};

/// How long an SDU may wait for room in the controller until the link is given up. Zenoh's own lease (10 s) ends a silent
/// link sooner; this bounds one whose radio is alive but takes nothing.
pub(crate) const SEND_TIMEOUT: Duration = Duration::from_secs(20);
/// How long a goodbye after an error may take: the channel ends anyway.
const LAST_WORD: Duration = Duration::from_millis(500);

/// What a link's lanes are made with.
pub(crate) struct TrafficOptions {
    pub(crate) bounds: Bounds,
    /// The largest batch, in bytes.
    pub(crate) mtu: u16,
    /// What each side takes unacknowledged, in bytes.
    pub(crate) own_window: u16,
    pub(crate) peer_window: u16,
}

/// A link's lanes, and those who wait for them.
pub(crate) struct Traffic {
    channel: Arc<dyn Channel>,
    peer: String,
    mtu: usize,
    state: Mutex<State>,
    to_send: Notify,
    room: Notify,
    arrived: [Notify; LANES],
    /// Tells those who wait for Zenoh's handshake that something came on another lane.
    arrived_elsewhere: Notify,
    /// Tells the receiving task that [`State::failure`] is set.
    failed: Notify,
    ending: Arc<Ending>,
    /// Cancelled when the link has ended.
    over: CancellationToken,
}

struct State {
    lanes: Lanes,
    /// Why this side is ending the link. The goodbye is the next SDU.
    failure: Option<Arc<BleError>>,
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

/// What came of trying to send.
enum Sent {
    Sdu(Next),
    /// There is nothing that may be sent.
    Nothing,
    /// The channel takes nothing now.
    NoRoom,
    /// The peer has acknowledged nothing for too long.
    Unacknowledged,
}

/// Keeps the tasks of a link going; dropping it ends them.
pub(crate) struct Tasks {
    _sending: AbortOnDropHandle<()>,
    _receiving: AbortOnDropHandle<()>,
}

impl Traffic {
    /// Starts the tasks. `replaced` ends the link in favour of a newer one.
    pub(crate) fn start(
        channel: Arc<dyn Channel>,
        peer: String,
        options: TrafficOptions,
        ending: Arc<Ending>,
        replaced: CancellationToken,
    ) -> (Arc<Self>, Tasks) {
        let TrafficOptions {
            bounds,
            mtu,
            own_window,
            peer_window,
        } = options;
        let mtu = usize::from(mtu);
        let lanes = Lanes::new(bounds, mtu, own_window, peer_window);
        let traffic = Arc::new(Self {
            channel,
            peer,
            mtu,
            ending,
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
            over: CancellationToken::new(),
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

    /// Puts a batch on its lane; waits for room.
    pub(crate) async fn write(&self, lane: Lane, batch: &[u8]) -> Result<(), BleError> {
        if batch.len() > self.mtu {
            return Err(BleError::BatchTooLarge {
                size: batch.len(),
                mtu: self.mtu,
            });
        }
        loop {
            let room = self.room.notified();
            let ask_again_at = {
                let (mut state, now) = (self.state.lock(), Instant::now().into_std());
                state.check()?;
                if state.lanes.push(lane, batch, now) {
                    break;
                }
                state.lanes.ask_again_at(lane, batch, now)
            };
            self.unless_over(until_room(room, ask_again_at)).await;
        }
        self.to_send.notify_one();
        Ok(())
    }

    /// The next batch of a lane; what came before the end of the link is still given out.
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
            self.unless_over(self.arrived[lane.index()].notified())
                .await;
        }
    }

    /// Returns the next batch of Zenoh's own handshake; ends the link if the peer sends it on the wrong lane.
    pub(crate) async fn read_handshake(&self) -> Result<Vec<u8>, BleError> {
        let on_first = &self.arrived[Lane::first().index()];
        loop {
            let elsewhere = self.arrived_elsewhere.notified();
            let violation = {
                let mut state = self.state.lock();
                let taken = state.lanes.take_of_handshake();
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
            self.unless_over(arrived).await;
        }
    }

    /// Waits, but not beyond the end of the link, however many wait.
    async fn unless_over(&self, waiting: impl Future<Output = ()>) {
        tokio::select! {
            () = waiting => {}
            () = self.over.cancelled() => {}
        }
    }

    /// Whether it still carries batches.
    pub(crate) fn check(&self) -> Result<(), BleError> {
        self.state.lock().check()
    }

    /// Waits until the link has ended.
    pub(crate) async fn ended(&self) {
        self.over.cancelled().await;
    }

    /// Sends what waits and then the goodbye, and waits until the peer, having read it all, closes the channel.
    pub(crate) async fn finish(&self, limit: Duration) {
        self.state.lock().lanes.close(Bye::Closing.code());
        self.to_send.notify_one();
        if tokio::time::timeout(limit, self.over.cancelled())
            .await
            .is_err()
        {
            tracing::warn!(
                "ble: {} did not take what waited for it within {limit:?}",
                self.peer
            );
        }
        self.channel.shutdown();
    }

    /// What can be told of the lanes, and what was sent and received altogether.
    pub(crate) fn status(&self) -> (LanesStatus, Count, Count) {
        LanesStatus::of(&self.state.lock().lanes, Instant::now().into_std())
    }

    async fn send(&self) {
        loop {
            match self.send_next() {
                Ok(Sent::Nothing) => {
                    let more = self.to_send.notified();
                    self.until_ack_deadline(more).await;
                }
                Ok(Sent::Sdu(Next::Batch(_))) => {
                    // Whatever the lane: the bound is one for all of them.
                    self.room.notify_waiters();
                }
                Ok(Sent::Sdu(Next::Signal)) => {}
                Ok(Sent::Sdu(Next::Bye)) => return,
                Ok(Sent::NoRoom) => {
                    let room = tokio::time::timeout(SEND_TIMEOUT, self.channel.has_room());
                    if let Some(Err(_)) = self.until_ack_deadline(room).await {
                        return self.end(takes_nothing());
                    }
                }
                Ok(Sent::Unacknowledged) => {
                    let error = BleError::Unacknowledged {
                        peer: self.peer.clone(),
                        limit: ACK_TIMEOUT,
                    };
                    self.fail(Bye::Unacknowledged, error);
                }
                Err(error) => return self.end(BleError::from(error)),
            }
        }
    }

    /// Waits for `event`, but at most until the peer must have acknowledged something: `None` then.
    async fn until_ack_deadline<T>(&self, event: impl Future<Output = T>) -> Option<T> {
        let deadline = self.state.lock().lanes.ack_deadline();
        match deadline {
            Some(deadline) => tokio::time::timeout_at(deadline.into(), event).await.ok(),
            None => Some(event.await),
        }
    }

    /// Chosen only now that the channel takes it: what waits outside may still be overtaken.
    fn send_next(&self) -> Result<Sent, RadioError> {
        let mut state = self.state.lock();
        let deadline = state.lanes.ack_deadline();
        if deadline.is_some_and(|deadline| Instant::now().into_std() >= deadline) {
            return Ok(Sent::Unacknowledged);
        }
        let Some((next, sdu)) = state.lanes.peek() else {
            return Ok(Sent::Nothing);
        };
        if !self.channel.try_send(sdu)? {
            return Ok(Sent::NoRoom);
        }
        state.lanes.on_sent(next, Instant::now().into_std());
        Ok(Sent::Sdu(next))
    }

    async fn receive(&self, replaced: CancellationToken) {
        // One byte more than is allowed, so that a larger SDU shows instead of being cut.
        let mut sdu = vec![0; self.mtu + HEADER + 1];
        let error: Arc<BleError> = loop {
            let received = tokio::select! {
                size = self.channel.recv(&mut sdu) => size,
                () = replaced.cancelled() => {
                    let peer = self.peer.clone();
                    self.fail(Bye::Replaced, BleError::Replaced { peer });
                    break self.failure().await;
                }
                error = self.failure() => break error,
            };
            let change = match received {
                Ok(size) => self.on_sdu(sdu.get(..size).unwrap_or_default()),
                // A kernel cuts it instead, so that one byte too many arrives: the same to the peer.
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
                Ok(Change::Bye(code)) => break self.closed_by_peer(Bye::from_code(code)).into(),
                Err(violation) => {
                    self.fail_for(violation);
                    break self.failure().await;
                }
            }
        };
        let failure = self.state.lock().failure.clone();
        if failure.is_some() {
            // The peer closes when it has read the goodbye.
            let _ = tokio::time::timeout(LAST_WORD, until_closed(&self.channel)).await;
        }
        self.end(failure.unwrap_or(error));
    }

    fn on_sdu(&self, sdu: &[u8]) -> Result<Change, Violation> {
        let mut state = self.state.lock();
        let change = state.lanes.on_sdu(sdu, Instant::now().into_std())?;
        if state.lanes.has_signal() {
            self.to_send.notify_one();
        }
        Ok(change)
    }

    fn too_large(&self, sdu_bytes: usize) -> Violation {
        Violation::TooLarge {
            size: sdu_bytes.saturating_sub(HEADER),
            mtu: self.mtu,
        }
    }

    /// Ends the link because of what the peer sent.
    fn fail_for(&self, violation: Violation) {
        let bye = match violation {
            Violation::Sdu(SduError::Fault(_)) => Bye::Unverified,
            _ => Bye::ProtocolError,
        };
        let error = BleError::Protocol {
            peer: self.channel.peer(),
            what: violation.to_string(),
        };
        self.fail(bye, error);
    }

    /// Ends the link from this side: discards what waits, sends `bye` and leaves the rest to the receiving task. The first
    /// reason counts.
    fn fail(&self, bye: Bye, error: BleError) {
        let mut state = self.state.lock();
        if state.failure.is_none() {
            state.failure = Some(error.into());
            state.lanes.abort(bye.code());
            self.failed.notify_one();
            self.to_send.notify_one();
        }
    }

    /// Waits until this side ends the link, and returns why. It may be dropped at any time.
    async fn failure(&self) -> Arc<BleError> {
        loop {
            let failed = self.failed.notified();
            if let Some(error) = &self.state.lock().failure {
                return Arc::clone(error);
            }
            failed.await;
        }
    }

    fn closed_by_peer(&self, bye: Bye) -> BleError {
        BleError::ClosedByPeer {
            peer: self.peer.clone(),
            reason: bye.reason(),
        }
    }

    /// The link is over: all who wait are told.
    fn end(&self, error: impl Into<Arc<BleError>>) {
        let error = error.into();
        self.channel.shutdown();
        self.ending.happens(&in_words(&error));
        self.state.lock().end.get_or_insert(error);
        self.over.cancel();
    }
}

/// Waits until something went out, or until then if nothing does.
async fn until_room(room: impl Future<Output = ()>, ask_again_at: Option<std::time::Instant>) {
    match ask_again_at {
        Some(at) => drop(tokio::time::timeout_at(at.into(), room).await),
        None => room.await,
    }
}

/// It has waited for [`SEND_TIMEOUT`].
pub(crate) fn takes_nothing() -> BleError {
    BleError::Radio(RadioError::TimedOut {
        action: "sending to a peer that takes nothing",
        limit: SEND_TIMEOUT,
    })
}

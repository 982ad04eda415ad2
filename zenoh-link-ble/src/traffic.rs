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

/// How long an SDU may wait for room in the controller, or for the peer to acknowledge any before it, until the link is
/// given up. Zenoh's own lease (10 s) ends a silent link sooner; this bounds one whose radio is alive but takes nothing.
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
    ending: Arc<Ending>,
    /// Cancelled when the link has ended.
    over: CancellationToken,
}

struct State {
    lanes: Lanes,
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
    /// What waits needs an acknowledgement first, of some of so many bytes.
    NoCredits(u16),
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
            state: Mutex::new(State { lanes, end: None }),
            to_send: Notify::new(),
            room: Notify::new(),
            arrived: Default::default(),
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
            {
                let mut state = self.state.lock();
                state.check()?;
                if state.lanes.push(lane, batch, Instant::now().into_std()) {
                    break;
                }
            }
            self.unless_over(room).await;
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
        // Since when that much is not acknowledged, and holds up the rest.
        let mut held_up = None;
        loop {
            match self.send_next() {
                Ok(Sent::Nothing) => {
                    held_up = None;
                    self.to_send.notified().await;
                }
                Ok(Sent::Sdu(Next::Batch(_))) => {
                    held_up = None;
                    // Whatever the lane: the bound is one for all of them.
                    self.room.notify_waiters();
                }
                Ok(Sent::Sdu(Next::Signal)) => {}
                Ok(Sent::Sdu(Next::Bye)) => return,
                Ok(Sent::NoRoom) => {
                    let room = self.channel.has_room();
                    if tokio::time::timeout(SEND_TIMEOUT, room).await.is_err() {
                        return self.end(takes_nothing());
                    }
                }
                Ok(Sent::NoCredits(bytes)) => {
                    let same = held_up.filter(|(before, _)| *before == bytes);
                    let (_, since) = *held_up.insert(same.unwrap_or((bytes, Instant::now())));
                    let left = SEND_TIMEOUT.saturating_sub(since.elapsed());
                    let more = self.to_send.notified();
                    if left.is_zero() || tokio::time::timeout(left, more).await.is_err() {
                        return self.end(takes_nothing());
                    }
                }
                Err(error) => return self.end(error.into()),
            }
        }
    }

    /// Chosen only now that the channel takes it: what waits outside may still be overtaken.
    fn send_next(&self) -> Result<Sent, RadioError> {
        let mut state = self.state.lock();
        let Some((next, sdu)) = state.lanes.peek() else {
            let held_up = state.lanes.waits_for_credits();
            return Ok(held_up.map_or(Sent::Nothing, Sent::NoCredits));
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
        let error = loop {
            let received = tokio::select! {
                size = self.channel.recv(&mut sdu) => size,
                () = replaced.cancelled() => break self.closed_by_peer(Bye::Replaced),
            };
            let change = match received {
                Ok(size) => self.on_sdu(sdu.get(..size).unwrap_or_default()),
                // A kernel cuts it instead, so that one byte too many arrives: the same to the peer.
                Err(RadioError::SduTooLarge { size, .. }) => Err(self.too_large(size)),
                Err(error) => break error.into(),
            };
            match change {
                Ok(Change::Batch(lane)) => self.arrived[lane.index()].notify_one(),
                Ok(Change::Credits) => self.to_send.notify_one(),
                Ok(Change::Bye(code)) => break self.closed_by_peer(Bye::from_code(code)),
                Err(violation) => {
                    self.last_word(violation).await;
                    break BleError::Protocol {
                        peer: self.channel.peer(),
                        what: violation.to_string(),
                    };
                }
            }
        };
        self.end(error);
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

    /// Tells the peer why, as long as it listens.
    async fn last_word(&self, violation: Violation) {
        let bye = match violation {
            Violation::Sdu(SduError::Fault(_)) => Bye::Unverified,
            _ => Bye::ProtocolError,
        };
        self.state.lock().lanes.abort(bye.code());
        self.to_send.notify_one();
        // The peer closes when it has read the goodbye.
        let _ = tokio::time::timeout(LAST_WORD, until_closed(&self.channel)).await;
    }

    fn closed_by_peer(&self, bye: Bye) -> BleError {
        BleError::ClosedByPeer {
            peer: self.peer.clone(),
            reason: bye.reason(),
        }
    }

    /// The link is over: all who wait are told.
    fn end(&self, error: BleError) {
        self.channel.shutdown();
        self.ending.happens(&in_words(&error));
        self.state.lock().end.get_or_insert(Arc::new(error));
        self.over.cancel();
    }
}

/// It has waited for [`SEND_TIMEOUT`].
pub(crate) fn takes_nothing() -> BleError {
    BleError::Radio(RadioError::TimedOut {
        action: "sending to a peer that takes nothing",
        limit: SEND_TIMEOUT,
    })
}

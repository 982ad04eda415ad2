//! Lets a link succeed another one with the same peer only after Zenoh has released the session of its predecessor, on both
//! sides; and ends a link that has become silent before Zenoh gives it up.
//!
//! Zenoh adds a new link to the session that it has with a peer, even if that session is about to be closed, and even if the
//! peer has released its own. One side then uses a session with keys and routes that the other one does not know: the link stays
//! up and carries nothing. It also closes a session once more whenever a program's message could not be queued in time, and by
//! the peer's identifier: a successor that exists by then loses its routes. Therefore every link holds back Zenoh's own handshake
//! (`link`). The accepting side does not answer, and the dialling side does not go on, before this side has released its
//! session with the peer and has computed its routes since. As the handshake needs both, the new session begins only after both
//! sides have released the old one. `ledger` decides, and is given the time.
//!
//! A message that waits for a link occupies one of Zenoh's threads, and Zenoh waits for that message while it closes the link
//! itself, for as long as `wait_before_close`. A link that fails releases both at once, if all tasks that write to it fail before
//! Zenoh cancels them. Therefore a link fails shortly before Zenoh's lease ends, the tasks that write learn of each end before
//! those that read, and Zenoh removes a link only when none writes any more ([`wait_for_writers`]).
//!
//! Nothing of this applies until [`enable`] is called; without that call, this crate behaves like the published one. A router
//! reports its sessions with [`Session`]. Without these reports, a session counts as released when its links are.

mod handshake;
mod ledger;
mod link;
mod manager;
#[cfg(test)]
mod simulation;

use std::{
    collections::HashMap,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, LazyLock,
    },
    time::Duration,
};

use flume::WeakSender;
use parking_lot::Mutex;
use tokio::{sync::Notify, time::Instant};
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkManagerUnicast, LinkUnicast, NewLinkChannelSender};
use zenoh_protocol::core::{Locator, WhatAmI, ZenohIdProto};
use zenoh_runtime::ZRuntime;

use self::{
    ledger::{HoldId, LastReceived, Ledger, Step},
    link::{SucceedingLink, Writers},
    manager::SucceedingManager,
};

/// How long a link waits for its predecessor. Then it fails, and is dialled again.
const MAX_WAIT: Duration = Duration::from_millis(2500);
/// How long the tasks that write to a link may take to notice that it has ended.
const WRITERS_FAIL: Duration = Duration::from_millis(500);
/// The longest time between two looks at a predecessor that may become silent.
const POLL: Duration = Duration::from_millis(100);

static IS_ENABLED: AtomicBool = AtomicBool::new(cfg!(feature = "ble"));
static STATE: LazyLock<Mutex<State>> = LazyLock::new(Mutex::default);
/// Notified whenever a link has ended, or Zenoh has released or closed something.
static CHANGED: Notify = Notify::const_new();

#[derive(Default)]
struct State {
    ledger: Ledger,
    ends: HashMap<HoldId, LinkEnd>,
    channels: Vec<Channel>,
}

/// A link that has completed its handshake, and can be ended.
struct LinkEnd {
    src: Locator,
    dst: Locator,
    writers: Arc<Writers>,
    /// Cancelled to end the link.
    ended: CancellationToken,
}

/// The channel through which a runtime of Zenoh receives accepted links, and the one that leads there through this module.
struct Channel {
    of_zenoh: WeakSender<LinkUnicast>,
    ours: WeakSender<LinkUnicast>,
}

/// Makes the links of managers that are created from now on succeed each other as described above. Must be called before Zenoh
/// is opened.
pub fn enable() {
    IS_ENABLED.store(true, Ordering::Relaxed);
}

/// Returns the channel to which a link manager sends accepted links. There is one for each runtime of Zenoh.
pub(crate) fn accepting(new_links: NewLinkChannelSender) -> NewLinkChannelSender {
    if !IS_ENABLED.load(Ordering::Relaxed) {
        return new_links;
    }
    let channels = &mut STATE.lock().channels;
    channels.retain(|channel| channel.ours.upgrade().is_some());
    for channel in channels.iter() {
        let (Some(of_zenoh), Some(ours)) = (channel.of_zenoh.upgrade(), channel.ours.upgrade())
        else {
            continue;
        };
        if of_zenoh.same_channel(&new_links) || ours.same_channel(&new_links) {
            return ours;
        }
    }
    let (ours, accepted) = flume::unbounded();
    channels.push(Channel {
        of_zenoh: new_links.downgrade(),
        ours: ours.downgrade(),
    });
    ZRuntime::Acceptor.spawn(async move {
        // Ends with the link managers, which hold the other end.
        while let Ok(link) = accepted.recv_async().await {
            if new_links
                .send_async(SucceedingLink::wrap(link))
                .await
                .is_err()
            {
                return;
            }
        }
    });
    ours
}

/// Returns a manager whose dialled links succeed each other.
pub(crate) fn dialling(manager: LinkManagerUnicast) -> LinkManagerUnicast {
    match IS_ENABLED.load(Ordering::Relaxed) {
        true => Arc::new(SucceedingManager(manager)),
        false => manager,
    }
}

/// A node of Zenoh, as it announces itself in the handshake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ZenohNode {
    /// Its identifier.
    pub zid: ZenohIdProto,
    /// Its mode.
    pub whatami: WhatAmI,
}

/// A node of this process and its peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ZenohPair {
    /// The node of this process.
    pub own: ZenohNode,
    /// The peer.
    pub peer: ZenohNode,
}

/// A session that Zenoh has opened. Zenoh has released it when this is dropped.
#[derive(Debug)]
pub struct Session(HoldId);

impl Session {
    /// Records that Zenoh has opened a session between the two.
    pub fn opened(pair: ZenohPair) -> Self {
        Self(STATE.lock().ledger.on_session(pair))
    }

    /// Records that Zenoh has closed the session. If it does so while there is a successor, the successor has lost its routes:
    /// it ends, and is dialled again.
    pub fn on_closed(&self) {
        let mut state = STATE.lock();
        let now = Instant::now().into_std();
        let damaged = state.ledger.on_session_closed(self.0, now);
        if !damaged.is_empty() {
            tracing::warn!(
                "Zenoh has closed a session a second time, and with it the routes of its successor, which is opened again"
            );
        }
        state.end(&damaged);
        drop(state);
        CHANGED.notify_waiters();
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        release(self.0);
    }
}

/// A link whose handshake is complete. Zenoh has released it when this is dropped.
struct Hold(HoldId);

impl Hold {
    /// Records that a link has completed its handshake. `lease` is that of the peer.
    fn new(pair: ZenohPair, received: Arc<LastReceived>, lease: Duration, end: LinkEnd) -> Self {
        let mut state = STATE.lock();
        let id = state.ledger.on_link(pair, received, lease);
        state.ends.insert(id, end);
        Self(id)
    }

    /// Records that the link has ended.
    fn on_ended(&self) {
        STATE.lock().end(&[self.0]);
        CHANGED.notify_waiters();
    }
}

impl Drop for Hold {
    fn drop(&mut self) {
        release(self.0);
    }
}

fn release(id: HoldId) {
    let now = Instant::now().into_std();
    let mut state = STATE.lock();
    state.ends.remove(&id);
    state.ledger.on_released(id, now);
    drop(state);
    CHANGED.notify_waiters();
}

impl State {
    fn end(&mut self, links: &[HoldId]) {
        for id in links {
            self.ledger.on_link_ended(*id);
            if let Some(end) = self.ends.get(id) {
                end.ended.cancel();
            }
        }
    }
}

/// Blocks while tasks of Zenoh write to a link that has ended, for [`WRITERS_FAIL`] at most. Zenoh is about to cancel these tasks. One
/// that is cancelled rather than fails waits for the program's message that waits for it, and so nothing of the session is released.
pub fn wait_for_writers(src: &Locator, dst: &Locator) {
    let writers = {
        let state = STATE.lock();
        let mut ends = state.ends.values();
        let end = ends.find(|end| end.src == *src && end.dst == *dst);
        end.map(|end| Arc::clone(&end.writers))
    };
    if let Some(writers) = writers {
        writers.wait_until_none(std::time::Instant::now() + WRITERS_FAIL);
    }
}

/// Waits until a new link between the two may go on.
///
/// # Errors
/// Fails if Zenoh has not released the predecessor within [`MAX_WAIT`].
async fn wait_for_predecessor(pair: ZenohPair) -> Result<(), PredecessorHangs> {
    let since = Instant::now();
    loop {
        let changed = CHANGED.notified();
        let now = Instant::now();
        let step = {
            let mut state = STATE.lock();
            let step = state.ledger.step(pair, since.into_std(), now.into_std());
            if let Step::End(links) = &step {
                tracing::debug!(
                    "{} has opened a new link: the silent one ends",
                    pair.peer.zid
                );
                state.end(links);
            }
            step
        };
        let until = match step {
            Step::Proceed => return Ok(()),
            Step::End(_) => continue,
            Step::Wait(until) => until.map(Instant::from_std),
        };
        if now >= since + MAX_WAIT {
            return Err(PredecessorHangs(pair.peer.zid));
        }
        let until = until.map_or(now + POLL, |until| until.min(now + POLL));
        let _ = tokio::time::timeout_at(until, changed).await;
    }
}

/// Zenoh does not release the session that a new link succeeds.
#[derive(Debug, thiserror::Error)]
#[error(
    "the earlier session with {0} has not ended within {MAX_WAIT:?}; the link is dialled again"
)]
struct PredecessorHangs(ZenohIdProto);

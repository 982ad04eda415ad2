//! Limits the links that this process accepts, before Zenoh sees them.
//!
//! Zenoh has one number for unfinished handshakes (`accept_pending`) and one for sessions (`max_sessions`), for all
//! links and peers together. One peer can take all of either, and every other peer is then refused. Links that are
//! accepted here pass a gate first: a full set of handshakes evicts the oldest one of the source that has the most, and
//! sessions are limited in total and for each source. Links of `ble` and `slot` do not pass the gate, so what the gate
//! does not give away stays free for them.
//!
//! No limit applies until [`set_limits`] was called: without that call this crate behaves as the published one.
//! `places` decides, `link` is an accepted link that holds a place, and this file connects both to Zenoh's channel.

mod link;
mod places;

use std::{
    collections::HashMap,
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::{Mutex, RwLock};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkUnicast, NewLinkChannelSender};
use zenoh_runtime::ZRuntime;

pub use self::places::{Limits, Refusal, Source};
use self::{
    link::AdmittedLink,
    places::{Admitted, PlaceId, Places},
};

/// How often refusals are logged at most; a flood must not fill the log.
const LOG_PERIOD: Duration = Duration::from_secs(10);
/// How long a refused link may take to close. Some links say goodbye to their peer, which may not read.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// The gate of this process.
static GATE: RwLock<Option<Arc<Gate>>> = RwLock::new(None);

/// Applies these limits to every link, except those of `ble`, that is accepted by a link manager made from now on. Call it
/// before Zenoh is opened.
pub fn set_limits(limits: Limits) {
    *GATE.write() = Some(Arc::new(Gate::new(limits)));
}

/// Returns a channel for a link manager to put accepted links into. Those that are admitted go on to `new_links`.
pub(crate) fn gated(new_links: NewLinkChannelSender) -> NewLinkChannelSender {
    let Some(gate) = GATE.read().clone() else {
        return new_links;
    };
    let (accepted, incoming) = flume::unbounded();
    ZRuntime::Acceptor.spawn(async move {
        // Ends with the link manager, which holds the other end.
        while let Ok(link) = incoming.recv_async().await {
            let Some(link) = gate.admit(link).await else {
                continue;
            };
            if new_links.send_async(link).await.is_err() {
                return;
            }
        }
    });
    accepted
}

/// The places, and what has to happen when one is given away or taken back.
struct Gate {
    limits: Limits,
    state: Mutex<State>,
    /// Tells that a link is gone.
    released: Notify,
}

struct State {
    places: Places,
    log: RefusalLog,
    /// Ends the handshake of each link that has not finished it.
    handshakes: HashMap<PlaceId, CancellationToken>,
}

impl Gate {
    fn new(limits: Limits) -> Self {
        Self {
            limits,
            state: Mutex::new(State {
                places: Places::new(limits),
                log: RefusalLog::default(),
                handshakes: HashMap::new(),
            }),
            released: Notify::new(),
        }
    }

    /// Gives the link a place, or closes it.
    async fn admit(self: &Arc<Self>, link: LinkUnicast) -> Option<LinkUnicast> {
        let source = Source::of(link.get_dst());
        let deadline = Instant::now() + CLOSE_TIMEOUT;
        let refusal = loop {
            match self.place(&source) {
                Ok((place, handshake)) => {
                    let timeout = self.limits.handshake_timeout;
                    return Some(AdmittedLink::wrap(link, place, handshake, timeout));
                }
                // Links that were evicted are about to close.
                Err(Refusal::Busy) if Instant::now() < deadline => {
                    let released = self.released.notified();
                    let _ = tokio::time::timeout_at(deadline.into(), released).await;
                }
                Err(refusal) => break refusal,
            }
        };
        let mut state = self.state.lock();
        state.log.refused(Instant::now(), &source, refusal);
        drop(state);
        tokio::spawn(tokio::time::timeout(CLOSE_TIMEOUT, async move {
            let _ = link.close().await;
        }));
        None
    }

    /// Takes a place, and evicts another handshake if necessary.
    fn place(self: &Arc<Self>, source: &Source) -> Result<(Place, CancellationToken), Refusal> {
        let mut state = self.state.lock();
        let Admitted { id, evicted } = state.places.admit(source)?;
        if let Some(evicted) = evicted {
            let handshake = state.handshakes.remove(&evicted.id);
            handshake.inspect(CancellationToken::cancel);
            let (now, refusal) = (Instant::now(), Refusal::Handshakes);
            state.log.refused(now, &evicted.source, refusal);
        }
        let handshake = CancellationToken::new();
        state.handshakes.insert(id, handshake.clone());
        let place = Place {
            gate: Arc::clone(self),
            source: source.clone(),
            id,
        };
        Ok((place, handshake))
    }
}

/// A link's place; dropping it gives it back.
struct Place {
    gate: Arc<Gate>,
    source: Source,
    id: PlaceId,
}

impl Place {
    /// Counts the link as a session from now on, or tells why that is one too many.
    fn establish(&self) -> Result<(), Refusal> {
        let mut state = self.gate.state.lock();
        state.handshakes.remove(&self.id);
        let established = state.places.establish(self.id);
        established.inspect_err(|refusal| {
            let now = Instant::now();
            state.log.refused(now, &self.source, *refusal);
        })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut state = self.gate.state.lock();
        state.handshakes.remove(&self.id);
        state.places.release(self.id);
        drop(state);
        self.gate.released.notify_one();
    }
}

/// The refusals since the last line in the log.
#[derive(Default)]
struct RefusalLog {
    last: Option<Instant>,
    unlogged: u64,
}

impl RefusalLog {
    fn refused(&mut self, now: Instant, source: &Source, refusal: Refusal) {
        self.unlogged += 1;
        if self.last.is_some_and(|last| now - last < LOG_PERIOD) {
            return;
        }
        let more = match self.unlogged - 1 {
            0 => String::new(),
            more => format!(" ({more} more since the last such message)"),
        };
        tracing::warn!("refused a connection from {source}: {refusal}{more}");
        (self.last, self.unlogged) = (Some(now), 0);
    }
}

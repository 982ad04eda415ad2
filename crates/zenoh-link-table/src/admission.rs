//! Limits the links that this process accepts, before Zenoh sees them.
//!
//! Zenoh has one limit for unfinished handshakes (`accept_pending`) and one for sessions (`max_sessions`), which all
//! links and peers share. One peer can use up either limit, and every other peer is then refused. Links accepted here
//! first pass a gate: if the limit of handshakes is reached, the gate evicts the oldest handshake of the source that
//! has the most, and it limits sessions in total and per source. Registered links pass the gate only if their registration
//! says so; the sessions that the gate keeps free remain available to the others. A session that declares more than its share waits.
//!
//! No limit applies until [`set_limits`] is called; without that call, this crate behaves like the published one.
//! `permits` and `declarations` decide, `link` is an accepted link that holds a permit, and this file connects them to Zenoh's channel.

mod declarations;
mod link;
mod permits;

use std::{
    collections::HashMap,
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::{Mutex, RwLock};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkUnicast, NewLinkChannelSender};
use zenoh_protocol::core::Locator;
use zenoh_runtime::ZRuntime;

pub use self::{
    declarations::PER_S as DECLARATIONS_PER_S,
    permits::{Limits, Refusal, Source},
};
use self::{
    link::AdmittedLink,
    permits::{Admitted, PermitId, Permits},
};

/// Minimum time between two log messages about refusals, or about declarations, so that a flood does not fill the log.
const LOG_PERIOD: Duration = Duration::from_secs(10);
/// Maximum time for a refused link to close. Some links send a goodbye to their peer, which may not read it.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(1);

/// The gate of this process.
static GATE: RwLock<Option<Arc<Gate>>> = RwLock::new(None);

/// Applies these limits to every link that is accepted by a link manager created from now on, except those of registered links
/// that are not gated. Must be called before Zenoh is opened.
pub fn set_limits(limits: Limits) {
    *GATE.write() = Some(Arc::new(Gate::new(limits)));
}

/// Returns how many declarations had to wait so far, because their program made too many.
pub fn delayed_declarations() -> u64 {
    let gate = GATE.read().clone();
    gate.map_or(0, |gate| gate.state.lock().waited)
}

/// Returns a channel to which a link manager sends accepted links. Admitted links are forwarded to `new_links`. If no
/// limits are set, `new_links` itself is returned.
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

/// The permits, and the actions when one is granted or released.
struct Gate {
    limits: Limits,
    state: Mutex<State>,
    /// Notified when a permit is released.
    released: Notify,
}

struct State {
    permits: Permits,
    refusals: LogLimit,
    declarations: LogLimit,
    /// Number of declarations that had to wait.
    waited: u64,
    /// Tokens that cancel the handshakes that are not complete.
    handshakes: HashMap<PermitId, CancellationToken>,
}

impl Gate {
    fn new(limits: Limits) -> Self {
        Self {
            limits,
            state: Mutex::new(State {
                permits: Permits::new(limits),
                refusals: LogLimit::default(),
                declarations: LogLimit::default(),
                waited: 0,
                handshakes: HashMap::new(),
            }),
            released: Notify::new(),
        }
    }

    /// Grants the link a permit, or closes the link.
    async fn admit(self: &Arc<Self>, link: LinkUnicast) -> Option<LinkUnicast> {
        let source = Source::of(link.get_dst());
        let deadline = Instant::now() + CLOSE_TIMEOUT;
        let refusal = loop {
            match self.take_permit(&source) {
                Ok((permit, handshake)) => {
                    let timeout = self.limits.handshake_timeout;
                    return Some(AdmittedLink::wrap(link, permit, handshake, timeout));
                }
                // Evicted links are about to close.
                Err(Refusal::Busy) if Instant::now() < deadline => {
                    let released = self.released.notified();
                    let _ = tokio::time::timeout_at(deadline.into(), released).await;
                }
                Err(refusal) => break refusal,
            }
        };
        let mut state = self.state.lock();
        state.log_refusal(Instant::now(), &source, refusal);
        drop(state);
        tokio::spawn(tokio::time::timeout(CLOSE_TIMEOUT, async move {
            let _ = link.close().await;
        }));
        None
    }

    /// Takes a permit, and evicts another handshake if necessary.
    fn take_permit(
        self: &Arc<Self>,
        source: &Source,
    ) -> Result<(Permit, CancellationToken), Refusal> {
        let mut state = self.state.lock();
        let Admitted { id, evicted } = state.permits.admit(source)?;
        if let Some(evicted) = evicted {
            let handshake = state.handshakes.remove(&evicted.id);
            handshake.inspect(CancellationToken::cancel);
            let (now, refusal) = (Instant::now(), Refusal::Handshakes);
            state.log_refusal(now, &evicted.source, refusal);
        }
        let handshake = CancellationToken::new();
        state.handshakes.insert(id, handshake.clone());
        let permit = Permit {
            gate: Arc::clone(self),
            source: source.clone(),
            id,
        };
        Ok((permit, handshake))
    }
}

/// Permit of a link; dropping it releases it.
struct Permit {
    gate: Arc<Gate>,
    source: Source,
    id: PermitId,
}

impl Permit {
    /// Counts the link as a session from now on.
    ///
    /// # Errors
    /// Fails if the limit of sessions is reached, or if the link was evicted.
    fn establish(&self) -> Result<(), Refusal> {
        let mut state = self.gate.state.lock();
        state.handshakes.remove(&self.id);
        let established = state.permits.establish(self.id);
        established.inspect_err(|refusal| {
            let now = Instant::now();
            state.log_refusal(now, &self.source, *refusal);
        })
    }

    /// Counts and reports declarations that had to wait.
    fn on_waited(&self, program: &Locator, count: u32) {
        let mut state = self.gate.state.lock();
        state.waited += u64::from(count);
        let waited = state.waited;
        if state.declarations.on_event(Instant::now()).is_some() {
            tracing::warn!(
                "the program at {program} declares more than {DECLARATIONS_PER_S} subscribers, services and tokens per second, so it waits; \
                 {waited} declarations have waited since the start. Declare fewer, such as one subscriber with a wildcard"
            );
        }
    }
}

impl Drop for Permit {
    fn drop(&mut self) {
        let mut state = self.gate.state.lock();
        state.handshakes.remove(&self.id);
        state.permits.release(self.id);
        drop(state);
        self.gate.released.notify_one();
    }
}

impl State {
    fn log_refusal(&mut self, now: Instant, source: &Source, refusal: Refusal) {
        if let Some(more) = self.refusals.on_event(now) {
            tracing::warn!("refused a connection from {source}: {refusal}{more}");
        }
    }
}

/// Limits the log messages about one kind of event.
#[derive(Default)]
struct LogLimit {
    last: Option<Instant>,
    unlogged: u64,
}

impl LogLimit {
    /// Counts an event. Returns the end of its log message, or `None` if it is not logged.
    fn on_event(&mut self, now: Instant) -> Option<String> {
        self.unlogged += 1;
        if self.last.is_some_and(|last| now - last < LOG_PERIOD) {
            return None;
        }
        let more = match self.unlogged - 1 {
            0 => String::new(),
            more => format!(" ({more} more since the last such message)"),
        };
        (self.last, self.unlogged) = (Some(now), 0);
        Some(more)
    }
}

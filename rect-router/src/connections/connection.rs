//! Dials one named connection whenever Zenoh asks for its link, and keeps its state and counters.
use std::{
    sync::{Arc, Weak},
    time::{Instant, SystemTime},
};

use async_trait::async_trait;
use parking_lot::Mutex;
use rect_connections::{
    option_files::{self, LocalError},
    spec::Spec,
};
use rect_core::registry::connection::Traffic;
use zenoh_link_placeholder::Dial;
use zenoh_link_table::{
    EndPoint, LinkManagerBuilderUnicast, LinkUnicast, LinkUnicastTrait, Locator, NewLink,
    NewLinkChannelSender,
};
use zenoh_result::{Error, ZResult};

use super::observed::{LinkObserver, ObservedLink};

/// A connection of the connections file.
pub struct NamedConnection {
    spec: Spec,
    state: Mutex<State>,
}

/// The state of a connection, changed by its links and its dialler.
#[derive(Default)]
struct State {
    /// Whether the connection was removed from the file or replaced by a changed one.
    is_removed: bool,
    /// The open links: one, or one for each reliability.
    links: Vec<Weak<ObservedLink>>,
    /// Time at which the links were opened.
    since: Option<Instant>,
    /// Number of links opened so far.
    linked: u64,
    /// Number of failed attempts since the last link.
    failed: u64,
    last_error: Option<LastError>,
    /// Traffic of the links that have been closed.
    sent: Traffic,
    received: Traffic,
}

/// The reason why a link ended or could not be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LastError {
    /// Description of the reason.
    pub reason: String,
    /// Time at which it occurred.
    pub at: SystemTime,
}

/// Identifies a link by its source and destination, without the metadata that Zenoh adds to locators.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct LinkEnds {
    source: String,
    destination: String,
}

impl LinkEnds {
    /// Returns the ends of a link between two locators.
    pub fn of(source: &Locator, destination: &Locator) -> Self {
        let bare = |locator: &Locator| format!("{}/{}", locator.protocol(), locator.address());
        Self {
            source: bare(source),
            destination: bare(destination),
        }
    }
}

/// The state of a connection at one moment.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// Name, method and endpoint.
    pub spec: Spec,
    /// Ends of the open links.
    pub ends: Vec<LinkEnds>,
    /// Time at which the links were opened; `None` while there are none.
    pub since: Option<Instant>,
    /// Number of links opened so far.
    pub linked: u64,
    /// Number of failed attempts since the last link.
    pub failed: u64,
    /// The most recent error.
    pub last_error: Option<LastError>,
    /// Traffic sent over all links so far.
    pub sent: Traffic,
    /// Traffic received over all links so far.
    pub received: Traffic,
}

impl NamedConnection {
    /// Creates a connection that is not dialled yet.
    pub fn new(spec: Spec) -> Arc<Self> {
        Arc::new(Self {
            spec,
            state: Mutex::default(),
        })
    }

    /// Returns the name, method and endpoint.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// Returns the current state.
    pub fn snapshot(&self) -> Snapshot {
        let links = self.links();
        let state = self.state.lock();
        let (mut sent, mut received) = (state.sent, state.received);
        for link in &links {
            let (more_sent, more_received) = link.traffic();
            sent = sent + more_sent;
            received = received + more_received;
        }
        let ends = |link: &Arc<ObservedLink>| LinkEnds::of(link.get_src(), link.get_dst());
        Snapshot {
            spec: self.spec.clone(),
            ends: links.iter().map(ends).collect(),
            since: state.since.filter(|_| !links.is_empty()),
            linked: state.linked,
            failed: state.failed,
            last_error: state.last_error.clone(),
            sent,
            received,
        }
    }

    /// Closes the links, and a link that is about to open. The placeholder must have been changed before, so that it does not
    /// dial the connection again.
    pub fn end(&self) {
        self.state.lock().is_removed = true;
        for link in self.links() {
            link.end();
        }
    }

    /// Returns the open links. The lock must not be held when they are dropped: dropping the last reference locks it.
    fn links(&self) -> Vec<Arc<ObservedLink>> {
        let links = self.state.lock().links.clone();
        links.iter().filter_map(Weak::upgrade).collect()
    }

    fn on_dial_failed(&self, error: &Error) {
        let reason = error.to_string();
        if let Some(local) = error.downcast_ref::<LocalError>() {
            // Once, and not for each attempt.
            let state = self.state.lock();
            if state
                .last_error
                .as_ref()
                .is_none_or(|last| last.reason != reason)
            {
                tracing::warn!("{}: {}", self.spec.name, local.with_reason());
            }
        }
        self.on_failed(&reason);
    }

    fn on_failed(&self, reason: &str) {
        self.state.lock().failed += 1;
        self.on_link_error(reason);
    }
}

impl LinkObserver for NamedConnection {
    fn on_link_error(&self, reason: &str) {
        self.state.lock().last_error = Some(LastError {
            reason: option_files::public_reason(&self.spec.endpoint, reason),
            at: SystemTime::now(),
        });
    }

    fn on_link_dropped(&self, sent: Traffic, received: Traffic) {
        let mut state = self.state.lock();
        state.sent = state.sent + sent;
        state.received = state.received + received;
    }
}

/// Makes one attempt to open a link to `endpoint` with the link manager of its protocol. `links` is the channel on which the
/// Zenoh runtime receives new links.
///
/// # Errors
/// The reason why the link could not be opened.
pub async fn link(links: &NewLinkChannelSender, endpoint: &EndPoint) -> ZResult<LinkUnicast> {
    let manager = LinkManagerBuilderUnicast::make(links.clone(), endpoint)?;
    manager.new_link(endpoint.clone()).await
}

/// Dials a named connection for its placeholder.
pub struct ConnectionDialler(pub Arc<NamedConnection>);

#[async_trait]
impl Dial for ConnectionDialler {
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast> {
        let Self(connection) = self;
        let attempt = Attempt(Some(connection));
        let endpoint = &connection.spec.endpoint;
        let made = match option_files::check(endpoint) {
            Ok(()) => {
                let made = link(links, endpoint).await;
                made.map_err(|error| option_files::public_error(endpoint, error))
            }
            Err(error) => Err(error.into()),
        };
        attempt.disarm();
        let made = made.inspect_err(|error| connection.on_dial_failed(error))?;
        let observed =
            |link| ObservedLink::new(link, Arc::clone(connection) as Arc<dyn LinkObserver>);
        let (made, links) = match made.0 {
            NewLink::Single(link) => {
                let link = observed(link);
                (NewLink::Single(link.clone()), vec![Arc::downgrade(&link)])
            }
            NewLink::MixedReliability {
                reliable,
                best_effort,
            } => {
                let (reliable, best_effort) = (observed(reliable), observed(best_effort));
                let links = vec![Arc::downgrade(&reliable), Arc::downgrade(&best_effort)];
                (
                    NewLink::MixedReliability {
                        reliable,
                        best_effort,
                    },
                    links,
                )
            }
        };
        let is_removed = {
            let mut state = connection.state.lock();
            state.links = links;
            state.since = Some(Instant::now());
            state.linked += 1;
            state.failed = 0;
            state.is_removed
        };
        if is_removed {
            connection.end();
        }
        Ok(LinkUnicast(made))
    }
}

/// An attempt that Zenoh may abandon; dropping it counts a failed attempt, unless it is disarmed.
struct Attempt<'a>(Option<&'a Arc<NamedConnection>>);

impl Attempt<'_> {
    fn disarm(mut self) {
        self.0 = None;
    }
}

impl Drop for Attempt<'_> {
    fn drop(&mut self) {
        if let Some(connection) = self.0 {
            connection.on_failed("no answer within Zenoh's open_timeout");
        }
    }
}

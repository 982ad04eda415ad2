//! Owns one named connection: dialled whenever Zenoh asks, for as long as it is wanted; what became of it so far.
use std::{
    sync::{Arc, Weak},
    time::{Instant, SystemTime},
};

use async_trait::async_trait;
use parking_lot::Mutex;
use rect::core::connection::Traffic;
use zenoh_link::{
    EndPoint, LinkManagerBuilderUnicast, LinkUnicast, LinkUnicastTrait, Locator, NewLink,
    NewLinkChannelSender,
};
use zenoh_link_slot::Dial;
use zenoh_result::ZResult;

use super::{observed::ObservedLink, spec::Spec};

/// A connection that programs know by name.
pub struct Connection {
    spec: Spec,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// Whether it is wanted no more.
    is_over: bool,
    /// Its links: one, or one for each reliability.
    links: Vec<Weak<ObservedLink>>,
    /// Since when they are there.
    since: Option<Instant>,
    /// Links made so far.
    linked: u64,
    /// Attempts that came to nothing since the last link.
    failed: u64,
    last_error: Option<Trouble>,
    /// What links that are gone carried.
    sent: Traffic,
    received: Traffic,
}

/// Why something ended or did not begin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trouble {
    /// In words.
    pub what: String,
    /// When.
    pub at: SystemTime,
}

/// What tells links apart: source and destination, without what Zenoh adds of itself.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Ends {
    source: String,
    destination: String,
}

impl Ends {
    /// Of a link between these.
    pub fn of(source: &Locator, destination: &Locator) -> Self {
        let bare = |locator: &Locator| format!("{}/{}", locator.protocol(), locator.address());
        Self {
            source: bare(source),
            destination: bare(destination),
        }
    }
}

/// What is known of a connection at one moment.
#[derive(Clone, Debug)]
pub struct Snapshot {
    /// What it is.
    pub spec: Spec,
    /// The ends of its links.
    pub ends: Vec<Ends>,
    /// Since when they are there.
    pub since: Option<Instant>,
    /// Links made so far.
    pub linked: u64,
    /// Attempts that came to nothing since the last link.
    pub failed: u64,
    /// The last thing that went wrong.
    pub last_error: Option<Trouble>,
    /// Over all its links.
    pub sent: Traffic,
    /// Over all its links.
    pub received: Traffic,
}

impl Connection {
    /// One that is not dialled yet.
    pub fn new(spec: Spec) -> Arc<Self> {
        Arc::new(Self {
            spec,
            state: Mutex::default(),
        })
    }

    /// What it is.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// What is known of it.
    pub fn snapshot(&self) -> Snapshot {
        let links = self.links();
        let state = self.state.lock();
        let (mut sent, mut received) = (state.sent, state.received);
        for link in &links {
            let (more_sent, more_received) = link.traffic();
            sent = sent + more_sent;
            received = received + more_received;
        }
        let ends = |link: &Arc<ObservedLink>| Ends::of(link.get_src(), link.get_dst());
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

    /// Ends its links, and the one that may be about to come; its slot holds something else by then.
    pub fn end(&self) {
        self.state.lock().is_over = true;
        for link in self.links() {
            link.end();
        }
    }

    /// (The last to drop a link takes the lock too: so not while it is held.)
    fn links(&self) -> Vec<Arc<ObservedLink>> {
        let links = self.state.lock().links.clone();
        links.iter().filter_map(Weak::upgrade).collect()
    }

    pub(super) fn on_link_error(&self, what: &str) {
        self.state.lock().last_error = Some(Trouble {
            what: what.to_owned(),
            at: SystemTime::now(),
        });
    }

    pub(super) fn on_link_gone(&self, sent: Traffic, received: Traffic) {
        let mut state = self.state.lock();
        state.sent = state.sent + sent;
        state.received = state.received + received;
    }

    fn on_failed(&self, what: &str) {
        self.state.lock().failed += 1;
        self.on_link_error(what);
    }
}

/// One attempt to reach `endpoint`, with the link manager of its protocol; `links` is the channel of the Zenoh runtime.
pub async fn link(links: &NewLinkChannelSender, endpoint: &EndPoint) -> ZResult<LinkUnicast> {
    let manager = LinkManagerBuilderUnicast::make(links.clone(), endpoint)?;
    manager.new_link(endpoint.clone()).await
}

/// Dialled through the slot it is in.
pub struct Dialled(pub Arc<Connection>);

#[async_trait]
impl Dial for Dialled {
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast> {
        let Self(connection) = self;
        let attempt = Attempt(Some(connection));
        let made = link(links, &connection.spec.endpoint).await;
        attempt.ends();
        let made = made.inspect_err(|error| connection.on_failed(&error.to_string()))?;
        let observed = |link| ObservedLink::new(link, Arc::clone(connection));
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
        let is_over = {
            let mut state = connection.state.lock();
            state.links = links;
            state.since = Some(Instant::now());
            state.linked += 1;
            state.failed = 0;
            state.is_over
        };
        if is_over {
            connection.end();
        }
        Ok(LinkUnicast(made))
    }
}

/// An attempt that Zenoh may give up.
struct Attempt<'a>(Option<&'a Arc<Connection>>);

impl Attempt<'_> {
    fn ends(mut self) {
        self.0 = None;
    }
}

impl Drop for Attempt<'_> {
    fn drop(&mut self) {
        if let Some(connection) = self.0 {
            connection.on_failed("nobody answered in time");
        }
    }
}

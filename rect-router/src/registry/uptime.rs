//! Records when each link was opened, from Zenoh's link events.
use std::{
    collections::HashMap,
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use zenoh::{sample::SampleKind, session::LinkEvent, Session, Wait};

use crate::connections::LinkEnds;

/// The time at which each link was opened.
#[derive(Default)]
pub struct Uptime(Mutex<HashMap<LinkEnds, Instant>>);

impl Uptime {
    /// Observes the links of all `sessions`. Calls `on_change` whenever a link is opened or closed.
    ///
    /// # Errors
    /// Zenoh's error if the events cannot be observed.
    pub fn start<'s>(
        sessions: impl IntoIterator<Item = &'s Session>,
        on_change: &(impl Fn() + Clone + Send + Sync + 'static),
    ) -> zenoh::Result<Arc<Self>> {
        let uptime = Arc::<Self>::default();
        for session in sessions {
            uptime.follow(session, on_change.clone())?;
        }
        Ok(uptime)
    }

    fn follow(
        self: &Arc<Self>,
        session: &Session,
        on_change: impl Fn() + Send + Sync + 'static,
    ) -> zenoh::Result<()> {
        let uptime = Arc::clone(self);
        let on_event = move |event: LinkEvent| {
            let link = event.link();
            let ends = LinkEnds::of(link.src(), link.dst());
            let mut since = uptime.0.lock();
            match event.kind() {
                SampleKind::Put => drop(since.insert(ends, Instant::now())),
                SampleKind::Delete => drop(since.remove(&ends)),
            }
            on_change();
        };
        let info = session.info();
        let listener = info.link_events_listener().history(true);
        listener.callback(on_event).background().wait()
    }

    /// Returns how long a link has been open; `None` if there is no such link.
    pub fn of(&self, ends: &LinkEnds) -> Option<Duration> {
        self.0.lock().get(ends).map(Instant::elapsed)
    }
}

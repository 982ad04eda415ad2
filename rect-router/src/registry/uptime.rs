//! Owns since when each link is there, as Zenoh tells of links that come and go.
use std::{
    collections::HashMap,
    sync::Arc,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use zenoh::{sample::SampleKind, session::LinkEvent, Session, Wait};

use crate::connections::Ends;

/// Counts from when Zenoh has a link.
#[derive(Default)]
pub struct Uptime(Mutex<HashMap<Ends, Instant>>);

impl Uptime {
    /// Calls `on_change` whenever a link comes or goes.
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
        let heard = Arc::clone(self);
        let on_event = move |event: LinkEvent| {
            let link = event.link();
            let ends = Ends::of(link.src(), link.dst());
            let mut since = heard.0.lock();
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

    /// How long the link between these is there.
    pub fn of(&self, ends: &Ends) -> Option<Duration> {
        self.0.lock().get(ends).map(Instant::elapsed)
    }
}

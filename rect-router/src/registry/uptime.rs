//! Owns since when each link is there, as Zenoh tells of links that come and go.
use std::{
    collections::HashMap,
    sync::{mpsc::Sender, Arc},
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use zenoh::{sample::SampleKind, session::LinkEvent, Session, Wait};

use crate::connections::Ends;

/// Counts from when Zenoh has a link.
#[derive(Default)]
pub struct Uptime(Mutex<HashMap<Ends, Instant>>);

impl Uptime {
    /// `changed` is told whenever a link comes or goes.
    pub fn start<'s>(
        sessions: impl IntoIterator<Item = &'s Session>,
        changed: &Sender<()>,
    ) -> zenoh::Result<Arc<Self>> {
        let uptime = Arc::<Self>::default();
        for session in sessions {
            uptime.follow(session, changed.clone())?;
        }
        Ok(uptime)
    }

    fn follow(self: &Arc<Self>, session: &Session, changed: Sender<()>) -> zenoh::Result<()> {
        let heard = Arc::clone(self);
        let on_event = move |event: LinkEvent| {
            let link = event.link();
            let ends = Ends::of(link.src(), link.dst());
            let mut since = heard.0.lock();
            match event.kind() {
                SampleKind::Put => drop(since.insert(ends, Instant::now())),
                SampleKind::Delete => drop(since.remove(&ends)),
            }
            let _ = changed.send(());
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

//! Owns what a program is told about who can be reached, and its counters.
use std::sync::{Arc, Mutex, PoisonError};

use tokio::task::JoinHandle;
use zenoh::{
    bytes::ZBytes,
    liveliness::LivelinessToken,
    sample::{Sample, SampleKind},
    session::LinkEvent,
    Session, Wait,
};

use super::{
    inbox::{Filling, Inbox},
    robot::Robot,
    subscriber::{called, Subscription},
};
use crate::{
    core::{
        connection::{Connection, Event, Link, Links, Presence},
        counters::Counters,
        key::Place,
        queue::{Queue, WhenFull, DEFAULT_CAPACITY},
    },
    error::Error,
};

/// What changes about who can be reached, as it changes; first of all who is there already. It ends when it is dropped.
#[derive(Debug)]
pub struct Events {
    inbox: Arc<Inbox<Event>>,
    _peers: zenoh::pubsub::Subscriber<()>,
    _links: zenoh::session::LinkEventsListener<()>,
    _registry: Option<zenoh::pubsub::Subscriber<()>>,
}

/// The links of this robot's router, as far as it tells.
pub(super) struct Known {
    links: Arc<Mutex<Links>>,
    _published: zenoh::pubsub::Subscriber<()>,
}

impl Known {
    /// Follows what the router says of its connections; where it has no registry, nothing is known.
    pub(super) async fn follow(session: &Session, place: &Place) -> Result<Self, Error> {
        let links = Arc::new(Mutex::new(Links::default()));
        let followed = links.clone();
        let published = follow(session, place, move |connections| {
            let mut links = followed.lock().unwrap_or_else(PoisonError::into_inner);
            links.on_connections(connections);
        })
        .await?;
        Ok(Self {
            links,
            _published: published,
        })
    }

    pub(super) fn links(&self) -> Arc<Mutex<Links>> {
        self.links.clone()
    }
}

impl Robot {
    /// What changes about who can be reached: robots that come and go, links of this robot's router (without a router,
    /// of this program) and over which radio, and the router itself.
    ///
    /// # Errors
    /// [`Error::Zenoh`] when the session is closed.
    pub async fn events(&self) -> Result<Events, Error> {
        let inner = &self.inner;
        let inbox = Inbox::new(Queue::new(DEFAULT_CAPACITY, WhenFull::NewestWins));
        let refused = || Error::zenoh("who is there is not told");
        let info = inner.session.info();
        let links = info.link_events_listener().history(false);
        let links = links.callback(on_link(inbox.clone(), inner.direct)).await;
        let presence = Mutex::new(Presence::default());
        let (place, filling) = (inner.place.clone(), Filling::new(&inbox));
        let peers = inner.session.liveliness();
        let peers = peers.declare_subscriber(place.own(None, "alive/*"));
        let peers = peers.history(true).callback(move |sample: Sample| {
            let event = on_presence(&place, &presence, &sample);
            event.into_iter().for_each(|event| {
                filling.push(event);
            });
        });
        let peers = peers.await.map_err(refused())?;
        let registry = if inner.direct {
            None
        } else {
            let (seen, heard) = (Mutex::new(Links::default()), inbox.clone());
            let on_connections = move |connections: &[Connection]| {
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                for event in seen.on_connections(connections) {
                    heard.push(event);
                }
            };
            Some(follow(&inner.session, &inner.place, on_connections).await?)
        };
        Ok(Events {
            inbox,
            _peers: peers,
            _links: links.map_err(refused())?,
            _registry: registry,
        })
    }

    /// Calls `callback` for each of [`events`](Self::events), until what this returns is dropped.
    ///
    /// # Errors
    /// As [`events`](Self::events).
    pub async fn on_state(
        &self,
        mut callback: impl FnMut(Event) + Send + 'static,
    ) -> Result<Subscription, Error> {
        let events = self.events().await?;
        let task: JoinHandle<()> = self.inner.runtime.spawn(async move {
            while let Some(event) = events.next().await {
                called("state", || callback(event));
            }
        });
        Ok(Subscription::of(task))
    }

    /// What this program has said and heard.
    pub fn counters(&self) -> Counters {
        self.inner.counting.read()
    }
}

impl Events {
    /// The next one; `None`: the session was closed.
    pub async fn next(&self) -> Option<Event> {
        self.inbox.pop().await
    }

    /// Nothing comes any more; what waits can still be taken.
    pub fn close(&self) {
        self.inbox.close();
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.close();
    }
}

/// Says that this robot is there, where it has no router that does.
pub(super) async fn say_there(session: &Session, place: &Place) -> Result<LivelinessToken, Error> {
    let key = place.own(Some(&place.robot), &format!("alive/{}", session.zid()));
    let token = session.liveliness().declare_token(key).await;
    token.map_err(Error::zenoh("the robot can't say that it is there"))
}

fn on_link(inbox: Arc<Inbox<Event>>, direct: bool) -> impl Fn(LinkEvent) + Send + Sync + 'static {
    move |event: LinkEvent| {
        let to = event.link().dst();
        let link = Link {
            method: to.protocol().as_str().to_owned(),
            address: to.address().as_str().to_owned(),
            robot: None,
        };
        inbox.push(match (event.kind(), direct) {
            (SampleKind::Put, true) => Event::LinkUp(link),
            (SampleKind::Delete, true) => Event::LinkDown(link),
            (SampleKind::Put, false) => Event::RouterUp,
            (SampleKind::Delete, false) => Event::RouterDown,
        });
    }
}

fn on_presence(place: &Place, presence: &Mutex<Presence>, sample: &Sample) -> Option<Event> {
    let key = sample.key_expr().as_str();
    let robot = place.robot_of(key).filter(|robot| *robot != place.robot)?;
    let id = key.rsplit('/').next()?;
    let mut presence = presence.lock().unwrap_or_else(PoisonError::into_inner);
    match sample.kind() {
        SampleKind::Put => presence.on_up(&robot, id),
        SampleKind::Delete => presence.on_down(&robot, id),
    }
}

/// Gives what this robot's router says of its connections, now and whenever they change.
async fn follow(
    session: &Session,
    place: &Place,
    on_connections: impl Fn(&[Connection]) + Send + Sync + 'static,
) -> Result<zenoh::pubsub::Subscriber<()>, Error> {
    let key = place.own(Some(&place.robot), "connections");
    let on_connections = Arc::new(move |bytes: &ZBytes| {
        if let Ok(connections) = serde_json::from_slice::<Vec<Connection>>(&bytes.to_bytes()) {
            on_connections(&connections);
        }
    });
    let on_answer = on_connections.clone();
    let published = session
        .declare_subscriber(key.clone())
        .callback(move |sample| on_connections(sample.payload()))
        .wait()
        .map_err(Error::zenoh("the router's connections are not told"))?;
    let asked = session.get(key).callback(move |reply| {
        if let Ok(sample) = reply.result() {
            on_answer(sample.payload());
        }
    });
    asked
        .await
        .map_err(Error::zenoh("the router's connections are not told"))?;
    Ok(published)
}

//! Reports events of robots, links and the router to the program, keeps track of the router's links, and returns the
//! program's counters.
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
    receive_queue::{QueueWriter, ReceiveQueue},
    robot::Robot,
    subscriber::{call, Subscription},
};
use crate::{
    core::{
        connection::{Connection, Event, Link, Links, Presence},
        counters::Counters,
        key::KeySpace,
        queue::{Queue, WhenFull, DEFAULT_CAPACITY},
    },
    error::Error,
};

/// Receives the [events](Event) of robots, links and the router; created by [`Robot::events`].
///
/// At first, events report the robots that are already reachable and, with a router, the links that are already up.
/// Dropping this value ends the subscription.
#[derive(Debug)]
pub struct Events {
    queue: Arc<ReceiveQueue<Event>>,
    _peers: zenoh::pubsub::Subscriber<()>,
    _links: zenoh::session::LinkEventsListener<()>,
    _registry: Option<zenoh::pubsub::Subscriber<()>>,
}

/// The links of this robot's router, as reported by its registry.
pub(super) struct RouterLinks {
    links: Arc<Mutex<Links>>,
    _published: zenoh::pubsub::Subscriber<()>,
}

impl RouterLinks {
    /// Subscribes to the connections that the router publishes. Without a registry, the links remain unknown.
    pub(super) async fn follow(session: &Session, place: &KeySpace) -> Result<Self, Error> {
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
    /// Subscribes to events: robots that become reachable or unreachable, links of this robot's router that come up or go
    /// down (without a router: links of this program), and the loss and return of the router itself.
    ///
    /// ```no_run
    /// # async fn observe(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let events = robot.events().await?;
    /// while let Some(event) = events.next().await {
    ///     println!("{event:?}");
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Zenoh`] if the session is closed.
    pub async fn events(&self) -> Result<Events, Error> {
        let inner = &self.inner;
        let queue = ReceiveQueue::new(Queue::new(DEFAULT_CAPACITY, WhenFull::DropOldest));
        let refused = || Error::zenoh("cannot subscribe to events");
        let info = inner.session.info();
        let links = info.link_events_listener().history(false);
        let links = links.callback(on_link(queue.clone(), inner.direct)).await;
        let presence = Mutex::new(Presence::default());
        let (place, writer) = (inner.place.clone(), QueueWriter::new(&queue));
        let peers = inner.session.liveliness();
        let peers = peers.declare_subscriber(place.own(None, "alive/*"));
        let peers = peers.history(true).callback(move |sample: Sample| {
            let event = on_presence(&place, &presence, &sample);
            event.into_iter().for_each(|event| {
                writer.push(event);
            });
        });
        let peers = peers.await.map_err(refused())?;
        let registry = if inner.direct {
            None
        } else {
            let (seen, event_queue) = (Mutex::new(Links::default()), queue.clone());
            let on_connections = move |connections: &[Connection]| {
                let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                for event in seen.on_connections(connections) {
                    event_queue.push(event);
                }
            };
            Some(follow(&inner.session, &inner.place, on_connections).await?)
        };
        Ok(Events {
            queue,
            _peers: peers,
            _links: links.map_err(refused())?,
            _registry: registry,
        })
    }

    /// Calls `callback` for each of the [`events`](Self::events) until the returned subscription is dropped.
    ///
    /// If the callback panics, the panic is logged and the callback is called again for the next event.
    ///
    /// # Errors
    /// Returns the same errors as [`events`](Self::events).
    pub async fn on_event(
        &self,
        mut callback: impl FnMut(Event) + Send + 'static,
    ) -> Result<Subscription, Error> {
        let events = self.events().await?;
        let task: JoinHandle<()> = self.inner.runtime.spawn(async move {
            while let Some(event) = events.next().await {
                call("events", || callback(event));
            }
        });
        Ok(Subscription::of(task))
    }

    /// Returns the counters of this session: messages and bytes sent and received, and messages missed and rejected.
    pub fn counters(&self) -> Counters {
        self.inner.counting.read()
    }
}

impl Events {
    /// Waits for the next event; returns `None` once the session or the subscription is closed.
    pub async fn next(&self) -> Option<Event> {
        self.queue.pop().await
    }

    /// Stops receiving. Events that are already queued can still be read.
    pub fn close(&self) {
        self.queue.close();
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.close();
    }
}

/// Declares the liveliness token of this robot, which its router declares if it has one.
pub(super) async fn declare_liveliness(
    session: &Session,
    place: &KeySpace,
) -> Result<LivelinessToken, Error> {
    let key = place.own(Some(&place.robot), &format!("alive/{}", session.zid()));
    let token = session.liveliness().declare_token(key).await;
    token.map_err(Error::zenoh("cannot declare the robot's liveliness token"))
}

fn on_link(
    queue: Arc<ReceiveQueue<Event>>,
    direct: bool,
) -> impl Fn(LinkEvent) + Send + Sync + 'static {
    move |event: LinkEvent| {
        let to = event.link().dst();
        let link = Link {
            method: to.protocol().as_str().to_owned(),
            address: to.address().as_str().to_owned(),
            robot: None,
        };
        queue.push(match (event.kind(), direct) {
            (SampleKind::Put, true) => Event::LinkUp(link),
            (SampleKind::Delete, true) => Event::LinkDown(link),
            (SampleKind::Put, false) => Event::RouterUp,
            (SampleKind::Delete, false) => Event::RouterDown,
        });
    }
}

fn on_presence(place: &KeySpace, presence: &Mutex<Presence>, sample: &Sample) -> Option<Event> {
    let key = sample.key_expr().as_str();
    let robot = place.robot_of(key).filter(|robot| *robot != place.robot)?;
    let id = key.rsplit('/').next()?;
    let mut presence = presence.lock().unwrap_or_else(PoisonError::into_inner);
    match sample.kind() {
        SampleKind::Put => presence.on_up(&robot, id),
        SampleKind::Delete => presence.on_down(&robot, id),
    }
}

/// Calls `on_connections` with the connections of this robot's router, now and whenever they change.
async fn follow(
    session: &Session,
    place: &KeySpace,
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
        .map_err(Error::zenoh("cannot subscribe to the router's connections"))?;
    let asked = session.get(key).callback(move |reply| {
        if let Ok(sample) = reply.result() {
            on_answer(sample.payload());
        }
    });
    asked
        .await
        .map_err(Error::zenoh("cannot query the router's connections"))?;
    Ok(published)
}

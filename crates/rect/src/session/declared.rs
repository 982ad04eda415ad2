//! Declares what a driver asks for, with callbacks that report to the driver.
use std::sync::{
    atomic::{AtomicBool, Ordering},
    Arc,
};

use rect_core::driver::{Declaration, Driver, Event, Id};
use zenoh::{
    liveliness::LivelinessToken,
    matching::MatchingListener,
    pubsub::{Publisher, Subscriber},
    query::{Query, Queryable},
    sample::{Sample, SampleKind},
    session::{LinkEvent, LinkEventsListener},
    Session, Wait,
};

use super::{convert::sample, queries, shared::Shared};
use crate::error::Error;

/// Something that is declared on a Zenoh session. Dropping it undeclares it.
pub(super) struct Declared {
    is_undeclared: Arc<AtomicBool>,
    entity: Entity,
}

#[allow(dead_code)] // Held only for its end, except for publishers.
enum Entity {
    Publisher(Publisher<'static>, Option<MatchingListener<()>>),
    Subscriber(Subscriber<()>),
    Queryable(Queryable<()>),
    Token(LivelinessToken),
    Links(LinkEventsListener<()>),
}

/// The driver behind a callback. Zenoh drops its callbacks with the session, which the driver learns here.
struct Reporter<D: Driver> {
    shared: Arc<Shared<D>>,
    id: Id,
    is_undeclared: Arc<AtomicBool>,
}

impl Declared {
    pub(super) fn new<D>(
        session: &Session,
        id: Id,
        declaration: Declaration,
        shared: &Arc<Shared<D>>,
    ) -> Result<Self, Error>
    where
        D: Driver + Send + 'static,
        D::Item: 'static,
    {
        let is_undeclared = Arc::new(AtomicBool::new(false));
        let reporter = Reporter {
            shared: shared.clone(),
            id,
            is_undeclared: is_undeclared.clone(),
        };
        let entity = declare(session, declaration, reporter)?;
        Ok(Self {
            is_undeclared,
            entity,
        })
    }

    pub(super) fn publisher(&self) -> Option<&Publisher<'static>> {
        match &self.entity {
            Entity::Publisher(publisher, _) => Some(publisher),
            _ => None,
        }
    }
}

impl Drop for Declared {
    fn drop(&mut self) {
        self.is_undeclared.store(true, Ordering::Relaxed);
    }
}

impl<D: Driver> Reporter<D> {
    fn on_event(&self, event: Event) {
        self.shared.on_event(event);
    }

    fn on_sample(&self, received: &Sample) {
        let (id, sample) = (self.id, sample(received));
        self.on_event(Event::Sample { id, sample });
    }

    fn on_link(&self, event: &LinkEvent) {
        let to = event.link().dst();
        self.on_event(Event::Link {
            up: event.kind() == SampleKind::Put,
            method: to.protocol().as_str().to_owned(),
            address: to.address().as_str().to_owned(),
        });
    }
}

impl<D: Driver> Drop for Reporter<D> {
    fn drop(&mut self) {
        if !self.is_undeclared.load(Ordering::Relaxed) {
            self.on_event(Event::Closed);
        }
    }
}

fn declare<D>(
    session: &Session,
    declaration: Declaration,
    reporter: Reporter<D>,
) -> Result<Entity, Error>
where
    D: Driver + Send + 'static,
    D::Item: 'static,
{
    Ok(match declaration {
        Declaration::Publisher {
            key,
            qos,
            observes_matching,
        } => {
            let publisher = queries::publisher(session, key, qos)?;
            let listener = match observes_matching {
                true => {
                    let observed = observe(&publisher, reporter);
                    Some(observed.map_err(Error::zenoh("cannot declare the publisher"))?)
                }
                false => {
                    // A publisher has no callback that would report the end of the session.
                    reporter.is_undeclared.store(true, Ordering::Relaxed);
                    None
                }
            };
            Entity::Publisher(publisher, listener)
        }
        Declaration::Subscriber { key } => {
            let subscriber = session.declare_subscriber(key);
            let subscriber = subscriber.callback(move |sample| reporter.on_sample(&sample));
            let declared = subscriber.wait();
            Entity::Subscriber(declared.map_err(Error::zenoh("cannot declare the subscriber"))?)
        }
        Declaration::Queryable { key, complete } => {
            let queryable = session.declare_queryable(key).complete(complete);
            let on_query = move |query: Query| reporter.shared.on_query(reporter.id, query);
            let declared = queryable.callback(on_query).wait();
            Entity::Queryable(declared.map_err(Error::zenoh("cannot declare the queryable"))?)
        }
        Declaration::LivelinessToken { key } => {
            reporter.is_undeclared.store(true, Ordering::Relaxed);
            let declared = session.liveliness().declare_token(key).wait();
            Entity::Token(declared.map_err(Error::zenoh("cannot declare the liveliness token"))?)
        }
        Declaration::LivelinessSubscriber { key } => {
            let liveliness = session.liveliness();
            let subscriber = liveliness.declare_subscriber(key).history(true);
            let subscriber = subscriber.callback(move |sample| reporter.on_sample(&sample));
            let declared = subscriber.wait();
            let refused = Error::zenoh("cannot subscribe to the presence of robots");
            Entity::Subscriber(declared.map_err(refused)?)
        }
        Declaration::LinkListener => {
            let info = session.info();
            let listener = info.link_events_listener().history(false);
            let listener = listener.callback(move |event| reporter.on_link(&event));
            let declared = listener.wait();
            Entity::Links(declared.map_err(Error::zenoh("cannot observe the links"))?)
        }
    })
}

/// Reports whether subscribers match a publisher, now and after each change.
fn observe<D>(
    publisher: &Publisher<'static>,
    reporter: Reporter<D>,
) -> zenoh::Result<MatchingListener<()>>
where
    D: Driver + Send + 'static,
    D::Item: 'static,
{
    let (shared, id) = (reporter.shared.clone(), reporter.id);
    let listener = publisher.matching_listener();
    let listener = listener
        .callback(move |status| {
            let (id, matching) = (reporter.id, status.matching());
            reporter.on_event(Event::Matching { id, matching });
        })
        .wait()?;
    let matching = publisher.matching_status().wait()?.matching();
    shared.on_event(Event::Matching { id, matching });
    Ok(listener)
}

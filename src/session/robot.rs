//! Owns a program's place among the robots: the session, and what it says.
use std::{
    collections::HashMap,
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::runtime::Handle;
use zenoh::{liveliness::LivelinessToken, Config, Session};

use super::{
    decoder::Decoder,
    lanes::Lanes,
    options::Options,
    publication::Publication,
    state::{self, Known},
};
use crate::{
    core::{
        codec::Codec,
        counters::Counting,
        key::Place,
        name::Name,
        payload::{Payload, ToPayload},
        topic::Topic,
        urgency::Urgency,
    },
    error::Error,
};

/// The most topics whose publishers are kept; of more, they are declared anew when one speaks about them again.
const MAX_PUBLICATIONS: usize = 256;

/// A program of a robot, joined with the others. Cloning it is cheap; the session ends with the last clone.
#[derive(Clone)]
pub struct Robot {
    pub(super) inner: Arc<Inner>,
    urgency: Urgency,
    codec: Option<Arc<dyn Codec>>,
}

pub(super) struct Inner {
    pub(super) session: Session,
    pub(super) lanes: Lanes,
    pub(super) place: Place,
    pub(super) runtime: Handle,
    publications: Mutex<HashMap<Spoken, Arc<Publication>>>,
    pub(super) decoder: Arc<Decoder>,
    pub(super) counting: Arc<Counting>,
    /// Where there is a router.
    pub(super) known: Option<Known>,
    pub(super) direct: bool,
    /// Where there is no router that says that this robot is there.
    _presence: Option<LivelinessToken>,
}

/// What a publisher is for.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Spoken {
    topic: Topic,
    to: Option<Name>,
    urgency: Urgency,
}

/// Joins as a program of that robot, at the router of this computer.
///
/// ```no_run
/// # async fn hello() -> Result<(), rect::Error> {
/// let robot = rect::connect("wombat-1").await?;
/// robot.publish("greeting", "hello").await?;
/// # Ok(()) }
/// ```
///
/// # Errors
/// [`Error::Name`]; [`Error::NoRouter`]: none runs here.
pub async fn connect(robot: &str) -> Result<Robot, Error> {
    Options::new(robot)?.connect().await
}

impl Robot {
    /// `router`: how it was joined, where there is one.
    pub(super) async fn start(
        session: Session,
        place: Place,
        router: Option<Config>,
    ) -> Result<Self, Error> {
        let direct = router.is_none();
        let (presence, known) = if direct {
            (Some(state::say_there(&session, &place).await?), None)
        } else {
            (None, Some(Known::follow(&session, &place).await?))
        };
        let decoder = Decoder::new(&session, &place);
        let inner = Inner {
            lanes: Lanes::new(session.clone(), router),
            session,
            place,
            runtime: Handle::current(),
            publications: Mutex::default(),
            decoder,
            counting: Arc::default(),
            known,
            direct,
            _presence: presence,
        };
        Ok(Self {
            inner: Arc::new(inner),
            urgency: Urgency::default(),
            codec: None,
        })
    }

    /// This robot's name.
    pub fn name(&self) -> &Name {
        &self.inner.place.robot
    }

    /// The fleet's name.
    pub fn fleet(&self) -> &Name {
        &self.inner.place.fleet
    }

    /// The session of Zenoh below, for whatever Zenoh can do and this has no word for. What is urgent, and bulk, goes over
    /// sessions of their own.
    pub fn zenoh(&self) -> &Session {
        &self.inner.session
    }

    /// The same robot, speaking with that urgency: `robot.with(Urgency::Urgent).publish("stop", "")`.
    #[must_use]
    pub fn with(&self, urgency: Urgency) -> Self {
        Self {
            urgency,
            ..self.clone()
        }
    }

    /// The same robot, speaking urgently: what it says overtakes everything else.
    #[must_use]
    pub fn urgent(&self) -> Self {
        self.with(Urgency::Urgent)
    }

    /// The same robot, in no hurry: everything else overtakes what it says.
    #[must_use]
    pub fn bulk(&self) -> Self {
        self.with(Urgency::Bulk)
    }

    /// The same robot; what it says goes through that codec: `robot.encoded(codec::parse("zstd:9")?)`.
    #[must_use]
    pub fn encoded(&self, codec: Arc<dyn Codec>) -> Self {
        Self {
            codec: Some(codec),
            ..self.clone()
        }
    }

    /// How urgently it speaks.
    pub fn urgency(&self) -> Urgency {
        self.urgency
    }

    /// Says it to all.
    ///
    /// # Errors
    /// [`Error::Topic`], [`Error::Payload`], [`Error::Codec`]; [`Error::Zenoh`] when the session is closed.
    pub async fn publish<T: TryInto<Topic>>(
        &self,
        topic: T,
        value: impl ToPayload,
    ) -> Result<(), Error>
    where
        Error: From<T::Error>,
    {
        self.say(topic.try_into()?, None, self.payload(value)?)
            .await
    }

    /// Says it to one robot alone. Nobody is asked whether it is there: [`request`](Self::request) does that.
    ///
    /// # Errors
    /// As [`publish`](Self::publish), and [`Error::Name`].
    pub async fn send<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        to: N,
        topic: T,
        value: impl ToPayload,
    ) -> Result<(), Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let to = Some(to.try_into()?);
        self.say(topic.try_into()?, to, self.payload(value)?).await
    }

    /// Ends the session now, and all that belongs to it, whoever has clones.
    ///
    /// # Errors
    /// [`Error::Zenoh`].
    pub async fn close(&self) -> Result<(), Error> {
        let closed = self.inner.lanes.close().await;
        closed.map_err(Error::zenoh("the session does not close"))
    }

    pub(super) fn payload(&self, value: impl ToPayload) -> Result<Payload, Error> {
        let payload = value.into_payload()?;
        let payload = match &self.codec {
            Some(codec) => codec.encode(&payload)?,
            None => payload,
        };
        Ok(payload.sendable()?)
    }

    async fn say(&self, topic: Topic, to: Option<Name>, payload: Payload) -> Result<(), Error> {
        let urgency = self.urgency;
        let publication = self.publication(Spoken { topic, to, urgency }).await?;
        let bytes = payload.bytes.len();
        publication.put(payload, &self.inner.runtime).await?;
        self.inner.counting.on_sent(bytes);
        Ok(())
    }

    async fn publication(&self, spoken: Spoken) -> Result<Arc<Publication>, Error> {
        if let Some(known) = self.publications().get(&spoken) {
            return Ok(known.clone());
        }
        let session = self.inner.lanes.of(spoken.urgency).await;
        let mut publications = self.publications();
        // Somebody may have been faster.
        if let Some(known) = publications.get(&spoken) {
            return Ok(known.clone());
        }
        let place = &self.inner.place;
        let key = match &spoken.to {
            None => place.publication(&spoken.topic),
            Some(to) => place.message(to, &spoken.topic),
        };
        let publication = Publication::declare(session, key, spoken.urgency.qos())?;
        let publication = Arc::new(publication);
        if publications.len() >= MAX_PUBLICATIONS {
            publications.clear();
        }
        publications.insert(spoken, publication.clone());
        Ok(publication)
    }

    fn publications(&self) -> MutexGuard<'_, HashMap<Spoken, Arc<Publication>>> {
        let publications = self.inner.publications.lock();
        publications.unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for Robot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = &self.inner.place;
        write!(f, "Robot({}/{})", place.fleet, place.robot)
    }
}

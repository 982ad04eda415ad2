//! Defines [`Robot`], a program's handle of its session, and publishes messages.
use std::{
    any::Any,
    fmt,
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak},
    time::{Duration, Instant, SystemTime},
};

use rect_core::{
    catalogue::{presence::ProgramPresence, Instance},
    clock::unix::ms_since_1970,
    codec::{dictionary::Dictionary, dictionary_codec::DictionaryCodec, Codec},
    message::{
        counters::AtomicCounters,
        payload::{Payload, ToPayload},
        request::DEFAULT_TIMEOUT_MS,
        urgency::Urgency,
    },
    name::{key::KeySpace, topic::Topic, Name},
    registry::catalogue_query::Catalogues,
    retry::once::Once,
    session::{
        declarations::Declarations, peers::DirectPresence, publication::PublicationKey,
        request_ids::RequestIds,
    },
};
use tokio::{runtime::Handle, sync::OnceCell};
use zenoh::{query::Query, Config, Session};

use super::{
    decoder::Decoder,
    executor::{Executor, Running},
    program_log::{KeptLog, ProgramLog},
    publication::{Publication, Put},
    querier::Querier,
    recipients::Recipients,
    results::KeptResults,
    router_links::RouterLinks,
    shared::NoItems,
    state::{KeptState, Retention, State},
    throttle::RunningThrottle,
    urgency_sessions::UrgencySessions,
    warnings::{WarningSink, Warnings},
};
use crate::error::{valid, Error};

/// A handle of a program's session, through which it communicates as one robot of the fleet.
///
/// Clones are cheap and share the session. The session ends when [`close`](Self::close) is called, or when the last
/// clone is dropped and no subscriber, service, stream or transfer that was created with it is left.
#[derive(Clone)]
pub struct Robot {
    pub(super) inner: Arc<Inner>,
    urgency: Urgency,
    codec: Option<Arc<dyn Codec>>,
    /// The time after which messages expire.
    lifetime: Option<Duration>,
    pub(super) timeout: Duration,
    /// Whether requests are repeated.
    pub(super) retries: bool,
    /// Whether messages are retained.
    retention: Option<Retention>,
}

pub(super) struct Inner {
    pub(super) session: Session,
    pub(super) urgency_sessions: UrgencySessions,
    pub(super) place: KeySpace,
    pub(super) runtime: Handle,
    publications: Mutex<Declarations<PublicationKey, Publication>>,
    queriers: Mutex<Declarations<(Urgency, String), Querier>>,
    pub(super) decoder: Arc<Decoder>,
    pub(super) counting: Arc<AtomicCounters>,
    pub(super) warnings: Arc<Warnings>,
    /// The router's links; `None` without a router.
    pub(super) router_links: Option<RouterLinks>,
    pub(super) direct: bool,
    /// The last catalogues of robots.
    pub(super) catalogues: Catalogues,
    pub(super) request_ids: RequestIds,
    /// The requests that this program carries out at most once.
    pub(super) once: Once<Query>,
    recipients: OnceCell<Recipients>,
    /// The large results of this program's actions, since the first one.
    pub(super) results: OnceLock<KeptResults>,
    /// The lines that this program logs, since the first one.
    pub(super) log: OnceLock<Option<ProgramLog>>,
    /// The retained messages of this program.
    pub(super) state: Arc<State>,
    /// The state and the log of the robot; `None` if its router keeps them.
    pub(super) kept: Option<(KeptState, KeptLog, RunningThrottle)>,
    /// The part of this program in the stop of the fleet, which is above this module.
    pub(super) stop: tokio::sync::Mutex<Weak<dyn Any + Send + Sync>>,
    /// The presence of this program.
    pub(super) program: Running<ProgramPresence>,
    /// The presence of the robot; `None` if its router has one.
    _presence: Option<Running<DirectPresence>>,
}

impl Robot {
    /// Completes the session. `router` is the configuration with which the router was reached, if there is one.
    pub(super) async fn complete(
        session: Session,
        place: KeySpace,
        program: Option<Name>,
        router: Option<Config>,
    ) -> Result<Self, Error> {
        let direct = router.is_none();
        let (presence, router_links) = if direct {
            let id = session.zid().to_string();
            let presence = DirectPresence::new(
                &place,
                &id,
                ms_since_1970(SystemTime::now()),
                Instant::now(),
            );
            let executor = Executor::new(&session, presence, NoItems);
            (Some(executor.start(&Handle::current())?), None)
        } else {
            let links = RouterLinks::follow(&session, &place, &Handle::current())?;
            (None, Some(links))
        };
        let instance: u32 = rand::random();
        let keep = || {
            let state = KeptState::of_program(&session, place.clone())?;
            let log = KeptLog::start(&session, place.clone())?;
            let throttle = RunningThrottle::start(&session, place.clone())?;
            Ok::<_, Error>((state, log, throttle))
        };
        let kept = direct.then(keep).transpose()?;
        let state = State::new(&session, &place, instance);
        let request_ids = RequestIds::new(Instance(instance), program.is_some());
        let once = Once::new(place.robot.clone(), Instance(instance));
        let program = ProgramPresence::new(place.clone(), program, instance, direct);
        let executor = Executor::new(&session, program, WarningSink);
        let program = executor.start(&Handle::current())?;
        let decoder = Decoder::new(&session, &place);
        let counting = Arc::default();
        let inner = Inner {
            urgency_sessions: UrgencySessions::new(session.clone(), router),
            session,
            place,
            runtime: Handle::current(),
            publications: Mutex::default(),
            queriers: Mutex::default(),
            decoder,
            warnings: Warnings::new(Arc::clone(&counting)),
            counting,
            router_links,
            catalogues: Catalogues::default(),
            request_ids,
            once,
            recipients: OnceCell::new(),
            results: OnceLock::new(),
            log: OnceLock::new(),
            state,
            kept,
            stop: tokio::sync::Mutex::new(Weak::<()>::new()),
            direct,
            program,
            _presence: presence,
        };
        Ok(Self {
            inner: Arc::new(inner),
            urgency: Urgency::default(),
            codec: None,
            lifetime: None,
            timeout: Duration::from_millis(DEFAULT_TIMEOUT_MS.into()),
            retries: false,
            retention: None,
        })
    }

    /// Returns the name of this robot.
    pub fn name(&self) -> &Name {
        &self.inner.place.robot
    }

    /// Returns the name of the fleet.
    pub fn fleet(&self) -> &Name {
        &self.inner.place.fleet
    }

    /// Returns the underlying Zenoh session, for features of Zenoh that this API does not cover. If the program uses a
    /// router, urgent and bulk messages have separate sessions.
    pub fn zenoh(&self) -> &Session {
        &self.inner.session
    }

    /// Returns a handle that publishes, sends, requests and streams with `urgency`.
    ///
    /// ```no_run
    /// # async fn stop(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.with_urgency(rect::Urgency::Urgent).publish("stop", "").await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn with_urgency(&self, urgency: Urgency) -> Self {
        Self {
            urgency,
            ..self.clone()
        }
    }

    /// Returns a handle whose messages overtake all messages that are not urgent.
    #[must_use]
    pub fn urgent(&self) -> Self {
        self.with_urgency(Urgency::Urgent)
    }

    /// Returns a handle whose messages are overtaken by all messages that are not bulk.
    #[must_use]
    pub fn bulk(&self) -> Self {
        self.with_urgency(Urgency::Bulk)
    }

    /// Returns a handle whose requests wait for replies for that time. Default: 10 s.
    ///
    /// ```no_run
    /// # async fn request(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let patient = robot.with_timeout(std::time::Duration::from_secs(60));
    /// let reply = patient.request::<rect::Payload>("wombat-2", "map", "").await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn with_timeout(&self, timeout: Duration) -> Self {
        Self {
            timeout,
            ..self.clone()
        }
    }

    /// Returns a handle whose [`request`](Self::request) is repeated while the link or a router is interrupted, and is carried out at
    /// most once. For requests that must not be carried out twice, such as "grab".
    ///
    /// The request names the run of the program that serves the topic. That run carries it out once, and repeats its first reply. A
    /// program that was restarted refuses it: the error is [`Error::Interrupted`](crate::Error::Interrupted), and the request was
    /// carried out at most once, before the restart. The timeout is at most 10 minutes. The service keeps its replies to the last 64
    /// such requests of this program, at most 1 MB in all, until 60 s and the longest timeout have passed since the last one.
    /// A service of stock Zenoh is asked once.
    ///
    /// ```no_run
    /// # async fn grab(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let reply = robot.retrying().request::<String>("wombat-2", "grab", rect::Json(3)).await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn retrying(&self) -> Self {
        Self {
            retries: true,
            ..self.clone()
        }
    }

    /// Returns a handle whose messages expire: they are dropped rather than delivered later than this after they were sent. For
    /// commands such as steering, of which an old one is worse than none.
    ///
    /// Such a message never waits where another one would: a link or queue without room drops it. A receiver drops it if it was
    /// on the way for longer, or has waited for longer in the receive queue; [`Counters::expired`](crate::Counters) counts it there.
    /// The time on the way is measured against the fastest message of this program and topic, so the bound is the lifetime and
    /// what that message took. A stock Zenoh program gets a plain message. Requests and streams are not affected.
    ///
    /// ```no_run
    /// # async fn drive(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let steering = robot.expires_after(std::time::Duration::from_millis(200));
    /// steering.send("wombat-2", "drive", rect::Json([0.5, 0.5])).await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn expires_after(&self, lifetime: Duration) -> Self {
        Self {
            lifetime: Some(lifetime),
            ..self.clone()
        }
    }

    /// Returns a handle that encodes the payloads of messages and requests with `codec`; receivers decode them
    /// automatically. Replies, streams and transfers are not affected.
    ///
    /// ```no_run
    /// # async fn publish(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let compressed = robot.with_codec(rect::codec::parse("zstd:9")?);
    /// compressed.publish("log", "a long text").await?;
    /// # Ok(()) }
    /// ```
    #[must_use]
    pub fn with_codec(&self, codec: Arc<dyn Codec>) -> Self {
        Self {
            codec: Some(codec),
            ..self.clone()
        }
    }

    /// Returns a handle that compresses the payloads of messages and requests with zstd and `dictionary`, which makes
    /// small JSON messages much smaller.
    ///
    /// Each receiver fetches the dictionary once. This program serves it until the session ends.
    ///
    /// ```no_run
    /// # async fn publish(robot: rect::Robot) -> Result<(), Box<dyn std::error::Error>> {
    /// let dictionary = rect::Dictionary::read("telemetry.dictionary")?;
    /// let compressed = robot.with_dictionary(dictionary.into())?;
    /// compressed.publish("telemetry", rect::Json([1, 2, 3])).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Dictionary`] if this program shares another dictionary with the same id, and [`Error::Closed`] if the
    /// session is closed.
    pub fn with_dictionary(&self, dictionary: Arc<Dictionary>) -> Result<Self, Error> {
        self.inner.decoder.serve(&dictionary)?;
        Ok(self.with_codec(Arc::new(DictionaryCodec::new(dictionary))))
    }

    /// Returns the urgency of the messages of this handle.
    pub fn urgency(&self) -> Urgency {
        self.urgency
    }

    /// Publishes `value` on `topic` to every subscriber. Waits while the queue of the link is full.
    ///
    /// ```no_run
    /// # async fn publish(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.publish("arm/angle", rect::Json(12.5)).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the topic is invalid, [`Error::Payload`] if the value cannot be serialized, [`Error::Codec`] if
    /// the codec of this handle does not support it, and [`Error::Closed`] if the session is closed. A handle that
    /// [retains](Self::retained): [`Error::NotRetained`].
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the message may still be published: another thread may be about to
    /// send it.
    pub async fn publish(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<(), Error> {
        let (topic, payload) = (valid(topic)?, self.payload(value)?);
        match self.retention {
            Some(retention) => self.retain(retention, topic, payload).await,
            None => self.send_to(topic, None, payload).await,
        }
    }

    /// Sends `value` on `topic` to one robot only.
    ///
    /// Nothing confirms that a program of the robot has received it; use [`request`](Self::request) if a reply is needed. The
    /// first message to a robot that is not reachable waits for up to half a second, since its router may just be discovered.
    /// Later ones do not wait.
    ///
    /// ```no_run
    /// # async fn send(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.send("wombat-2", "grab", rect::Json(3)).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the errors of [`publish`](Self::publish), [`Error::Name`] if `robot` is not a valid name, and
    /// [`Error::NotReachable`] if it is not reachable now. A program that sends to a robot which comes and goes ignores that
    /// error, and one that has just started waits first ([`wait_for_peer`](Self::wait_for_peer)).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the message may still be published: another thread may be about to
    /// send it.
    pub async fn send(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<(), Error> {
        let recipient = Some(valid(robot)?);
        self.send_to(valid(topic)?, recipient, self.payload(value)?)
            .await
    }

    /// Returns whether the session is closed.
    pub fn is_closed(&self) -> bool {
        self.inner.session.is_closed()
    }

    /// Closes the session and everything that belongs to it, even if other clones of this handle exist.
    ///
    /// # Errors
    /// [`Error::Zenoh`] if Zenoh cannot close the session.
    ///
    /// # Cancel safety
    /// If the future is dropped, the session may be closed or not. Call it again.
    pub async fn close(&self) -> Result<(), Error> {
        self.flush_log().await;
        let closed = self.inner.urgency_sessions.close().await;
        closed.map_err(Error::zenoh("cannot close the session"))
    }

    /// Returns the name of this program; empty if it has none.
    pub(super) fn program_name(&self) -> String {
        let program = self.inner.program.driver().program().name.clone();
        program.map(|name| name.to_string()).unwrap_or_default()
    }

    pub(super) fn payload(&self, value: impl ToPayload) -> Result<Payload, Error> {
        let payload = value.into_payload()?;
        let payload = match &self.codec {
            Some(codec) => codec.encode(&payload)?,
            None => payload,
        };
        Ok(payload.sendable()?)
    }

    /// Publishes a message that is not retained.
    pub(super) async fn send_plain(&self, topic: Topic, payload: Payload) -> Result<(), Error> {
        self.send_to(topic, None, payload).await
    }

    pub(super) fn with_retention(&self, retention: Retention) -> Self {
        Self {
            retention: Some(retention),
            ..self.clone()
        }
    }

    pub(super) fn retention(&self) -> Option<Retention> {
        self.retention
    }

    async fn send_to(
        &self,
        topic: Topic,
        recipient: Option<Name>,
        payload: Payload,
    ) -> Result<(), Error> {
        let called = self.lifetime.map(|_| Instant::now());
        let other = recipient.as_ref().filter(|robot| *robot != self.name());
        if let Some(robot) = other {
            let inner = &self.inner;
            let observe =
                || async { Recipients::observe(&inner.session, &inner.place, &inner.runtime) };
            let recipients = inner.recipients.get_or_try_init(observe);
            recipients.await?.check(robot).await?;
        }
        let key = self.publication_key(topic, recipient);
        let publication = self.publication(key).await?;
        // The first message of an urgency waits for its session, and the first one to a robot for its token.
        let waited = called.map_or(Duration::ZERO, |called| called.elapsed());
        self.put(&publication, payload, waited)?.done().await
    }

    pub(super) fn publication_key(&self, topic: Topic, recipient: Option<Name>) -> PublicationKey {
        PublicationKey {
            topic,
            recipient,
            urgency: self.urgency,
            expires: self.lifetime.is_some(),
        }
    }

    /// Publishes a payload that has waited for that time.
    pub(super) fn put(
        &self,
        publication: &Arc<Publication>,
        payload: Payload,
        waited: Duration,
    ) -> Result<Put, Error> {
        let lifetime = self.lifetime.map(|all| all.saturating_sub(waited));
        if lifetime.is_some_and(|rest| rest.is_zero()) {
            self.inner.counting.on_expired(0);
            return Ok(Put::Done);
        }
        publication.put(payload, None, lifetime, &self.inner.runtime)
    }

    /// Publishes a message of a recording again, on its own topic or another one, with its urgency and to its recipient. Receivers
    /// can tell it from live messages by [`Message::replayed`](crate::Message::replayed). If its topic was retained, the value is retained
    /// again, in memory, or the topic is forgotten again.
    ///
    /// # Errors
    /// Returns the errors of [`publish`](Self::publish), [`Error::Name`] if the recipient is not a valid name, and
    /// [`Error::NotRetained`] if the value of a retained topic is not kept.
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the message may still be published: another thread may be about to
    /// send it.
    #[cfg(feature = "recording")]
    pub async fn replay(&self, topic: Topic, entry: rect_recording::Entry) -> Result<(), Error> {
        use rect_recording::RetainedKind;
        let sent_ms = u64::try_from(entry.sent.as_millis()).unwrap_or(0);
        if let Some(kind) = entry.retained {
            let value = match kind {
                RetainedKind::Forgotten => None,
                RetainedKind::Value | RetainedKind::Repeated => Some(entry.payload.sendable()?),
            };
            let robot = self.with_urgency(entry.urgency);
            return robot.replay_retained(topic, value, sent_ms).await;
        }
        let recipient = entry.recipient.as_deref().map(Name::new).transpose()?;
        let key = PublicationKey {
            topic,
            recipient,
            urgency: entry.urgency,
            expires: false,
        };
        let publication = self.publication(key).await?;
        let payload = entry.payload.sendable()?;
        let put = publication.put(payload, Some(sent_ms), None, &self.inner.runtime)?;
        put.done().await
    }

    pub(super) async fn publication(&self, key: PublicationKey) -> Result<Arc<Publication>, Error> {
        if let Some(cached) = self.publications().get(&key) {
            return Ok(cached.clone());
        }
        self.inner.warnings.on_topic(key.topic.as_str());
        let session = self.inner.urgency_sessions.of(key.urgency).await;
        let mut publications = self.publications();
        // Another task may have declared it in the meantime.
        if let Some(cached) = publications.get(&key) {
            return Ok(cached.clone());
        }
        let zenoh_key = key.key(&self.inner.place);
        let counting = self.inner.counting.clone();
        let publication = Publication::declare(session, zenoh_key, key.qos(), counting)?;
        let publication = Arc::new(publication);
        let removed = publications.add(key, publication.clone());
        drop(publications);
        drop(removed);
        Ok(publication)
    }

    fn publications(&self) -> MutexGuard<'_, Declarations<PublicationKey, Publication>> {
        let publications = self.inner.publications.lock();
        publications.unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the querier of a key, and declares it if necessary. `session` is that of this handle's urgency.
    pub(super) fn querier(&self, session: &Session, key: &str) -> Result<Arc<Querier>, Error> {
        let name = (self.urgency, key.to_owned());
        if let Some(cached) = self.queriers().get(&name) {
            return Ok(cached.clone());
        }
        let querier = Arc::new(Querier::declare(session, key.to_owned())?);
        // Another task may have declared one in the meantime; either will do.
        let removed = self.queriers().add(name, querier.clone());
        drop(removed);
        Ok(querier)
    }

    fn queriers(&self) -> MutexGuard<'_, Declarations<(Urgency, String), Querier>> {
        let queriers = self.inner.queriers.lock();
        queriers.unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for Robot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let place = &self.inner.place;
        write!(f, "Robot({}/{})", place.fleet, place.robot)
    }
}

//! Owns receiving: the messages of a pattern, one after another, for a callback, or just the next one.
use std::{
    any::Any,
    fmt,
    panic::{catch_unwind, AssertUnwindSafe},
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use futures_core::Stream;
use tokio::task::JoinHandle;
use zenoh::{bytes::ZBytes, sample::Sample, Wait};

use super::{
    decoder::Decoder,
    inbox::{Filling, Inbox},
    robot::Robot,
    state::Known,
};
use crate::{
    core::{
        encoding::Encoding,
        gaps::Tally,
        key::NoMessage,
        message::{Delivered, Inbound, Message},
        name::Name,
        payload::Payload,
        queue::{Queue, WhenFull, DEFAULT_CAPACITY},
        topic::Pattern,
    },
    error::Error,
};

/// How messages wait for the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Receiving {
    /// How many may wait; default 256.
    pub capacity: usize,
    /// What happens to more; default: the oldest is dropped.
    pub when_full: WhenFull,
}

impl Default for Receiving {
    fn default() -> Self {
        Self {
            capacity: DEFAULT_CAPACITY,
            when_full: WhenFull::default(),
        }
    }
}

/// The messages of a pattern, as they come. It ends when it is dropped, or the session is closed.
pub struct Subscriber {
    inbox: Arc<Inbox<Message>>,
    inbound: Arc<Mutex<Inbound>>,
    decoder: Arc<Decoder>,
    /// In a lock only so that it may be shared: it is never locked.
    next: Mutex<Option<Next>>,
    _declared: Declared,
}

type Next = Pin<Box<dyn std::future::Future<Output = Option<Message>> + Send>>;
type Declared = [zenoh::pubsub::Subscriber<()>; 2];

/// A callback that is called for each message, until this is dropped.
#[derive(Debug)]
pub struct Subscription {
    task: JoinHandle<()>,
}

impl Robot {
    /// The messages of a pattern, `<robot>/<topic>` with wildcards: what those robots say to all, and to this one alone.
    ///
    /// # Errors
    /// [`Error::Topic`]; [`Error::Zenoh`] when the session is closed.
    pub async fn subscribe<P: TryInto<Pattern>>(&self, pattern: P) -> Result<Subscriber, Error>
    where
        Error: From<P::Error>,
    {
        self.subscribe_with(pattern, Receiving::default()).await
    }

    /// The same, with a say in how messages wait.
    ///
    /// # Errors
    /// As [`subscribe`](Self::subscribe).
    pub async fn subscribe_with<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        receiving: Receiving,
    ) -> Result<Subscriber, Error>
    where
        Error: From<P::Error>,
    {
        self.subscribed(&pattern.try_into()?, receiving)
    }

    fn subscribed(&self, pattern: &Pattern, receiving: Receiving) -> Result<Subscriber, Error> {
        let place = &self.inner.place;
        let inbox = Inbox::new(Queue::new(receiving.capacity, receiving.when_full));
        let inbound = Arc::new(Mutex::new(Inbound::new(place.clone())));
        let [all, mine] = place.subscriptions(pattern);
        let declare = |key: String, directed: bool| {
            let (filling, inbound) = (Filling::new(&inbox), inbound.clone());
            let counting = self.inner.counting.clone();
            let links = self.inner.known.as_ref().map(Known::links);
            let on_sample = move |sample: Sample| {
                let mut message = match on_sample(&inbound, &sample, directed) {
                    Ok(message) => message,
                    Err(NoMessage::Elsewhere) => return,
                    Err(NoMessage::InvalidTopic { .. }) => return counting.on_rejected(),
                };
                if let Some(links) = &links {
                    let links = links.lock().unwrap_or_else(PoisonError::into_inner);
                    message.over = links.method(&message.from).map(str::to_owned);
                }
                counting.on_received(message.payload.bytes.len(), message.missed);
                filling.push(message);
            };
            let declared = self
                .inner
                .session
                .declare_subscriber(key)
                .callback(on_sample);
            declared
                .wait()
                .map_err(Error::zenoh("the subscription is refused"))
        };
        let declared = [declare(all, false)?, declare(mine, true)?];
        Ok(Subscriber {
            inbox,
            inbound,
            decoder: self.inner.decoder.clone(),
            next: Mutex::default(),
            _declared: declared,
        })
    }

    /// Calls `callback` for each message of a pattern, one after another, until what this returns is dropped.
    /// A callback that panics is reported, and called again for the next message.
    ///
    /// # Errors
    /// As [`subscribe`](Self::subscribe).
    pub async fn on_message<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        mut callback: impl FnMut(Message) + Send + 'static,
    ) -> Result<Subscription, Error>
    where
        Error: From<P::Error>,
    {
        let subscriber = self.subscribe(pattern).await?;
        let task = self.inner.runtime.spawn(async move {
            while let Some(message) = subscriber.recv().await {
                let topic = message.topic.clone();
                called(topic.as_str(), || callback(message));
            }
        });
        Ok(Subscription::of(task))
    }

    /// The next message of `robot` about `topic`, to all or to this one alone, that is sent from now on.
    ///
    /// # Errors
    /// [`Error::TimedOut`]: there was none; [`Error::Name`], [`Error::Topic`].
    pub async fn listen<N: TryInto<Name>>(
        &self,
        robot: N,
        topic: &str,
        timeout: Duration,
    ) -> Result<Message, Error>
    where
        Error: From<N::Error>,
    {
        let pattern = Pattern::of(Some(robot.try_into()?), topic)?;
        let what = format!("message {pattern}");
        let subscriber = self.subscribed(&pattern, Receiving::default())?;
        match tokio::time::timeout(timeout, subscriber.recv()).await {
            Ok(message) => message.ok_or(Error::Closed),
            Err(_) => Err(Error::TimedOut {
                what,
                after: timeout,
            }),
        }
    }
}

impl Subscriber {
    /// The next message, once there is one; `None`: the session was closed. The first message that is packed with a
    /// dictionary waits until that has come; who drops this future meanwhile loses that message.
    pub async fn recv(&self) -> Option<Message> {
        decoded(&self.inbox, &self.decoder).await
    }

    /// The next message, if there is one.
    pub fn try_recv(&self) -> Option<Message> {
        let mut message = self.inbox.try_pop()?;
        self.decoder.message_now(&mut message);
        Some(message)
    }

    /// Nothing comes any more; what waits can still be taken.
    pub fn close(&self) {
        self.inbox.close();
    }

    /// How many were dropped because the program did not take them in time.
    pub fn dropped(&self) -> u64 {
        self.inbox.dropped()
    }

    /// How many came of each robot, and how many of its did not.
    pub fn tallies(&self) -> Vec<(Name, Tally)> {
        let inbound = lock(&self.inbound);
        inbound
            .tallies()
            .map(|(n, tally)| (n.clone(), tally))
            .collect()
    }
}

async fn decoded(inbox: &Inbox<Message>, decoder: &Decoder) -> Option<Message> {
    let mut message = inbox.pop().await?;
    decoder.message(&mut message).await;
    Some(message)
}

impl Stream for Subscriber {
    type Item = Message;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Message>> {
        let (inbox, decoder) = (self.inbox.clone(), self.decoder.clone());
        let next = self.next.get_mut().unwrap_or_else(PoisonError::into_inner);
        let waiting =
            next.get_or_insert_with(|| Box::pin(async move { decoded(&inbox, &decoder).await }));
        let polled = waiting.as_mut().poll(context);
        if polled.is_ready() {
            *next = None;
        }
        polled
    }
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        // Before Zenoh's threads are waited for: one may wait for room.
        self.close();
    }
}

impl Subscription {
    pub(super) fn of(task: JoinHandle<()>) -> Self {
        Self { task }
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl fmt::Debug for Subscriber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let dropped = self.dropped();
        f.debug_struct("Subscriber")
            .field("dropped", &dropped)
            .finish_non_exhaustive()
    }
}

fn on_sample(
    inbound: &Mutex<Inbound>,
    sample: &Sample,
    directed: bool,
) -> Result<Message, NoMessage> {
    let attachment = sample.attachment().map(ZBytes::to_bytes);
    lock(inbound).on_delivered(Delivered {
        key: sample.key_expr().as_str(),
        payload: payload(sample.payload(), sample.encoding()),
        attachment: attachment.as_deref(),
        priority: sample.priority() as u8,
        directed,
    })
}

/// A payload as Zenoh has it.
pub(super) fn payload(bytes: &ZBytes, encoding: &zenoh::bytes::Encoding) -> Payload {
    let bytes = Bytes::from(bytes.to_bytes().into_owned());
    Payload::new(bytes, Encoding::new(encoding))
}

fn lock(inbound: &Mutex<Inbound>) -> std::sync::MutexGuard<'_, Inbound> {
    inbound.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Calls a callback; if it panics, that is reported, and the next call is made all the same.
pub(crate) fn called(about: &str, callback: impl FnOnce()) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(callback)) {
        let said = said(&*panic);
        tracing::error!("the callback for {about} panicked: {said}");
    }
}

fn said(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("(no text)")
}

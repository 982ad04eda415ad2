//! Implements subscriptions: with a receive queue ([`Subscriber`]), with a callback ([`Subscription`]), or for one
//! message.
use std::{
    any::Any,
    fmt,
    panic::{catch_unwind, AssertUnwindSafe},
    pin::Pin,
    sync::{Arc, Mutex},
    task::{Context, Poll},
    time::{Duration, Instant},
};

use futures_core::Stream;
#[cfg(feature = "recording")]
use rect_core::name::key::Selected;
use rect_core::{
    message::{
        counters::AtomicCounters,
        gaps::SenderCounts,
        payload::{FromPayload, Payload, PayloadError},
        queue::{Queue, WhenFull, DEFAULT_CAPACITY},
        throttled::Wish,
        Delivery, Inbound, Message, Undelivered,
    },
    name::{topic::Pattern, Name},
    session::name_check::Used,
};
use tokio::task::JoinHandle;
use zenoh::{
    bytes::ZBytes,
    liveliness::LivelinessToken,
    sample::{Sample, SampleKind},
    Wait,
};

use super::{
    convert::payload,
    decoder::Decoder,
    next_item::NextItem,
    receive_queue::{QueueWriter, ReceiveQueue},
    robot::Robot,
    router_links::RouterLinks,
    shared::lock,
    state::{Receiver, Reception},
    warnings::Warnings,
};
use crate::error::{valid, Error};

/// Settings of the receive queue, which holds messages or frames until the program reads them.
///
/// ```
/// use rect::{QueueOptions, WhenFull};
/// let every_message = QueueOptions { capacity: 1000, when_full: WhenFull::Block };
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueOptions {
    /// The largest number of waiting messages or frames; default: 256. A capacity of 0 counts as 1.
    pub capacity: usize,
    /// The rule for a message or frame that arrives when the queue is full; default: the oldest one is dropped.
    pub when_full: WhenFull,
}

impl Default for QueueOptions {
    fn default() -> Self {
        Self {
            capacity: DEFAULT_CAPACITY,
            when_full: WhenFull::default(),
        }
    }
}

/// Settings of a subscription. [`QueueOptions`] become such settings by themselves.
///
/// ```
/// use rect::SubscribeOptions;
/// let twice_a_second = SubscribeOptions { max_hz: Some(2.0), ..SubscribeOptions::default() };
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SubscribeOptions {
    /// The settings of the receive queue.
    pub queue: QueueOptions,
    /// The largest number of messages of each topic per second, 0.01 to 1000; default: all. The newest one wins. The router of the
    /// robot that publishes leaves out the others, so that they cost nothing on the air; they count as [`Message::skipped`], and not
    /// as missed. Messages that are sent to this robot alone, and retained ones, arrive as they are sent.
    pub max_hz: Option<f64>,
    /// Whether to receive only messages whose value differs from the last one; default: no.
    pub on_change: bool,
}

impl From<QueueOptions> for SubscribeOptions {
    fn from(queue: QueueOptions) -> Self {
        Self {
            queue,
            ..Self::default()
        }
    }
}

/// Receives the messages that match a pattern; created by [`Robot::subscribe`].
///
/// `T` is the type of the values. It also implements [`futures_core::Stream`]. Dropping it ends the subscription.
pub struct Subscriber<T: FromPayload = Payload> {
    reading: Reading,
    inbound: Arc<Mutex<Inbound>>,
    next: NextItem<Message<T::Value>>,
    _declared: Vec<zenoh::pubsub::Subscriber<()>>,
    /// The wish of a throttled subscription.
    _wish: Option<LivelinessToken>,
    /// The retained messages.
    _reception: Reception,
}

/// The parts of a subscriber that a message passes through when the program reads it.
#[derive(Clone)]
struct Reading {
    queue: Arc<ReceiveQueue<Message>>,
    decoder: Arc<Decoder>,
    counting: Arc<AtomicCounters>,
    warnings: Arc<Warnings>,
}

/// A subscription with a callback; created by [`Robot::on_message`] and [`Robot::on_event`]. Dropping it ends the
/// subscription.
#[derive(Debug)]
pub struct Subscription {
    task: JoinHandle<()>,
}

impl Robot {
    /// Subscribes to the messages that match `pattern`, which is `<robot>/<topic>` with wildcards: those that the robots
    /// publish, and those that they send to this robot only.
    ///
    /// `T` is the type of the values: a type that serde deserializes, or [`Payload`] for payloads as they are. A message whose
    /// value does not fit is delivered with the problem as its [`value`](Message::value). It is counted in
    /// [`Counters::problems`](crate::Counters), and the first one of each sender and topic is logged as a warning. Fields that
    /// the type does not have are ignored.
    ///
    /// ```no_run
    /// # async fn subscribe(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let angles = robot.subscribe::<f64>("*/arm/angle").await?;
    /// while let Some(message) = angles.next().await {
    ///     match message.value {
    ///         Ok(angle) => println!("{}: {angle}", message.sender),
    ///         Err(problem) => println!("{}: {problem}", message.sender),
    ///     }
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the pattern is invalid, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn subscribe<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
    ) -> Result<Subscriber<T>, Error> {
        self.subscribe_with(pattern, SubscribeOptions::default())
            .await
    }

    /// Subscribes to the messages that match `pattern`, with other settings: of the receive queue, or for fewer messages.
    ///
    /// ```no_run
    /// # async fn subscribe(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let twice_a_second = rect::SubscribeOptions { max_hz: Some(2.0), ..Default::default() };
    /// let poses = robot.subscribe_with::<(f64, f64)>("wombat-2/pose", twice_a_second).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`subscribe`](Self::subscribe), and [`Error::Option`] if a rate is out of range.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn subscribe_with<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        options: impl Into<SubscribeOptions>,
    ) -> Result<Subscriber<T>, Error> {
        self.subscribed(&valid(pattern)?, options.into())
    }

    fn subscribed<T: FromPayload>(
        &self,
        pattern: &Pattern,
        options: SubscribeOptions,
    ) -> Result<Subscriber<T>, Error> {
        let wish = Wish::new(options.max_hz, options.on_change);
        let wish = wish.map_err(|error| Error::Option {
            option: "max_hz",
            value: error.0.to_string(),
            source: error.into(),
        })?;
        self.inner.warnings.on_topic(pattern.topic());
        self.check_name(Used::Pattern(pattern.clone()));
        let place = self.inner.place.clone();
        let inbound = Inbound::of_pattern(place, pattern, wish, Instant::now());
        self.inbound(inbound, options.queue)
    }

    /// Receives each selected message once.
    #[cfg(feature = "recording")]
    pub(super) fn select<T: FromPayload>(
        &self,
        selected: Vec<Selected>,
        queue: QueueOptions,
    ) -> Result<Subscriber<T>, Error> {
        let inbound = Inbound::new(self.inner.place.clone(), selected, Instant::now());
        self.inbound(inbound, queue)
    }

    fn inbound<T: FromPayload>(
        &self,
        mut inbound: Inbound,
        queue: QueueOptions,
    ) -> Result<Subscriber<T>, Error> {
        let queue = ReceiveQueue::new(Queue::new(queue.capacity, queue.when_full));
        inbound.follow(self.inner.state.following()?);
        let (receiving, keys) = (inbound.selected().to_vec(), inbound.keys());
        let token = inbound.token().map(str::to_owned);
        let inbound = Arc::new(Mutex::new(inbound));
        let receiver = Arc::new(Receiver {
            inbound: inbound.clone(),
            queue: Arc::downgrade(&queue),
            counting: self.inner.counting.clone(),
            links: self.inner.router_links.as_ref().map(RouterLinks::table),
        });
        let declare = |(subscription, key): (usize, String)| {
            let (writer, receiver) = (QueueWriter::new(&queue), receiver.clone());
            let on_sample = move |sample: Sample| {
                let counting = &receiver.counting;
                let mut message = match on_sample(&receiver.inbound, &sample, subscription) {
                    Ok(message) => message,
                    Err(Undelivered::Expired { missed }) => return counting.on_expired(missed),
                    Err(Undelivered::NotSelected) => return,
                    Err(Undelivered::InvalidTopic) => return counting.on_rejected(),
                };
                receiver.complete(&mut message);
                writer.push(message);
            };
            let declared = self
                .inner
                .session
                .declare_subscriber(key)
                .callback(on_sample);
            declared
                .wait()
                .map_err(Error::zenoh("cannot declare the subscriber"))
        };
        let declared = keys.into_iter().enumerate().map(declare);
        let declared = declared.collect::<Result<_, _>>()?;
        let declare = |key| {
            let token = self.inner.session.liveliness().declare_token(key).wait();
            token.map_err(Error::zenoh("cannot declare the subscriber"))
        };
        Ok(Subscriber {
            _declared: declared,
            _wish: token.map(declare).transpose()?,
            // The subscriptions precede it, so that no change is missed between them.
            _reception: self.inner.state.receive(&receiving, receiver)?,
            reading: Reading {
                queue,
                decoder: self.inner.decoder.clone(),
                counting: self.inner.counting.clone(),
                warnings: self.inner.warnings.clone(),
            },
            inbound,
            next: NextItem::default(),
        })
    }

    /// Calls `callback` for each message that matches `pattern`, one at a time, until the returned subscription is dropped.
    ///
    /// The callback runs on the runtime of the session and must not block; [`blocking`](crate::blocking) callbacks may. If
    /// the callback panics, the panic is logged and the callback is called again for the next message.
    ///
    /// ```no_run
    /// # async fn subscribe(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let _subscription = robot.on_message::<f64>("*/battery", |message| println!("{}: {:?}", message.sender, message.value)).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`subscribe`](Self::subscribe).
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn on_message<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        mut callback: impl FnMut(Message<T::Value>) + Send + 'static,
    ) -> Result<Subscription, Error> {
        let subscriber = self.subscribe::<T>(pattern).await?;
        let task = self.inner.runtime.spawn(async move {
            while let Some(message) = subscriber.next().await {
                let topic = message.topic.clone();
                call(topic.as_str(), || callback(message));
            }
        });
        Ok(Subscription::of(task))
    }

    /// Waits for the next message that matches `pattern`, published or sent to this robot only. Messages that were sent before the
    /// call are not received.
    ///
    /// ```no_run
    /// # async fn wait(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let timeout = std::time::Duration::from_secs(10);
    /// let pose = robot.wait_for_message::<(f64, f64)>("wombat-2/pose", timeout).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::TimedOut`] if no message arrives within `timeout`; [`Error::Topic`] if the pattern is invalid;
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future ends the subscription. A message that has arrived is lost with it.
    pub async fn wait_for_message<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        timeout: Duration,
    ) -> Result<Message<T::Value>, Error> {
        let pattern = valid(pattern)?;
        let expected = format!("message {pattern}");
        let subscriber = self.subscribed::<T>(&pattern, SubscribeOptions::default())?;
        match tokio::time::timeout(timeout, subscriber.next()).await {
            Ok(message) => message.ok_or(Error::Closed),
            Err(_) => Err(Error::TimedOut { expected, timeout }),
        }
    }
}

impl<T: FromPayload> Subscriber<T> {
    /// Waits for the next message; returns `None` once the session or the subscriber is closed.
    ///
    /// If a message is compressed with a dictionary that is not known yet, the call also waits for the dictionary, at
    /// most 5 s.
    ///
    /// # Cancel safety
    /// If the future is dropped, no message is lost: the next call returns it, and fetches its dictionary again. The same
    /// holds for the [`Stream`], which keeps its wait.
    pub async fn next(&self) -> Option<Message<T::Value>> {
        self.reading.next::<T>().await
    }

    /// Returns the next message if one is queued. If the message is compressed with a dictionary that is not known yet,
    /// its payload stays encoded, and [`Message::problem`] gives the reason.
    pub fn try_next(&self) -> Option<Message<T::Value>> {
        let reading = &self.reading;
        let mut message = reading.queue.try_pop()?;
        while has_expired(&message) {
            reading.counting.on_expired(0);
            message = reading.queue.try_pop()?;
        }
        reading.decoder.decode_message_now(&mut message);
        Some(reading.typed::<T>(message))
    }

    /// Stops receiving. Messages that are already queued can still be read.
    pub fn close(&self) {
        self.reading.queue.close();
    }

    /// Returns the number of messages that were dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.reading.queue.dropped()
    }

    /// Returns how many messages of each robot were received and missed.
    pub fn counts_by_sender(&self) -> Vec<(Name, SenderCounts)> {
        let inbound = lock(&self.inbound);
        inbound
            .counts_by_sender()
            .map(|(name, counts)| (name.clone(), counts))
            .collect()
    }
}

/// Returns whether the message has expired by now. The time is only asked for if it matters.
fn has_expired(message: &Message) -> bool {
    message.expires_at.is_some() && message.is_expired(Instant::now())
}

impl Reading {
    async fn next<T: FromPayload>(&self) -> Option<Message<T::Value>> {
        loop {
            // Decoding may wait for a dictionary, and the program may drop the future meanwhile.
            let mut popped = self.queue.pop_guarded().await?;
            let message = popped.item()?;
            if !has_expired(message) {
                self.decoder.decode_message(message).await;
            }
            let message = popped.take()?;
            if !has_expired(&message) {
                return Some(self.typed::<T>(message));
            }
            self.counting.on_expired(0);
        }
    }

    /// Converts the value of a decoded message.
    fn typed<T: FromPayload>(&self, message: Message) -> Message<T::Value> {
        let message = message.typed::<T>();
        let forgotten = |problem: &&PayloadError| matches!(problem, PayloadError::Forgotten);
        if let Some(problem) = message.problem().filter(|problem| !forgotten(problem)) {
            let Message { sender, topic, .. } = &message;
            self.warnings.on_problem(sender, topic, problem);
        }
        message
    }
}

impl<T: FromPayload> Stream for Subscriber<T> {
    type Item = Message<T::Value>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let Self { reading, next, .. } = &mut *self;
        next.poll(context, || {
            let reading = reading.clone();
            async move { reading.next::<T>().await }
        })
    }
}

impl<T: FromPayload> Drop for Subscriber<T> {
    fn drop(&mut self) {
        // Closed before undeclaring, which waits for Zenoh's threads: one of them may wait for room in the queue.
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

impl<T: FromPayload> fmt::Debug for Subscriber<T> {
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
    subscription: usize,
) -> Result<Message, Undelivered> {
    let attachment = sample.attachment().map(ZBytes::to_bytes);
    let delivery = Delivery {
        key: sample.key_expr().as_str(),
        payload: payload(sample.payload(), sample.encoding()),
        attachment: attachment.as_deref(),
        priority: sample.priority() as u8,
        is_deleted: sample.kind() == SampleKind::Delete,
        subscription,
    };
    lock(inbound).on_delivery(delivery, Instant::now)
}

/// Calls a callback for `subject`, a topic or "events", and logs its panic if there is one.
pub(crate) fn call(subject: &str, callback: impl FnOnce()) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(callback)) {
        let text = panic_text(&*panic);
        tracing::error!("the callback for {subject} panicked: {text}");
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("(no text)")
}

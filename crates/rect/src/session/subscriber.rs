//! Implements subscriptions: with a receive queue ([`Subscriber`]), with a callback ([`Subscription`]), or for one
//! message.
use std::{
    any::Any,
    fmt,
    panic::{catch_unwind, AssertUnwindSafe},
    pin::Pin,
    sync::{Arc, Mutex, PoisonError},
    task::{Context, Poll},
    time::{Duration, Instant},
};

use futures_core::Stream;
use rect_core::{
    message::{
        counters::AtomicCounters,
        gaps::SenderCounts,
        queue::{Queue, WhenFull, DEFAULT_CAPACITY},
        Delivery, Inbound, Message, Undelivered,
    },
    name::{key::Selected, topic::Pattern, Name},
};
use tokio::task::JoinHandle;
use zenoh::{bytes::ZBytes, sample::Sample, Wait};

use super::{
    convert::payload,
    decoder::Decoder,
    receive_queue::{QueueWriter, ReceiveQueue},
    robot::Robot,
    router_links::RouterLinks,
};
use crate::error::Error;

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

/// Receives the messages that match a pattern; created by [`Robot::subscribe`].
///
/// It also implements [`futures_core::Stream`]. Dropping it ends the subscription.
pub struct Subscriber {
    queue: Arc<ReceiveQueue<Message>>,
    inbound: Arc<Mutex<Inbound>>,
    decoder: Arc<Decoder>,
    counting: Arc<AtomicCounters>,
    /// The pending read of the [`Stream`]. The mutex only makes the type `Sync`; it is never locked.
    next: Mutex<Option<Next>>,
    _declared: Vec<zenoh::pubsub::Subscriber<()>>,
}

type Next = Pin<Box<dyn std::future::Future<Output = Option<Message>> + Send>>;

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
    /// ```no_run
    /// # async fn subscribe(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let angles = robot.subscribe("*/arm/angle").await?;
    /// while let Some(message) = angles.next().await {
    ///     let angle: f64 = message.payload.value()?;
    ///     println!("{}: {angle}", message.sender);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the pattern is invalid, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn subscribe<P: TryInto<Pattern>>(&self, pattern: P) -> Result<Subscriber, Error>
    where
        Error: From<P::Error>,
    {
        self.subscribe_with(pattern, QueueOptions::default()).await
    }

    /// Subscribes to the messages that match `pattern`, with other settings of the receive queue.
    ///
    /// # Errors
    /// Returns the same errors as [`subscribe`](Self::subscribe).
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn subscribe_with<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        queue: QueueOptions,
    ) -> Result<Subscriber, Error>
    where
        Error: From<P::Error>,
    {
        self.subscribed(&pattern.try_into()?, queue)
    }

    fn subscribed(&self, pattern: &Pattern, queue: QueueOptions) -> Result<Subscriber, Error> {
        self.select(self.inner.place.subscriptions(pattern).into(), queue)
    }

    /// Receives each selected message once.
    pub(super) fn select(
        &self,
        selected: Vec<Selected>,
        queue: QueueOptions,
    ) -> Result<Subscriber, Error> {
        let place = self.inner.place.clone();
        let queue = ReceiveQueue::new(Queue::new(queue.capacity, queue.when_full));
        let inbound = Inbound::new(place, selected.clone(), Instant::now());
        let inbound = Arc::new(Mutex::new(inbound));
        let declare = |(subscription, Selected { key, .. })| {
            let (writer, inbound) = (QueueWriter::new(&queue), inbound.clone());
            let counting = self.inner.counting.clone();
            let links = self.inner.router_links.as_ref().map(RouterLinks::table);
            let on_sample = move |sample: Sample| {
                let mut message = match on_sample(&inbound, &sample, subscription) {
                    Ok(message) => message,
                    Err(Undelivered::Expired { missed }) => return counting.on_expired(missed),
                    Err(Undelivered::NotSelected) => return,
                    Err(Undelivered::InvalidTopic) => return counting.on_rejected(),
                };
                let links = links.as_ref();
                message.method = links.and_then(|links| links.method(&message.sender));
                counting.on_received(message.payload.bytes.len(), message.missed);
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
        let declared = selected.into_iter().enumerate().map(declare);
        Ok(Subscriber {
            _declared: declared.collect::<Result<_, _>>()?,
            queue,
            inbound,
            decoder: self.inner.decoder.clone(),
            counting: self.inner.counting.clone(),
            next: Mutex::default(),
        })
    }

    /// Calls `callback` for each message that matches `pattern`, one at a time, until the returned subscription is dropped.
    ///
    /// The callback runs on the runtime of the session and must not block; [`blocking`](crate::blocking) callbacks may. If
    /// the callback panics, the panic is logged and the callback is called again for the next message.
    ///
    /// ```no_run
    /// # async fn subscribe(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let _subscription = robot.on_message("*/stop", |message| println!("stopped by {}", message.sender)).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`subscribe`](Self::subscribe).
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
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
    /// let ready = robot.wait_for_message("wombat-2/ready", timeout).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::TimedOut`] if no message arrives within `timeout`; [`Error::Topic`] if the pattern is invalid;
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future ends the subscription. A message that has arrived is lost with it.
    pub async fn wait_for_message<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        timeout: Duration,
    ) -> Result<Message, Error>
    where
        Error: From<P::Error>,
    {
        let pattern = pattern.try_into()?;
        let expected = format!("message {pattern}");
        let subscriber = self.subscribed(&pattern, QueueOptions::default())?;
        match tokio::time::timeout(timeout, subscriber.next()).await {
            Ok(message) => message.ok_or(Error::Closed),
            Err(_) => Err(Error::TimedOut { expected, timeout }),
        }
    }
}

impl Subscriber {
    /// Waits for the next message; returns `None` once the session or the subscriber is closed.
    ///
    /// If a message is compressed with a dictionary that is not known yet, the call also waits for the dictionary, at
    /// most 5 s.
    ///
    /// # Cancel safety
    /// If the future is dropped, no message is lost: the next call returns it, and fetches its dictionary again.
    pub async fn next(&self) -> Option<Message> {
        decoded(&self.queue, &self.decoder, &self.counting).await
    }

    /// Returns the next message if one is queued. If the message is compressed with a dictionary that is not known yet,
    /// its payload stays encoded, and [`Message::problem`] gives the reason.
    pub fn try_next(&self) -> Option<Message> {
        let mut message = self.queue.try_pop()?;
        while has_expired(&message) {
            self.counting.on_expired(0);
            message = self.queue.try_pop()?;
        }
        self.decoder.decode_message_now(&mut message);
        Some(message)
    }

    /// Stops receiving. Messages that are already queued can still be read.
    pub fn close(&self) {
        self.queue.close();
    }

    /// Returns the number of messages that were dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.queue.dropped()
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

async fn decoded(
    queue: &ReceiveQueue<Message>,
    decoder: &Decoder,
    counting: &AtomicCounters,
) -> Option<Message> {
    loop {
        // Decoding may wait for a dictionary, and the program may drop the future meanwhile.
        let mut popped = queue.pop_guarded().await?;
        let message = popped.item()?;
        if !has_expired(message) {
            decoder.decode_message(message).await;
        }
        let message = popped.take()?;
        if !has_expired(&message) {
            return Some(message);
        }
        counting.on_expired(0);
    }
}

impl Stream for Subscriber {
    type Item = Message;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Message>> {
        let (queue, decoder) = (self.queue.clone(), self.decoder.clone());
        let counting = self.counting.clone();
        let next = self.next.get_mut().unwrap_or_else(PoisonError::into_inner);
        let waiting = next.get_or_insert_with(|| {
            Box::pin(async move { decoded(&queue, &decoder, &counting).await })
        });
        let polled = waiting.as_mut().poll(context);
        if polled.is_ready() {
            *next = None;
        }
        polled
    }
}

impl Drop for Subscriber {
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
    subscription: usize,
) -> Result<Message, Undelivered> {
    let attachment = sample.attachment().map(ZBytes::to_bytes);
    let delivery = Delivery {
        key: sample.key_expr().as_str(),
        payload: payload(sample.payload(), sample.encoding()),
        attachment: attachment.as_deref(),
        priority: sample.priority() as u8,
        subscription,
    };
    lock(inbound).on_delivery(delivery, Instant::now)
}

fn lock(inbound: &Mutex<Inbound>) -> std::sync::MutexGuard<'_, Inbound> {
    inbound.lock().unwrap_or_else(PoisonError::into_inner)
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

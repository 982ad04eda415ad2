//! Reports events of robots, links and the router to the program, and returns the program's counters.
use std::{
    fmt,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
};

use futures_core::Stream;
use rect_core::{
    message::{
        counters::Counters,
        queue::{Queue, WhenFull, DEFAULT_CAPACITY},
    },
    registry::{connection::Event, observer::Observer},
};
use tokio::task::JoinHandle;

use super::{
    executor::{Executor, Running},
    next_item::NextItem,
    receive_queue::ReceiveQueue,
    robot::Robot,
    subscriber::{call, Subscription},
};
use crate::error::Error;

/// Receives the [events](Event) of robots, links and the router; created by [`Robot::events`].
///
/// At first, events report the robots and programs that are already reachable and, with a router, the links that are already up.
/// It also implements [`futures_core::Stream`]. Dropping it ends the subscription.
pub struct Events {
    queue: Arc<ReceiveQueue<Event>>,
    next: NextItem<Event>,
    _running: Running<Observer>,
}

impl Robot {
    /// Subscribes to events: robots that become reachable or unreachable, programs that begin or end, links of this robot's router that come up or go
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
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
    pub async fn events(&self) -> Result<Events, Error> {
        let inner = &self.inner;
        let queue = ReceiveQueue::new(Queue::new(DEFAULT_CAPACITY, WhenFull::DropOldest));
        let own = inner.program.driver().program().instance;
        let observer = Observer::new(inner.place.clone(), own, inner.direct);
        let executor = Executor::new(&inner.session, observer, queue.clone());
        Ok(Events {
            queue,
            next: NextItem::default(),
            _running: executor.start(&inner.runtime)?,
        })
    }

    /// Calls `callback` for each of the [`events`](Self::events) until the returned subscription is dropped.
    ///
    /// If the callback panics, the panic is logged and the callback is called again for the next event.
    ///
    /// # Errors
    /// Returns the same errors as [`events`](Self::events).
    ///
    /// # Cancel safety
    /// The call is complete when its future is polled for the first time, which `.await` does.
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
    ///
    /// # Cancel safety
    /// If the future is dropped, no event is lost: the next call returns it. The same holds for the [`Stream`], which keeps its
    /// wait.
    pub async fn next(&self) -> Option<Event> {
        self.queue.pop().await
    }

    /// Stops receiving. Events that are already queued can still be read.
    pub fn close(&self) {
        self.queue.close();
    }
}

impl Stream for Events {
    type Item = Event;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Event>> {
        let Self { queue, next, .. } = &mut *self;
        next.poll(context, || {
            let queue = queue.clone();
            async move { queue.pop().await }
        })
    }
}

impl Drop for Events {
    fn drop(&mut self) {
        self.close();
    }
}

impl fmt::Debug for Events {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Events").finish_non_exhaustive()
    }
}

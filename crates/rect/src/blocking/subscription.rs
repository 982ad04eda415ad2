//! Runs the callbacks of subscriptions, each subscription on a separate thread.
use std::{
    fmt,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
};

use super::Runtime;
use crate::{
    session::{call, Subscriber},
    Error, FromPayload, Message,
};

/// A subscription with a callback; created by [`Robot::on_message`](super::Robot::on_message). Dropping it ends the
/// subscription.
pub struct Subscription {
    is_ended: Arc<AtomicBool>,
    close: Box<dyn Fn() + Send + Sync>,
}

impl Subscription {
    pub(super) fn start<T: FromPayload + 'static>(
        runtime: Arc<Runtime>,
        subscriber: Subscriber<T>,
        mut callback: impl FnMut(Message<T::Value>) + Send + 'static,
    ) -> Result<Self, Error> {
        let subscriber = Arc::new(subscriber);
        let is_ended = Arc::new(AtomicBool::new(false));
        let (of_thread, is_ended_now) = (subscriber.clone(), is_ended.clone());
        let run = move || {
            let on_message = |message: Message<T::Value>| {
                let is_active = !is_ended_now.load(Ordering::Relaxed);
                if is_active {
                    let topic = message.topic.clone();
                    call(topic.as_str(), || callback(message));
                }
                is_active
            };
            runtime.for_each(|| of_thread.next(), on_message);
        };
        let thread = thread::Builder::new().name("rect-callback".into());
        thread.spawn(run).map_err(Error::thread)?;
        Ok(Self {
            is_ended,
            close: Box::new(move || subscriber.close()),
        })
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.is_ended.store(true, Ordering::Relaxed);
        (self.close)();
    }
}

impl fmt::Debug for Subscription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Subscription").finish_non_exhaustive()
    }
}

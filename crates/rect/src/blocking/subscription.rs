//! Runs the callbacks of subscriptions, each subscription on a separate thread.
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
};

use super::Runtime;
use crate::{
    session::{call, Subscriber},
    Error, Message,
};

/// A subscription with a callback; created by [`Robot::on_message`](super::Robot::on_message). Dropping it ends the
/// subscription.
#[derive(Debug)]
pub struct Subscription(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    subscriber: Subscriber,
    is_ended: AtomicBool,
}

impl Subscription {
    pub(super) fn start(
        runtime: Arc<Runtime>,
        subscriber: Subscriber,
        mut callback: impl FnMut(Message) + Send + 'static,
    ) -> Result<Self, Error> {
        let shared = Arc::new(Shared {
            subscriber,
            is_ended: AtomicBool::new(false),
        });
        let of_thread = shared.clone();
        let run = move || {
            let on_message = |message: Message| {
                let is_active = !of_thread.is_ended.load(Ordering::Relaxed);
                if is_active {
                    let topic = message.topic.clone();
                    call(topic.as_str(), || callback(message));
                }
                is_active
            };
            runtime.for_each(|| of_thread.subscriber.next(), on_message);
        };
        let thread = thread::Builder::new().name("rect-callback".into());
        thread.spawn(run).map_err(Error::thread)?;
        Ok(Self(shared))
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        let Self(shared) = self;
        shared.is_ended.store(true, Ordering::Relaxed);
        shared.subscriber.close();
    }
}

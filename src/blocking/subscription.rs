//! Owns callbacks for messages, each on a thread of its own.
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
};

use super::{no_thread, Runtime};
use crate::{
    session::{called, Subscriber},
    Error, Message,
};

/// A callback that is called for each message, until this is dropped.
#[derive(Debug)]
pub struct Subscription(Arc<Called>);

#[derive(Debug)]
struct Called {
    subscriber: Subscriber,
    is_over: AtomicBool,
}

impl Subscription {
    pub(super) fn start(
        runtime: Arc<Runtime>,
        subscriber: Subscriber,
        mut callback: impl FnMut(Message) + Send + 'static,
    ) -> Result<Self, Error> {
        let listening = Arc::new(Called {
            subscriber,
            is_over: AtomicBool::new(false),
        });
        let heard = listening.clone();
        let run = move || {
            let call = |message: Message| {
                let goes_on = !heard.is_over.load(Ordering::Relaxed);
                if goes_on {
                    let topic = message.topic.clone();
                    called(topic.as_str(), || callback(message));
                }
                goes_on
            };
            runtime.for_each(|| heard.subscriber.recv(), call);
        };
        let thread = thread::Builder::new().name("rect-callback".into());
        thread.spawn(run).map_err(no_thread)?;
        Ok(Self(listening))
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        let Self(listening) = self;
        listening.is_over.store(true, Ordering::Relaxed);
        listening.subscriber.close();
    }
}

//! Checks whether the robots are reachable to which a program sends messages.
use std::time::Instant;

use rect_core::{
    name::{key::KeySpace, Name},
    session::recipients::{self, Reachability},
};
use tokio::{runtime::Handle, sync::watch};
use zenoh::Session;

use super::{
    executor::{Executor, Running},
    shared::Sink,
};
use crate::error::Error;

/// The observation of the robots that are reachable, which begins with the first message to one of them.
pub(super) struct Recipients {
    running: Running<recipients::Recipients>,
    news: watch::Receiver<()>,
}

struct News(watch::Sender<()>);

impl Sink<()> for News {
    fn deliver(&self, (): ()) {
        self.0.send_replace(());
    }

    fn end(&self) {
        self.0.send_replace(());
    }
}

impl Recipients {
    pub(super) fn observe(
        session: &Session,
        place: &KeySpace,
        runtime: &Handle,
    ) -> Result<Self, Error> {
        let (sender, news) = watch::channel(());
        let core = recipients::Recipients::new(place.clone());
        let running = Executor::new(session, core, News(sender)).start(runtime)?;
        Ok(Self { running, news })
    }

    /// Returns [`Error::NotReachable`] unless the robot is reachable. Does not need the caller's runtime.
    pub(super) async fn check(&self, robot: &Name) -> Result<(), Error> {
        let mut news = None;
        loop {
            let found = self.running.driver().find(robot, Instant::now());
            match found {
                Reachability::Reachable => return Ok(()),
                Reachability::Unreachable(available) => {
                    return Err(Error::NotReachable {
                        robot: robot.clone(),
                        available,
                    })
                }
                // The session is closed, which the message reports.
                Reachability::Unsure if self.running.has_ended() => return Ok(()),
                Reachability::Unsure => {
                    self.running.wake();
                    let news = news.get_or_insert_with(|| self.news.clone());
                    news.changed().await.map_err(|_| Error::Closed)?;
                }
            }
        }
    }
}

//! Owns the ways of a program to its router, one for each urgency. What comes over one TCP connection a router takes in as it
//! came: where bulk waits for room on a radio, a stop command behind it would wait, too (20 s where 20 MB of bulk are on
//! their way over 100 kB/s). So what is urgent has a session of its own, and so has bulk; each is opened when it is first
//! needed.
use tokio::sync::OnceCell;
use zenoh::{Config, Session};

use crate::core::urgency::Urgency;

pub(super) struct Lanes {
    normal: Session,
    /// To open the others with; `None`: without a router there is nobody to take in turns.
    config: Option<Config>,
    /// By urgency.
    apart: [OnceCell<Session>; 3],
}

impl Lanes {
    pub(super) fn new(normal: Session, config: Option<Config>) -> Self {
        Self {
            normal,
            config,
            apart: Default::default(),
        }
    }

    /// Where to speak with that urgency. Needs no runtime of who asks: what zenoh waits for here, it waits for on its own.
    pub(super) async fn of(&self, urgency: Urgency) -> &Session {
        if !urgency.goes_apart() {
            return &self.normal;
        }
        if let Some(session) = self.apart[urgency as usize].get() {
            return session;
        }
        // Boxed: what opens a session is large, and would be moved with every message.
        Box::pin(self.opened(urgency)).await
    }

    async fn opened(&self, urgency: Urgency) -> &Session {
        let Some(config) = &self.config else {
            return &self.normal;
        };
        // Nobody is to wait for a router that is not there.
        let is_linked = self.normal.info().routers_zid().await.next().is_some();
        if self.normal.is_closed() || !is_linked {
            return &self.normal;
        }
        let own = &self.apart[urgency as usize];
        let opened = own.get_or_try_init(|| async { zenoh::open(config.clone()).await });
        opened.await.unwrap_or_else(|error| {
            tracing::warn!(
                "what is {urgency:?} has no connection of its own with the router: {error}"
            );
            &self.normal
        })
    }

    pub(super) async fn close(&self) -> zenoh::Result<()> {
        self.normal.close().await?;
        for other in &self.apart {
            if let Some(session) = other.get() {
                session.close().await?;
            }
        }
        Ok(())
    }
}

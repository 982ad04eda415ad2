//! Keeps one Zenoh session with the router for each urgency.
//!
//! A router processes one TCP connection in order. If bulk messages in front wait for room on a radio link, a stop command
//! behind them waits, too: 20 s, while 20 MB of bulk messages are in flight at 100 kB/s. Therefore urgent and bulk messages
//! have separate sessions, which are opened on first use.
use rect_core::{
    message::urgency::Urgency,
    session::settings::{SessionChoice, SessionsState},
};
use tokio::sync::OnceCell;
use zenoh::{Config, Session};

pub(super) struct UrgencySessions {
    normal: Session,
    /// The configuration of the separate sessions; `None` without a router, where they are not needed.
    config: Option<Config>,
    /// The separate sessions, indexed by urgency.
    separate: [OnceCell<Session>; 3],
}

impl UrgencySessions {
    pub(super) fn new(normal: Session, config: Option<Config>) -> Self {
        Self {
            normal,
            config,
            separate: Default::default(),
        }
    }

    /// Returns the session for messages of `urgency`. Does not need the caller's runtime, because Zenoh waits on its own.
    pub(super) async fn of(&self, urgency: Urgency) -> &Session {
        if !urgency.uses_separate_session() {
            return &self.normal;
        }
        if let Some(session) = self.separate[urgency as usize].get() {
            return session;
        }
        // Boxed: this future is large and would otherwise be moved with every message.
        Box::pin(self.open(urgency)).await
    }

    async fn open(&self, urgency: Urgency) -> &Session {
        let separate = &self.separate[urgency as usize];
        let linked = self.normal.info().routers_zid().await.next().is_some();
        let state = SessionsState {
            has_router: self.config.is_some(),
            is_open: separate.initialized(),
            is_linked: linked && !self.normal.is_closed(),
        };
        let (SessionChoice::Open | SessionChoice::Separate, Some(config)) =
            (state.choose(urgency), &self.config)
        else {
            return &self.normal;
        };
        let opened = separate.get_or_try_init(|| async { zenoh::open(config.clone()).await });
        opened.await.unwrap_or_else(|error| {
            tracing::warn!(
                "cannot open a separate session with the router for {urgency:?} messages, which share the normal one: {error}"
            );
            &self.normal
        })
    }

    pub(super) async fn close(&self) -> zenoh::Result<()> {
        self.normal.close().await?;
        for other in &self.separate {
            if let Some(session) = other.get() {
                session.close().await?;
            }
        }
        Ok(())
    }
}

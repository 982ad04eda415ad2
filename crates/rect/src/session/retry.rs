//! Sends requests that are repeated, and carried out at most once.
use std::time::{Duration, Instant};

use rect_core::{
    message::payload::Payload,
    name::{topic::Topic, Name},
    retry::request::{Outcome, RetriedRequest},
    session::inquiry::{Inquiry, ReplyKind},
};
use tokio::task::JoinSet;

use super::{executor::Executor, robot::Robot, shared::NoItems};
use crate::error::Error;

/// The result of a request that is repeated.
pub(super) enum Retried {
    /// The request has ended.
    Ended { kind: ReplyKind, inquiry: Inquiry },
    /// Nothing was sent: an ordinary request may reach a service of stock Zenoh within the rest of the time.
    Plain { left: Duration },
}

impl Robot {
    /// Sends a request, and repeats it until there is a reply.
    pub(super) async fn retried(
        &self,
        robot: &Name,
        topic: &Topic,
        payload: Payload,
    ) -> Result<Retried, Error> {
        let inner = &self.inner;
        let inquiry = Inquiry::new(
            inner.place.clone(),
            Some(robot.clone()),
            topic.clone(),
            self.timeout,
            &inner.request_ids,
        );
        let began = Instant::now();
        let driver = RetriedRequest::new(
            began,
            inquiry.clone(),
            robot.clone(),
            payload,
            self.urgency(),
            inner.catalogues.clone(),
        );
        let driver = driver.map_err(|error| Error::Option {
            option: "timeout",
            value: format!("{:?}", self.timeout),
            source: error.into(),
        })?;
        let session = inner.urgency_sessions.of(self.urgency()).await;
        // The caller may be outside of tokio. Dropping the set ends the task.
        let mut running = JoinSet::new();
        running.spawn_on(
            Executor::new(session, driver, NoItems).run(),
            &inner.runtime,
        );
        let Some(Ok(outcome)) = running.join_next().await else {
            return Err(Error::Closed);
        };
        match outcome? {
            Outcome::Replied(kind) => Ok(Retried::Ended { kind, inquiry }),
            Outcome::Plain => Ok(Retried::Plain {
                left: self.timeout.saturating_sub(began.elapsed()),
            }),
            Outcome::Interrupted => Err(Error::Interrupted {
                robot: Some(robot.clone()),
                topic: topic.to_string(),
            }),
            Outcome::Closed => Err(Error::Closed),
        }
    }
}

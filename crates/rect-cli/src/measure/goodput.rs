//! Measures the goodput of a load.
use std::{
    future::Future,
    time::{Duration, Instant},
};

use rect::{Name, Robot};
use serde::Serialize;
use tokio::time::sleep;

use super::{
    load,
    partner::{self, Partner, ReceivedLoad},
};
use crate::Failure;

/// How often the receiver is asked whether everything has arrived.
const POLL: Duration = Duration::from_millis(250);
/// Time without a message after which the missing ones count as lost. A bad radio is silent for a second now and then.
const LOST_AFTER: Duration = Duration::from_secs(3);

/// The part of a load that arrived.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Goodput {
    /// Size of each message, in bytes.
    pub bytes: usize,
    /// Payload per second, from the first message to the arrival of the last one, in kB/s.
    pub kb_per_s: f64,
    /// Number of messages that were sent.
    pub sent: u64,
    /// Those of them that did not arrive.
    pub lost: u64,
}

impl Goodput {
    /// Computes what arrived of `sent` messages of `bytes` within `took`, from the counts before and after.
    fn of(
        bytes: usize,
        sent: u64,
        before: ReceivedLoad,
        after: ReceivedLoad,
        took: Duration,
    ) -> Self {
        let took = took.as_secs_f64() - after.last_ago_s;
        let arrived = after.messages.saturating_sub(before.messages);
        let payload = after.bytes.saturating_sub(before.bytes);
        Self {
            bytes,
            kb_per_s: payload as f64 / 1000.0 / took.max(f64::EPSILON),
            sent,
            lost: sent.saturating_sub(arrived),
        }
    }
}

/// Measures the goodput to `other`, with messages of `bytes` for `duration`.
pub async fn to(
    robot: &Robot,
    other: &Name,
    bytes: usize,
    duration: Duration,
) -> Result<Goodput, Failure> {
    let before = partner::count(robot, other).await?;
    let began = Instant::now();
    let sent = load::send(robot, other, bytes, duration).await?;
    let after = settled(before, sent, || partner::count(robot, other)).await?;
    Ok(Goodput::of(bytes, sent, before, after, began.elapsed()))
}

/// Measures the goodput from `other`, which sends as [`to`] does. `own` counts what arrives.
pub async fn from(
    robot: &Robot,
    own: &Partner,
    other: &Name,
    bytes: usize,
    duration: Duration,
) -> Result<Goodput, Failure> {
    let before = own.received();
    let began = Instant::now();
    let sent = partner::request_load(robot, other, bytes, duration).await?;
    let after = settled(before, sent, || async { Ok(own.received()) }).await?;
    Ok(Goodput::of(bytes, sent, before, after, began.elapsed()))
}

/// Waits until all of `sent` messages have arrived, or none for `LOST_AFTER`, and returns the count then.
async fn settled<C>(
    before: ReceivedLoad,
    sent: u64,
    count: impl Fn() -> C,
) -> Result<ReceivedLoad, Failure>
where
    C: Future<Output = Result<ReceivedLoad, Failure>>,
{
    loop {
        let now = count().await?;
        let has_all = now.messages.saturating_sub(before.messages) >= sent;
        if has_all || now.last_ago_s > LOST_AFTER.as_secs_f64() {
            return Ok(now);
        }
        sleep(POLL).await;
    }
}

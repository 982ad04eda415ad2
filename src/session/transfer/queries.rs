//! Sends the queries of transfers: with background priority, never dropped on congestion, and with exactly one end each.
use std::time::Duration;

use zenoh::{
    bytes::ZBytes,
    handlers::CallbackDrop,
    qos::{CongestionControl, Priority},
    query::{ConsolidationMode, QueryTarget, Reply},
    Session, Wait,
};

/// Which queryables receive a query.
pub(super) enum Target {
    /// All matching programs of the robot.
    All,
    /// One matching program.
    One,
}

/// Sends a query. `on_end` is called exactly once, after the last reply or if the query cannot be sent.
pub(super) fn ask(
    session: &Session,
    key: &str,
    target: Target,
    payload: Vec<u8>,
    timeout: Duration,
    on_reply: impl Fn(Result<ZBytes, ZBytes>) + Send + Sync + 'static,
    on_end: impl FnOnce() + Send + Sync + 'static,
) {
    let mut on_end = Some(on_end);
    let handler = CallbackDrop {
        callback: move |reply: Reply| match reply.into_result() {
            Ok(sample) => on_reply(Ok(sample.payload().clone())),
            Err(error) => on_reply(Err(error.payload().clone())),
        },
        drop: move || {
            if let Some(on_end) = on_end.take() {
                on_end();
            }
        },
    };
    let target = match target {
        Target::All => QueryTarget::All,
        Target::One => QueryTarget::BestMatching,
    };
    let asked = session
        .get(key)
        .payload(payload)
        .target(target)
        .consolidation(ConsolidationMode::None)
        .priority(Priority::Background)
        .congestion_control(CongestionControl::Block)
        .timeout(timeout)
        .with(handler)
        .wait();
    if let Err(error) = asked {
        // `on_end` has been called.
        tracing::debug!("cannot query {key}: {error}");
    }
}

//! Owns the queries of transfers: all in no hurry, none dropped where it is full, each ended exactly once.
use std::time::Duration;

use zenoh::{
    bytes::ZBytes,
    handlers::CallbackDrop,
    qos::{CongestionControl, Priority},
    query::{ConsolidationMode, QueryTarget, Reply},
    Session, Wait,
};

/// Whom to ask.
pub(super) enum Whom {
    /// All programs of the robot.
    All,
    /// One that has it.
    One,
}

/// Asks. `on_end` is called once, after the last reply; also if it could not be asked.
pub(super) fn ask(
    session: &Session,
    key: &str,
    whom: Whom,
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
    let target = match whom {
        Whom::All => QueryTarget::All,
        Whom::One => QueryTarget::BestMatching,
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
        // Its end has been told.
        tracing::debug!("{key} can't be asked: {error}");
    }
}

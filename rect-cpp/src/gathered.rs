//! Returns the outcomes of a request to all robots.
use std::{ffi::c_char, mem::MaybeUninit, time::Duration};

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    robot::RobotHandle,
    text::Text,
};

/// The outcome of a request at one robot.
#[repr(C)]
pub struct Outcome {
    /// The robot. Empty if a stock Zenoh program replied with an error, which does not name it.
    pub robot: Text,
    /// `RECT_CODE_OK` if it replied; otherwise the reason.
    pub code: Code,
    /// Its reply. Empty if there is none.
    pub payload: PayloadView,
    /// The error, for people. Empty if it replied.
    pub error: Text,
    /// Whether the robot serves the topic and did not reply.
    pub is_missing: bool,
}

/// The outcomes of a request to all robots: first the replies and errors in the order of their arrival, and then an error for each missing
/// robot. A robot whose programs have several services of the topic has one for each of them. Release it with
/// `rect_drop(&gathered.id, ..)`.
#[repr(C)]
pub struct Gathered {
    /// The handle.
    pub id: u64,
    /// The first outcome.
    pub items: *const Outcome,
    /// Number of outcomes.
    pub len: usize,
}

struct OwnedGathered {
    _outcomes: Vec<OwnedOutcome>,
    _views: Vec<Outcome>,
}

type OwnedOutcome = (String, Result<rect::Payload, (Code, String)>);

// SAFETY: the views point into the outcomes stored next to them, which never change.
unsafe impl Send for OwnedGathered {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedGathered {}

impl Object for OwnedGathered {
    const KIND: &'static str = "set of outcomes";
}

fn into_c(gathered: rect::Gathered) -> Gathered {
    let missing = gathered.missing;
    let outcomes: Vec<OwnedOutcome> = (gathered.outcomes.into_iter())
        .map(|outcome| {
            let robot = outcome
                .robot
                .map_or_else(String::new, |robot| robot.to_string());
            let failed = |error| {
                let failure = Failure::from(error);
                (failure.code(), failure.text())
            };
            (
                robot,
                outcome.result.map(|reply| reply.payload).map_err(failed),
            )
        })
        .collect();
    let view = |(robot, result): &OwnedOutcome| Outcome {
        robot: Text::of(robot),
        code: result.as_ref().map_or_else(|(code, _)| *code, |_| Code::Ok),
        payload: (result.as_ref().ok()).map_or(PayloadView::EMPTY, PayloadView::of),
        error: Text::of_some(result.as_ref().err().map(|(_, text)| text.as_str())),
        is_missing: result.is_err() && missing.iter().any(|missing| missing.as_str() == robot),
    };
    let views: Vec<Outcome> = outcomes.iter().map(view).collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedGathered {
        _outcomes: outcomes,
        _views: views,
    });
    Gathered { id, items, len }
}

/// Sends a request to the service `topic` of every robot that offers it, waits until all have replied or `timeout_ms` has passed, and
/// writes the outcome of each robot to `gathered`. An error of one robot does not end the wait.
///
/// The robots that serve the topic are those whose catalogue lists it. A missing one has `RECT_CODE_TIMED_OUT`, or
/// `RECT_CODE_INTERRUPTED` if its program, a router or the link ended.
///
/// Returns `RECT_CODE_NO_SERVICE` if no program of the fleet serves the topic; `RECT_CODE_INTERRUPTED` if nobody replied and a program has
/// begun, ended or changed its services meanwhile, so that one may have carried the request out; and `RECT_CODE_TIMED_OUT` if nobody has
/// replied in time that a catalogue lists. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_gather(
    robot: RobotHandle,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    timeout_ms: u32,
    gathered: Option<&mut MaybeUninit<Gathered>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("gathered", &gathered)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (topic, payload) =
            unsafe { (text("topic", topic)?, require("payload", payload)?.read()?) };
        let (program, timeout) = (robot.resolve()?, Duration::from_millis(timeout_ms.into()));
        let patient = program.robot.with_timeout(timeout);
        let outcomes = program.wait(async {
            let replies = patient.request_all::<rect::Payload>(topic, payload).await?;
            replies.gather().await
        })?;
        write_out("gathered", gathered, into_c(outcomes))
    })
}

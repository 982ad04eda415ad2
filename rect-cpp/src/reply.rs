//! Owns asking a service, and its answers.
use std::{
    ffi::c_char,
    mem::MaybeUninit,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use rect::blocking::Runtime;
use tokio_util::sync::CancellationToken;

use crate::{
    argument::{text, there},
    boundary::{call, give, wanted, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    robot::Robot,
    text::Text,
};

/// An answer; it is there until `rect_drop(&reply.id, ..)`.
#[repr(C)]
pub struct Reply {
    /// Its handle.
    pub id: u64,
    /// Who answers.
    pub from: Text,
    /// What it says.
    pub payload: PayloadView,
}

/// The answers to one request, as they come. `rect_drop(&replies.id, ..)` when no more are wanted, which cancels the request.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Replies {
    /// Its handle.
    pub id: u64,
}

struct Held(rect::Reply);

impl Object for Held {
    const KIND: &'static str = "reply";
}

struct Asked {
    replies: Mutex<rect::Replies>,
    runtime: Arc<Runtime>,
    stop: CancellationToken,
}

impl Object for Asked {
    const KIND: &'static str = "set of replies";

    fn on_dropped(&self) {
        self.stop.cancel();
    }
}

impl Asked {
    fn next(&self) -> Result<rect::Reply, Failure> {
        let mut replies = self.replies.lock().unwrap_or_else(PoisonError::into_inner);
        let next = self.runtime.wait(async {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => Err(Failure::Closed),
                reply = replies.next() => reply.ok_or(Failure::End),
            }
        })?;
        Ok(next?)
    }
}

fn hold(reply: rect::Reply) -> Reply {
    let held = Arc::new(Held(reply));
    let (from, payload) = (
        Text::of(held.0.from.as_str()),
        PayloadView::of(&held.0.payload),
    );
    let id = handle::insert_shared(held);
    Reply { id, from, payload }
}

/// Asks a service of the robot `of`, and waits for its first answer. RECT_CODE_SERVICE: it answers with an error, which is
/// the text; RECT_CODE_NO_SERVICE: nobody serves that there.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_request(
    robot: Robot,
    of: *const c_char,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    timeout_ms: u32,
    reply: Option<&mut MaybeUninit<Reply>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("reply", &reply)?;
        // SAFETY: as rect.h asks.
        let (of, topic, payload) = unsafe {
            (
                text("of", of)?,
                text("topic", topic)?,
                there("payload", payload)?.read()?,
            )
        };
        let (program, timeout) = (robot.live()?, Duration::from_millis(timeout_ms.into()));
        let answer = program.wait(program.robot.request(of, topic, payload, timeout))?;
        give("reply", reply, hold(answer))
    })
}

/// Asks a service of all robots that have it; answers come until all have answered, or the time is over.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_request_all(
    robot: Robot,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    timeout_ms: u32,
    replies: Option<&mut MaybeUninit<Replies>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("replies", &replies)?;
        // SAFETY: as rect.h asks.
        let (topic, payload) =
            unsafe { (text("topic", topic)?, there("payload", payload)?.read()?) };
        let (program, timeout) = (robot.live()?, Duration::from_millis(timeout_ms.into()));
        let asked = program.wait(program.robot.request_all(topic, payload, timeout))?;
        let id = handle::insert(Asked {
            replies: Mutex::new(asked),
            runtime: program.runtime.clone(),
            stop: CancellationToken::new(),
        });
        give("replies", replies, Replies { id })
    })
}

/// The next answer. RECT_CODE_SERVICE: this one is an error, and there may be more; RECT_CODE_END: all have answered;
/// RECT_CODE_TIMED_OUT: the time of the request is over, and some have not.
///
/// Thread: any; one after another.
#[no_mangle]
pub extern "C" fn rect_replies_next(
    replies: Replies,
    reply: Option<&mut MaybeUninit<Reply>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("reply", &reply)?;
        let next = handle::get::<Asked>(replies.id)?.next()?;
        give("reply", reply, hold(next))
    })
}

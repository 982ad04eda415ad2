//! Sends requests to services and returns their replies.
use std::{ffi::c_char, mem::MaybeUninit, sync::Arc, time::Duration};

use rect::blocking::Runtime;
use tokio_util::sync::CancellationToken;

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    program::Program,
    robot::RobotHandle,
    text::Text,
};

/// A reply. It is valid until `rect_drop(&reply.id, ..)`.
#[repr(C)]
pub struct Reply {
    /// The handle.
    pub id: u64,
    /// The robot that replied.
    pub sender: Text,
    /// The payload.
    pub payload: PayloadView,
    /// Whether the service shares its topic with other programs of the robot (`allow_several`). They have received the request, too,
    /// and carry it out.
    pub is_shared: bool,
}

/// The replies to one request, in the order of arrival. `rect_drop(&replies.id, ..)` cancels the request.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Replies {
    /// The handle.
    pub id: u64,
}

struct OwnedReply(rect::Reply);

impl Object for OwnedReply {
    const KIND: &'static str = "reply";
}

struct PendingReplies {
    replies: rect::Replies,
    runtime: Arc<Runtime>,
    stop: CancellationToken,
}

impl Object for PendingReplies {
    const KIND: &'static str = "set of replies";

    fn on_dropped(&self) {
        self.stop.cancel();
    }
}

impl PendingReplies {
    fn next(&self) -> Result<rect::Reply, Failure> {
        let next = self.runtime.wait(async {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => Err(Failure::Closed),
                reply = self.replies.next() => reply.ok_or(Failure::End),
            }
        })?;
        Ok(next?)
    }
}

/// Reads the arguments of a request to one robot.
///
/// # Safety
/// The pointers follow the rules of rect.h.
unsafe fn read<'a>(
    recipient: *const c_char,
    topic: *const c_char,
    payload: Option<&PayloadView>,
) -> Result<(&'a str, &'a str, rect::Payload), Failure> {
    // SAFETY: guaranteed by this function's caller.
    unsafe {
        Ok((
            text("recipient", recipient)?,
            text("topic", topic)?,
            require("payload", payload)?.read()?,
        ))
    }
}

fn replies_into_c(program: &Program, replies: rect::Replies) -> Replies {
    let id = handle::insert(PendingReplies {
        replies,
        runtime: program.runtime.clone(),
        stop: CancellationToken::new(),
    });
    Replies { id }
}

fn into_c(reply: rect::Reply) -> Reply {
    let owned = Arc::new(OwnedReply(reply));
    let (sender, payload) = (
        Text::of(owned.0.sender.as_str()),
        PayloadView::of(&owned.0.payload),
    );
    let is_shared = owned.0.is_shared;
    let id = handle::insert_shared(owned);
    Reply {
        id,
        sender,
        payload,
        is_shared,
    }
}

/// Sends a request to the service `topic` of the robot `recipient`, waits for the first reply and writes it to `reply`.
///
/// ```c
/// const rect_payload cell = rect_payload_json("1");
/// rect_reply reply;
/// if (rect_robot_request(robot, "wombat-2", "battery", &cell, 2000, &reply, &error) == RECT_CODE_OK) {
///     rect_drop(&reply.id, NULL);
/// }
/// ```
///
/// Returns `RECT_CODE_SERVICE` if the service replies with an error, which is the text; `RECT_CODE_NO_SERVICE` if the robot
/// does not offer the service or is not reachable; `RECT_CODE_INTERRUPTED` if it may have received the request and does not reply
/// because its program ended, or a router or link did; and `RECT_CODE_TIMED_OUT` if there is no reply within `timeout_ms`.
///
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_request(
    robot: RobotHandle,
    recipient: *const c_char,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    timeout_ms: u32,
    reply: Option<&mut MaybeUninit<Reply>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("reply", &reply)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (recipient, topic, payload) = unsafe { read(recipient, topic, payload) }?;
        let (program, timeout) = (robot.resolve()?, Duration::from_millis(timeout_ms.into()));
        let first = program.wait(
            program
                .robot
                .with_timeout(timeout)
                .request::<rect::Payload>(recipient, topic, payload),
        )?;
        write_out("reply", reply, into_c(first))
    })
}

/// Sends a request to the service `topic` of every robot that offers it, and writes the handle of the replies to `replies`.
/// `rect_replies_next` returns them until all robots have replied or `timeout_ms` has passed. `rect_robot_gather` also names the robots
/// that did not reply.
///
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_request_all(
    robot: RobotHandle,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    timeout_ms: u32,
    replies: Option<&mut MaybeUninit<Replies>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("replies", &replies)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (topic, payload) =
            unsafe { (text("topic", topic)?, require("payload", payload)?.read()?) };
        let (program, timeout) = (robot.resolve()?, Duration::from_millis(timeout_ms.into()));
        let incoming = program.wait(
            program
                .robot
                .with_timeout(timeout)
                .request_all(topic, payload),
        )?;
        write_out("replies", replies, replies_into_c(&program, incoming))
    })
}

/// Sends a request to the service `topic` of the robot `recipient`, which sends several replies, such as the results of a scan, and writes
/// the handle of the replies to `replies`. `rect_replies_next` returns `RECT_CODE_END` only after all of them, and
/// `RECT_CODE_INTERRUPTED` if the program, a router or the link ended midway. All replies have to arrive within `timeout_ms`.
///
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_request_stream(
    robot: RobotHandle,
    recipient: *const c_char,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    timeout_ms: u32,
    replies: Option<&mut MaybeUninit<Replies>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("replies", &replies)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (recipient, topic, payload) = unsafe { read(recipient, topic, payload) }?;
        let (program, timeout) = (robot.resolve()?, Duration::from_millis(timeout_ms.into()));
        let patient = program.robot.with_timeout(timeout);
        let incoming = program.wait(patient.request_stream(recipient, topic, payload))?;
        write_out("replies", replies, replies_into_c(&program, incoming))
    })
}

/// Waits for the next reply and writes it to `reply`.
///
/// Returns `RECT_CODE_SERVICE` if a robot replied with an error, after which there may be more replies; `RECT_CODE_END` if
/// all robots have replied, or all replies of a stream have arrived; and `RECT_CODE_TIMED_OUT` if the request's timeout expired before
/// that.
///
/// May be called on any thread; calls of several threads run one after another.
#[no_mangle]
pub extern "C" fn rect_replies_next(
    replies: Replies,
    reply: Option<&mut MaybeUninit<Reply>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("reply", &reply)?;
        let next = handle::get::<PendingReplies>(replies.id)?.next()?;
        write_out("reply", reply, into_c(next))
    })
}

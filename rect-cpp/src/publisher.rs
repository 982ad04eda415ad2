//! Publishers of one topic, which know whether there are subscribers.
use std::{ffi::c_char, mem::MaybeUninit};

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut},
    cancellable::{timeout, Cancellable, Waitable},
    failure::Code,
    handle,
    payload::PayloadView,
    robot::RobotHandle,
};

/// A publisher of one topic, which knows whether there are subscribers. Release it with `rect_drop(&publisher.id, ..)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Publisher {
    /// The handle.
    pub id: u64,
}

impl Waitable for rect::Publisher {
    const KIND: &'static str = "publisher";
}

/// Creates a publisher of `topic`, with the urgency, codec, expiry and retention of the robot's handle, and writes it to `publisher`. It
/// can wait for a subscriber, and lets a program skip work while nobody subscribes. `rect_robot_publish` needs no publisher.
///
/// Returns `RECT_CODE_TOPIC` if the topic is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_publisher(
    robot: RobotHandle,
    topic: *const c_char,
    publisher: Option<&mut MaybeUninit<Publisher>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("publisher", &publisher)?;
        // SAFETY: the caller follows the rules of rect.h.
        let topic = unsafe { text("topic", topic) }?;
        let program = robot.resolve()?;
        let declared = program.wait(program.robot.publisher(topic))?;
        let id = handle::insert(Cancellable::new(declared, &program));
        write_out("publisher", publisher, Publisher { id })
    })
}

/// Publishes a payload to every subscriber, like `rect_robot_publish` on the publisher's topic.
#[no_mangle]
pub unsafe extern "C" fn rect_publisher_publish(
    publisher: Publisher,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let payload = unsafe { require("payload", payload)?.read() }?;
        let publishing = handle::get::<Cancellable<rect::Publisher>>(publisher.id)?;
        publishing.complete(|publisher| publisher.publish(payload))
    })
}

/// Writes to `has_subscribers` whether at least one subscriber of another program receives the messages, on this or another
/// robot. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_publisher_has_subscribers(
    publisher: Publisher,
    has_subscribers: Option<&mut MaybeUninit<bool>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let publishing = handle::get::<Cancellable<rect::Publisher>>(publisher.id)?;
        let has = publishing.source().has_subscribers();
        write_out("has_subscribers", has_subscribers, has)
    })
}

/// Waits until a subscriber receives the messages.
///
/// Returns `RECT_CODE_TIMED_OUT` if there is none within `timeout_ms` (`RECT_FOREVER` waits without a limit), and
/// `RECT_CODE_CLOSED` if the session was closed or another thread dropped the publisher. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_publisher_wait_for_subscriber(
    publisher: Publisher,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let publishing = handle::get::<Cancellable<rect::Publisher>>(publisher.id)?;
        publishing.wait(|publisher| publisher.wait_for_subscriber(timeout(timeout_ms)))
    })
}

//! Retains messages, returns the last value of a retained topic, and forgets one.
use std::{ffi::c_char, mem::MaybeUninit};

use crate::{
    argument::text,
    boundary::{call, require_out, write_out, ErrorOut},
    cancellable::timeout,
    failure::Code,
    message::{self, Message},
    robot::RobotHandle,
};

/// Creates a handle of the same robot that retains what it publishes, and writes it to `derived`: the router of this robot keeps the
/// last value of each topic, and programs that start later, or whose link was interrupted, receive it.
///
/// A subscription receives the value first, then each change, never one twice or an older one after a newer one
/// (`rect_message.retained`). The value stays when this program ends. Requests, streams and messages to one robot are not affected,
/// and retained messages do not expire. Both handles share the session, and both must be dropped.
///
/// `rect_robot_publish` and `rect_publisher_publish` then wait for the router, and return `RECT_CODE_NOT_RETAINED` if the value is not
/// kept: it has more than 64 kB, the values of the robot have more than 256 kB, or no router keeps values. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_retained(
    robot: RobotHandle,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        robot.derive(derived, |robot| Ok(robot.retained()))
    })
}

/// Creates a handle as `rect_robot_retained` does, whose values also survive a restart of the robot, and writes it to `derived`. The
/// router writes each value to its disk before it is published: for values that change rarely, such as a calibration.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_retained_on_disk(
    robot: RobotHandle,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        robot.derive(derived, |robot| Ok(robot.retained_on_disk()))
    })
}

/// Writes the last value of a retained topic of the robot `sender` to `message`. If that robot retains none, is not reachable, or does
/// not answer within `timeout_ms`, the message is empty and its `id` is 0.
///
/// ```c
/// must(rect_robot_latest(robot, "wombat-2", "mode", 10000, &message, &error));
/// if (message.id != 0) {
///     printf("%.*s\n", (int)message.payload.len, (const char *)message.payload.data);
/// }
/// rect_drop(&message.id, NULL);
/// ```
///
/// The answer comes from the router of this robot if one of its programs subscribes to the topic, and otherwise from that of `sender`.
///
/// Returns `RECT_CODE_NAME` or `RECT_CODE_TOPIC` if an argument is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_latest(
    robot: RobotHandle,
    sender: *const c_char,
    topic: *const c_char,
    timeout_ms: u32,
    message: Option<&mut MaybeUninit<Message>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("message", &message)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (sender, topic) = unsafe { (text("sender", sender)?, text("topic", topic)?) };
        let program = robot.resolve()?;
        let asking = program.robot.with_timeout(timeout(timeout_ms));
        let latest = program.wait(asking.latest::<rect::Payload>(sender, topic))?;
        write_out(
            "message",
            message,
            latest.map_or_else(Message::none, message::into_c),
        )
    })
}

/// Forgets a retained topic of this robot. Subscribers receive that as a message without a value (`rect_message.is_forgotten`).
/// Nothing happens if the topic has no value.
///
/// Returns `RECT_CODE_TOPIC` if the topic is invalid, and `RECT_CODE_NOT_RETAINED` if no router keeps values. May be called on any
/// thread; blocks until the router answers.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_forget(
    robot: RobotHandle,
    topic: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let topic = unsafe { text("topic", topic) }?;
        let program = robot.resolve()?;
        program.wait(program.robot.forget(topic))
    })
}

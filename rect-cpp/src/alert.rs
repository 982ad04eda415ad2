//! Raises and clears alerts.
use std::{ffi::c_char, mem::MaybeUninit};

use crate::{
    argument::text,
    boundary::{call, ErrorOut},
    failure::Code,
    log::LEVELS,
    robot::RobotHandle,
    text::choice,
};

/// Raises an alert: something is wrong with this robot until `rect_robot_clear_alert` ends it. `rect status`, the page and recordings
/// show it. `level` is a `rect_level`.
///
/// ```c
/// rect_robot_alert(robot, RECT_LEVEL_WARN, "battery low", &error);
/// rect_robot_clear_alert(robot, "battery low", &error);
/// ```
///
/// It is a retained message (`rect_robot_retained`) on the topic `alerts/<name>`, whose name is the text in words: `battery low` has
/// `alerts/battery-low`. It stays when the program ends. The same alert again replaces the first one. A subscription to
/// `*/alerts/*` receives the alerts of all robots, as JSON with `text`, `level`, `at` (milliseconds since 1970) and `program`.
///
/// Returns `RECT_CODE_TOPIC` if the text has neither a letter nor a digit, and `RECT_CODE_NOT_RETAINED` if no router keeps it. May be
/// called on any thread; blocks until the router answers.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_alert(
    robot: RobotHandle,
    level: u32,
    text: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { rect_robot_alert_named(robot, text, level, text, error) }
}

/// Raises an alert under a name of its own, for a text that changes: `battery` with the text `battery at 12 %`.
///
/// Returns the codes of `rect_robot_alert`, for the name. May be called on any thread; blocks until the router answers.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_alert_named(
    robot: RobotHandle,
    name: *const c_char,
    level: u32,
    text: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (content, name) = unsafe { (self::text("text", text)?, self::text("name", name)?) };
        let level = choice("level", &LEVELS, level)?;
        let program = robot.resolve()?;
        program.wait(program.robot.alert_named(name, level, content))
    })
}

/// Clears the alert with this name or text. Nothing happens if it was not raised.
///
/// Returns the codes of `rect_robot_alert`. May be called on any thread; blocks until the router answers.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_clear_alert(
    robot: RobotHandle,
    name: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let name = unsafe { text("name", name) }?;
        let program = robot.resolve()?;
        program.wait(program.robot.clear_alert(name))
    })
}

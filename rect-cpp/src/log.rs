//! Logs lines of the program.
use std::{
    borrow::Cow,
    collections::BTreeMap,
    ffi::{c_char, CStr},
    time::SystemTime,
};

use rect_core::clock::unix::ms_since_1970;
use serde_json::Value;

use crate::{
    argument::require,
    boundary::call,
    failure::{Code, Failure},
    robot::RobotHandle,
    text::choice,
};

/// How important a line of a log, or an alert, is.
#[repr(C)]
pub enum Level {
    /// Details for finding a fault in the program.
    Debug = 0,
    /// The usual course of the program.
    Info = 1,
    /// Something that somebody should look at.
    Warn = 2,
    /// Something has failed.
    Error = 3,
}

/// The levels by their numbers in C.
pub const LEVELS: [(u32, rect::Level); 4] = [
    (Level::Debug as u32, rect::Level::Debug),
    (Level::Info as u32, rect::Level::Info),
    (Level::Warn as u32, rect::Level::Warn),
    (Level::Error as u32, rect::Level::Error),
];

/// A line for the log, with everything that belongs to it. Members that are NULL or 0 are left out, except for the text.
#[repr(C)]
pub struct LogLine {
    /// How important it is: a `rect_level`.
    pub level: u32,
    /// The text, of 8 kB at most; a longer one is cut. It may have several lines, such as those of a stack trace.
    pub text: *const c_char,
    /// The part of the program that logs it, such as `arm`.
    pub logger: *const c_char,
    /// Values with names, as a JSON object such as `{"angle": 12.5}`. Any other text becomes a field named `fields`.
    pub fields: *const c_char,
    /// The file of the source code, such as `__FILE__`. Its folders are left out.
    pub file: *const c_char,
    /// The line in that file, such as `__LINE__`.
    pub line: u32,
    /// Whether it stays on this robot: access control does not let other robots read it. For what may contain paths or passwords.
    pub is_private: bool,
}

impl LogLine {
    /// Converts the line for the library.
    ///
    /// # Safety
    /// Its texts are NULL, or have a terminating zero byte.
    unsafe fn read(&self) -> Result<rect::LogLine, Failure> {
        let level = choice("line.level", &LEVELS, self.level)?;
        // SAFETY: guaranteed by this function's caller.
        let [text, logger, fields, file] =
            unsafe { [self.text, self.logger, self.fields, self.file].map(|text| lossy(text)) };
        let text = require("line.text", text)?;
        let source = file.map(|file| source(&file, self.line));
        Ok(rect::LogLine {
            logger: logger.unwrap_or_default().into_owned(),
            fields: fields.map(|json| read_fields(&json)).unwrap_or_default(),
            source: source.unwrap_or_default(),
            ..line_of(level, &text)
        })
    }
}

/// Logs a line, which the router of this robot keeps: `rect log` shows it, also after this program has ended.
///
/// ```c
/// rect_robot_log(robot, RECT_LEVEL_WARN, "the gripper is slow");
/// ```
///
/// `level` is a `rect_level`. Bytes of the text that are not UTF-8 become U+FFFD. A text has 8 kB at most; a longer one is cut.
///
/// It never waits, and a program may ignore the result. A router keeps the last 1,000 lines of each program, and 2 MB in all. A program
/// that logs faster than that can be sent loses lines, which are counted in the log.
///
/// Returns `RECT_CODE_ARGUMENT` if the level is invalid or the text is NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_log(
    robot: RobotHandle,
    level: u32,
    text: *const c_char,
) -> Code {
    call(None, || {
        let level = choice("level", &LEVELS, level)?;
        // SAFETY: the caller follows the rules of rect.h.
        let text = require("text", unsafe { lossy(text) })?;
        robot.resolve()?.robot.log_line(line_of(level, &text));
        Ok(())
    })
}

/// Logs a line with everything that belongs to it, as `rect_robot_log` does.
///
/// ```c
/// rect_log_line line = {0};
/// line.level = RECT_LEVEL_WARN;
/// line.text = "the gripper is slow";
/// line.fields = "{\"angle\": 12.5}";
/// line.file = __FILE__;
/// line.line = __LINE__;
/// rect_robot_log_line(robot, &line);
/// ```
///
/// Returns `RECT_CODE_ARGUMENT` if the level is invalid or the text is NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_log_line(robot: RobotHandle, line: Option<&LogLine>) -> Code {
    call(None, || {
        let line = require("line", line)?;
        // SAFETY: the caller follows the rules of rect.h.
        let read = unsafe { line.read() }?;
        let program = robot.resolve()?;
        match line.is_private {
            true => program.robot.log_private(read),
            false => program.robot.log_line(read),
        }
        Ok(())
    })
}

fn line_of(level: rect::Level, text: &str) -> rect::LogLine {
    rect::LogLine::new(ms_since_1970(SystemTime::now()), level, text)
}

/// Returns a text, with U+FFFD for what is not UTF-8: a line is not lost because of a byte. `None` for NULL.
///
/// # Safety
/// `text` is NULL, or points to a text with a terminating zero byte that outlives `'a`.
unsafe fn lossy<'a>(text: *const c_char) -> Option<Cow<'a, str>> {
    // SAFETY: the pointer is not NULL, and this function's caller guarantees the rest.
    let text = (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) });
    text.map(CStr::to_string_lossy)
}

/// Returns the fields that a JSON object contains. Another text is a field itself, so that nothing is lost.
fn read_fields(json: &str) -> BTreeMap<String, Value> {
    if json.is_empty() {
        return BTreeMap::new();
    }
    serde_json::from_str(json)
        .unwrap_or_else(|_| BTreeMap::from([("fields".to_owned(), json.into())]))
}

/// Returns a place in the source code, such as `arm.c:12`. The folder of the file belongs to the computer that has compiled it.
fn source(file: &str, line: u32) -> String {
    let name = file.rsplit(['/', '\\']).next().unwrap_or(file);
    match line {
        0 => name.to_owned(),
        line => format!("{name}:{line}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_those_of_an_object_and_any_other_text_is_one() {
        let fields = read_fields(r#"{"angle": 12.5, "side": "left"}"#);
        assert_eq!(fields.len(), 2);
        assert_eq!(fields["angle"], 12.5);
        for other in [r#"{"angle": nan}"#, "[1]", "7", "{", &"[".repeat(100_000)] {
            let expected = BTreeMap::from([("fields".to_owned(), Value::from(other))]);
            assert_eq!(read_fields(other), expected);
        }
        assert!(read_fields("").is_empty());
    }

    #[test]
    fn source_is_the_name_of_the_file_and_the_line() {
        for (file, line, expected) in [
            ("/home/kipr/arm.c", 12, "arm.c:12"),
            (r"C:\arm\arm.c", 12, "arm.c:12"),
            ("arm.c", 0, "arm.c"),
        ] {
            assert_eq!(source(file, line), expected);
        }
    }
}

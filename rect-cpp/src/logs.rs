//! Reads the logs of robots.
use std::{ffi::c_char, mem::MaybeUninit, sync::Arc};

use rect::Name;

use crate::{
    argument::{text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    cancellable::{timeout, Cancellable, Waitable},
    failure::{Code, Failure},
    handle::{self, Object},
    log::LEVELS,
    robot::RobotHandle,
    text::{choice, number, Text},
};

/// The logs that this program reads. `rect_drop(&logs.id, ..)` ends that.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Logs {
    /// The handle.
    pub id: u64,
}

/// Which lines `rect_robot_logs` reads. `rect_log_options options = {0};` are the defaults, and so is NULL: the last 100 lines of all
/// programs and levels.
#[repr(C)]
pub struct LogOptions {
    /// The program; NULL: all programs.
    pub program: *const c_char,
    /// The least important level: a `rect_level`.
    pub level: u32,
    /// The maximum number of lines of each robot that were logged before, 10,000 at most. 0: 100.
    pub last: usize,
    /// Whether lines that were logged before are left out, so that only new ones are read.
    pub without_earlier: bool,
    /// Whether new lines follow, until the handle is dropped. They cross the link, in the background, while somebody follows.
    pub follow: bool,
    /// How long the router of a robot may take to answer, in milliseconds. 0: 10 s.
    pub timeout_ms: u32,
}

/// A line that a router keeps. It is valid as long as its `rect_log_item`.
#[repr(C)]
pub struct KeptLine {
    /// Its number at this run of the router, beginning with 1.
    pub number: u64,
    /// The program; `unnamed` if it has no name.
    pub program: Text,
    /// When it was logged, in milliseconds since 1970 by the clock of its robot.
    pub at_ms: u64,
    /// How important it is: a `rect_level`.
    pub level: u32,
    /// The part of the program; `stdout` or `stderr` for its output, otherwise possibly empty.
    pub logger: Text,
    /// The text, which may have several lines.
    pub text: Text,
    /// Values with names, as a JSON object; empty if there are none.
    pub fields: Text,
    /// The place in the source code, such as `arm.c:12`; possibly empty.
    pub source: Text,
}

/// The kind of a `rect_log_item`.
#[repr(C)]
#[derive(Clone, Copy)]
pub enum LogItemKind {
    /// Lines of a robot, or the fact that it has answered and has none.
    Lines = 0,
    /// All routers have answered that can be reached: the lines that follow are new.
    Complete = 1,
    /// New lines of a robot were missed, because its program logged faster than the link carries.
    Missed = 2,
}

/// Lines of a log, or news of the reading, from `rect_logs_next`. Release it with `rect_drop(&item.id, ..)`.
#[repr(C)]
pub struct LogItem {
    /// The handle.
    pub id: u64,
    /// The kind.
    pub kind: LogItemKind,
    /// The robot; empty for `RECT_LOG_ITEM_KIND_COMPLETE`.
    pub robot: Text,
    /// The first line. The lines are in the order in which they were logged.
    pub lines: *const KeptLine,
    /// Number of lines.
    pub len: usize,
    /// Whether the lines are newer than all lines of that robot before. Otherwise they are older: the last lines arrive in parts, newest
    /// ones first.
    pub is_new: bool,
}

struct OwnedItem {
    robot: Option<Name>,
    _lines: Vec<(rect::KeptLine, String)>,
    views: Vec<KeptLine>,
}

// SAFETY: the views point into the lines stored next to them, which never change.
unsafe impl Send for OwnedItem {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedItem {}

impl Object for OwnedItem {
    const KIND: &'static str = "item of a log";
}

impl Waitable for rect::Logs {
    const KIND: &'static str = "reader of logs";
}

impl LogOptions {
    /// Converts the options for the library.
    ///
    /// # Safety
    /// The program is NULL, or has a terminating zero byte.
    unsafe fn read(given: Option<&Self>) -> Result<rect::LogOptions, Failure> {
        let mut options = rect::LogOptions::new();
        let Some(given) = given else {
            return Ok(options);
        };
        options = options.level(choice("options.level", &LEVELS, given.level)?);
        // SAFETY: guaranteed by this function's caller.
        if let Some(program) = unsafe { text_or_none("options.program", given.program) }? {
            options = options.program(Name::new(program)?);
        }
        if given.without_earlier || given.last > 0 {
            let last = if given.without_earlier { 0 } else { given.last };
            options = options.last(last);
        }
        if given.follow {
            options = options.follow();
        }
        if given.timeout_ms > 0 {
            options = options.timeout(timeout(given.timeout_ms));
        }
        Ok(options)
    }
}

/// Reads the log of the robot `name`, or of all robots (`*`), and writes the handle to `logs`. `rect_logs_next` returns the last lines,
/// newest ones first in parts, and with `options.follow` new ones. `options` may be NULL.
///
/// Returns `RECT_CODE_NAME` if a name is invalid. No item names a robot that does not answer. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_logs(
    robot: RobotHandle,
    name: *const c_char,
    options: Option<&LogOptions>,
    logs: Option<&mut MaybeUninit<Logs>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("logs", &logs)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (name, options) = unsafe { (text("name", name)?, LogOptions::read(options)?) };
        let program = robot.resolve()?;
        let reading = program.wait(program.robot.logs(name, options))?;
        let id = handle::insert(Cancellable::new(reading, &program));
        write_out("logs", logs, Logs { id })
    })
}

/// Waits for the next lines and writes them to `item`.
///
/// ```c
/// rect_log_item item;
/// size_t n;
/// while (rect_logs_next(logs, RECT_FOREVER, &item, &error) == RECT_CODE_OK) {
///     for (n = 0; n < item.len; ++n) {
///         printf("%.*s\n", (int)item.lines[n].text.len, (const char *)item.lines[n].text.data);
///     }
///     rect_drop(&item.id, NULL);
/// }
/// ```
///
/// Returns `RECT_CODE_END` when all routers have answered, unless new lines follow, or if the session was closed; `RECT_CODE_TIMED_OUT` if
/// nothing arrives within `timeout_ms` (`RECT_FOREVER` waits without a limit); and `RECT_CODE_CLOSED` if another thread dropped the handle.
///
/// May be called on any thread; if several threads wait, one of them receives the item.
#[no_mangle]
pub extern "C" fn rect_logs_next(
    logs: Logs,
    timeout_ms: u32,
    item: Option<&mut MaybeUninit<LogItem>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("item", &item)?;
        let reading = handle::get::<Cancellable<rect::Logs>>(logs.id)?;
        let next = reading.next("line", timeout_ms, next_or_end)?;
        write_out("item", item, into_c(next.ok_or(Failure::End)?))
    })
}

/// Returns the next item, and `Some(None)` after the last one.
async fn next_or_end(logs: &rect::Logs) -> Option<Option<rect::LogItem>> {
    Some(logs.next().await)
}

fn into_c(item: rect::LogItem) -> LogItem {
    let (kind, robot, lines, is_new) = match item {
        rect::LogItem::Lines {
            robot,
            lines,
            is_new,
        } => (LogItemKind::Lines, Some(robot), lines, is_new),
        rect::LogItem::Complete => (LogItemKind::Complete, None, Vec::new(), false),
        rect::LogItem::Missed(robot) => (LogItemKind::Missed, Some(robot), Vec::new(), false),
    };
    let with_fields = lines.into_iter().map(|kept| {
        let fields = fields(&kept.line);
        (kept, fields)
    });
    let lines: Vec<_> = with_fields.collect();
    let views = lines.iter().map(|(kept, fields)| view(kept, fields));
    let owned = OwnedItem {
        views: views.collect(),
        robot,
        _lines: lines,
    };
    let owned = Arc::new(owned);
    let id = handle::insert_shared(owned.clone());
    LogItem {
        id,
        kind,
        robot: Text::of_some(owned.robot.as_ref().map(Name::as_str)),
        lines: owned.views.as_ptr(),
        len: owned.views.len(),
        is_new,
    }
}

/// Returns the fields of a line as JSON; empty if there are none.
fn fields(line: &rect::LogLine) -> String {
    if line.fields.is_empty() {
        return String::new();
    }
    serde_json::to_string(&line.fields).unwrap_or_default()
}

fn view(kept: &rect::KeptLine, fields: &str) -> KeptLine {
    let line = &kept.line;
    KeptLine {
        number: kept.number,
        program: Text::of(&kept.program),
        at_ms: line.at,
        level: number(&LEVELS, &line.level),
        logger: Text::of(&line.logger),
        text: Text::of(&line.text),
        fields: Text::of(fields),
        source: Text::of(&line.source),
    }
}

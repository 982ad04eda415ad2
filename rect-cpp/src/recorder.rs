//! Records messages to MCAP files.
use std::{
    ffi::c_char,
    mem::MaybeUninit,
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use rect::recording::{self, Split};
use rect::{blocking::Runtime, Pattern, RecordOptions as LibraryOptions, RobotRecorder};

use crate::{
    argument::{items, text},
    boundary::{buffer, call, require_out, write_out, ErrorOut},
    failure::{Code, Failure},
    handle::{self, lock, Object},
    robot::RobotHandle,
};

/// The size of a text in `rect_recording_progress`, in bytes.
pub const PROBLEM_BYTES: usize = 256;

/// The settings of a recording. Fields that are 0 or NULL keep their defaults, so `rect_record_options options = {0};` are the defaults, and so is
/// NULL.
#[repr(C)]
pub struct RecordOptions {
    /// The messages, as `<robot>/<topic>` with wildcards. Default: everything that the programs of this robot publish, and
    /// everything that they send to one robot or that is sent to this one. Messages of other robots travel over the links to this robot
    /// only because they are recorded.
    pub patterns: *const *const c_char,
    /// Number of patterns.
    pub patterns_len: usize,
    /// How much of the past to keep, in milliseconds. Default: everything.
    pub keep_ms: u64,
    /// The time after which the recording continues in another file, in milliseconds. Default: never.
    pub split_ms: u64,
    /// The size of a file in bytes at which the recording continues in another one. Default: any.
    pub split_bytes: u64,
    /// Leaves out the lines that the programs of the recorded robots log. Otherwise they are recorded, except private ones. Those of other
    /// robots travel over the links, in the background, only because they are recorded.
    pub without_logs: bool,
}

/// How a recording goes.
#[repr(C)]
pub struct RecordingProgress {
    /// Number of messages in the recording.
    pub recorded: u64,
    /// Bytes of their payloads.
    pub bytes: u64,
    /// Number of messages that were dropped, because the disk was too slow or full.
    pub dropped: u64,
    /// Why the disk does not take anything at the moment; empty if it does.
    pub problem: [c_char; PROBLEM_BYTES],
}

/// A recording that runs. `rect_drop(&recorder.id, ..)` without `rect_recorder_finish` leaves a folder, which `rect recording merge`
/// makes a file of.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Recorder {
    /// The handle.
    pub id: u64,
}

struct OwnedRecorder {
    /// `None` when it is finished.
    recorder: Mutex<Option<RobotRecorder>>,
    runtime: Arc<Runtime>,
}

impl Object for OwnedRecorder {
    const KIND: &'static str = "recorder";
}

impl OwnedRecorder {
    fn recorder(&self) -> MutexGuard<'_, Option<RobotRecorder>> {
        lock(&self.recorder)
    }
}

/// Records messages to the file `path`, which ends in `.mcap`, until `rect_recorder_finish` is called, with the events of this robot,
/// the requests to its services, the lines that programs log and, once a second, the state of its router's links. Until then, the
/// recording is a folder of short files, so that a power cut costs at most its last seconds.
///
/// Recording never delays the program: what a slow or full disk does not take waits in 8 MB of memory, and is then dropped and
/// counted, urgent messages last.
///
/// Returns `RECT_CODE_RECORDING` if there is a recording of that name or the folder cannot be written, and `RECT_CODE_TOPIC` if a
/// pattern is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_record(
    robot: RobotHandle,
    path: *const c_char,
    options: Option<&RecordOptions>,
    recorder: Option<&mut MaybeUninit<Recorder>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("recorder", &recorder)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (path, options) = unsafe { (text("path", path)?, read(options)?) };
        let program = robot.resolve()?;
        let started = program.wait(program.robot.record(path, options))?;
        let owned = OwnedRecorder {
            recorder: Mutex::new(Some(started)),
            runtime: program.runtime.clone(),
        };
        let id = handle::insert(owned);
        write_out("recorder", recorder, Recorder { id })
    })
}

/// Writes to `progress` how the recording goes. Returns `RECT_CODE_CLOSED` if it was finished. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_recorder_progress(
    recorder: Recorder,
    progress: Option<&mut MaybeUninit<RecordingProgress>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let owned = handle::get::<OwnedRecorder>(recorder.id)?;
        let now = owned.recorder().as_ref().map(RobotRecorder::progress);
        write_out("progress", progress, (&now.ok_or(Failure::Closed)?).into())
    })
}

/// Stops, and makes one file of the recording, or several with numbers if it is split; none if nothing was recorded. Writes the
/// final counts to `progress` unless it is NULL.
///
/// Returns `RECT_CODE_RECORDING` if the disk fails; the folder remains then, and can be read. Returns `RECT_CODE_CLOSED` if the recording
/// was finished before. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_recorder_finish(
    recorder: Recorder,
    progress: Option<&mut MaybeUninit<RecordingProgress>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let owned = handle::get::<OwnedRecorder>(recorder.id)?;
        let running = owned.recorder().take().ok_or(Failure::Closed)?;
        let (_, last) = owned.runtime.wait(running.finish())?;
        match progress {
            Some(_) => write_out("progress", progress, (&last).into()),
            None => Ok(()),
        }
    })
}

/// # Safety
/// The pointers follow the rules of rect.h.
unsafe fn read(given: Option<&RecordOptions>) -> Result<LibraryOptions, Failure> {
    let Some(given) = given else {
        return Ok(LibraryOptions::default());
    };
    let some_ms = |ms: u64| (ms > 0).then(|| Duration::from_millis(ms));
    let mut patterns = Vec::new();
    // SAFETY: guaranteed by this function's caller.
    unsafe {
        for &pattern in items("options.patterns", given.patterns, given.patterns_len)? {
            let pattern = Pattern::new(text("options.patterns", pattern)?);
            patterns.push(pattern.map_err(rect::Error::from)?);
        }
    }
    Ok(LibraryOptions {
        patterns,
        keep: some_ms(given.keep_ms),
        split: Split {
            after: some_ms(given.split_ms),
            bytes: (given.split_bytes > 0).then_some(given.split_bytes),
        },
        without_logs: given.without_logs,
    })
}

impl From<&recording::Progress> for RecordingProgress {
    fn from(progress: &recording::Progress) -> Self {
        Self {
            recorded: progress.written,
            bytes: progress.bytes,
            dropped: progress.dropped,
            problem: buffer(progress.problem.as_deref().unwrap_or_default()),
        }
    }
}

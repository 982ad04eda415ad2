//! Watches streams, whose frames the program takes from a queue or receives in a callback.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut, Out},
    callback::{Callback, Release},
    cancellable::{Cancellable, Waitable},
    failure::{Code, Failure},
    frame::{self, Frame},
    handle,
    program::Program,
    robot::RobotHandle,
    subscriber::QueueOptions,
    subscription::{self, Source, Subscription},
};

/// A stream that this program watches. `rect_drop(&watch.id, ..)` ends it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Watcher {
    /// The handle.
    pub id: u64,
}

/// A callback for frames. The frame is valid until the callback returns.
pub type OnFrame = Option<extern "C" fn(frame: *const Frame, context: *mut c_void)>;

const NEWEST: rect::QueueOptions = rect::QueueOptions {
    capacity: 1,
    when_full: rect::WhenFull::DropOldest,
};

impl Waitable for rect::Watcher {
    const KIND: &'static str = "watch";
}

impl Source for rect::Watcher {
    type Item = rect::Frame;

    async fn next(&self) -> Option<rect::Frame> {
        Self::next(self).await
    }

    fn close(&self) {
        Self::close(self);
    }
}

fn declare(
    program: &Program,
    stream: &str,
    options: Option<&QueueOptions>,
) -> Result<rect::Watcher, Failure> {
    let options = QueueOptions::read(options, NEWEST)?;
    program.wait(program.robot.watch_with(stream, options))
}

fn open(
    robot: RobotHandle,
    stream: &str,
    options: Option<&QueueOptions>,
    watcher: Out<'_, Watcher>,
    with: impl FnOnce(rect::Watcher) -> rect::Watcher,
) -> Result<(), Failure> {
    require_out("watcher", &watcher)?;
    let program = robot.resolve()?;
    let declared = with(declare(&program, stream, options)?);
    let id = handle::insert(Cancellable::new(declared, &program));
    write_out("watcher", watcher, Watcher { id })
}

/// Receives a stream, `<robot>/<topic>`, and writes the handle to `watcher`. By default only the newest frame
/// waits for the program; `options` may specify a larger receive queue, or be NULL.
///
/// Returns `RECT_CODE_TOPIC` if the robot or topic is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_watch(
    robot: RobotHandle,
    stream: *const c_char,
    options: Option<&QueueOptions>,
    watcher: Option<&mut MaybeUninit<Watcher>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let stream = unsafe { text("stream", stream)? };
        open(robot, stream, options, watcher, std::convert::identity)
    })
}

/// Does what `rect_robot_watch` does, but leaves video undecoded: the payloads are the frames as they were sent, from a key frame
/// on, with the encoding `video/h264`. A program that saves or forwards them needs them all, and so a larger receive queue.
///
/// Returns `RECT_CODE_TOPIC` if the robot or topic is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_watch_undecoded(
    robot: RobotHandle,
    stream: *const c_char,
    options: Option<&QueueOptions>,
    watcher: Option<&mut MaybeUninit<Watcher>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let stream = unsafe { text("stream", stream)? };
        open(robot, stream, options, watcher, rect::Watcher::undecoded)
    })
}

/// Waits for the next frame and writes it to `frame`.
///
/// Returns `RECT_CODE_TIMED_OUT` if none arrives within `timeout_ms` (`RECT_FOREVER` waits without a limit), and
/// `RECT_CODE_CLOSED` if the session was closed or another thread dropped the watcher.
///
/// May be called on any thread; if several threads wait, one of them receives the frame.
#[no_mangle]
pub extern "C" fn rect_watcher_next(
    watcher: Watcher,
    timeout_ms: u32,
    frame: Option<&mut MaybeUninit<Frame>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("frame", &frame)?;
        let waiting = handle::get::<Cancellable<rect::Watcher>>(watcher.id)?;
        let next = waiting.next("frame", timeout_ms, rect::Watcher::next)?;
        write_out("frame", frame, frame::into_c(next))
    })
}

/// Asks the sender of a video for a key frame, with the next frame that arrives: for a program that decodes the video itself, and
/// has dropped frames. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_watcher_ask_for_key_frame(
    watcher: Watcher,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let watching = handle::get::<Cancellable<rect::Watcher>>(watcher.id)?;
        watching.source().ask_for_key_frame();
        Ok(())
    })
}

/// Writes the round trip of a small message to the stream's sender to `round_trip_us`, in microseconds; -1 until the first one
/// has been measured. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_watcher_round_trip(
    watcher: Watcher,
    round_trip_us: Option<&mut MaybeUninit<i64>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let watching = handle::get::<Cancellable<rect::Watcher>>(watcher.id)?;
        let measured = watching.source().round_trip().map(|time| time.as_micros());
        let us = measured.map_or(-1, |us| i64::try_from(us).unwrap_or(i64::MAX));
        write_out("round_trip_us", round_trip_us, us)
    })
}

/// Calls `callback` for each frame of a stream, one after another, on a thread of the subscription, until the subscription
/// is dropped. Frames that arrive during a call wait or are dropped as `options` specify; by default only the newest one is
/// kept.
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// Returns `RECT_CODE_TOPIC` if the robot or topic is invalid. May be called on any thread. The
/// callback may call any function of RECT and may drop its own subscription.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_on_frame(
    robot: RobotHandle,
    stream: *const c_char,
    options: Option<&QueueOptions>,
    callback: OnFrame,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("subscription", &subscription)?;
        // SAFETY: the caller follows the rules of rect.h.
        let stream = unsafe { text("stream", stream)? };
        let callback = require("callback", callback)?;
        let program = robot.resolve()?;
        let declared = declare(&program, stream, options)?;
        let started = subscription::start(
            &program.runtime,
            declared,
            wrapper,
            move |frame, context| {
                callback(&frame::view(frame), context);
            },
        )?;
        write_out("subscription", subscription, started)
    })
}

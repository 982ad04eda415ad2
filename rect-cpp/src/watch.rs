//! Owns watching a stream: its frames, one after another, or for a callback.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use rect::{Receiving, WhenFull};

use crate::{
    argument::{text, there},
    boundary::{call, give, wanted, ErrorOut},
    callback::{Callback, Release},
    failure::{Code, Failure},
    frame::{self, Frame},
    handle,
    program::Program,
    robot::Robot,
    subscriber::ReceivingOptions,
    subscription::{self, Source, Subscription},
    waiting::{Awaited, Waiting},
};

/// A stream that this program watches. `rect_drop(&watch.id, ..)` when no more frames are wanted.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Watch {
    /// Its handle.
    pub id: u64,
}

/// Called with a frame, which is there until it returns.
pub type OnFrame = Option<extern "C" fn(frame: *const Frame, context: *mut c_void)>;

const NEWEST: Receiving = Receiving {
    capacity: 1,
    when_full: WhenFull::NewestWins,
};

impl Awaited for rect::Watch {
    const KIND: &'static str = "watch";
}

impl Source for rect::Watch {
    type Item = rect::Frame;

    async fn next(&self) -> Option<rect::Frame> {
        self.recv().await
    }

    fn close(&self) {
        Self::close(self);
    }
}

fn declare(
    program: &Program,
    from: &str,
    topic: &str,
    receiving: Option<&ReceivingOptions>,
) -> Result<rect::Watch, Failure> {
    let receiving = ReceivingOptions::read(receiving, NEWEST)?;
    program.wait(program.robot.watch_with(from, topic, receiving))
}

/// Watches a robot's stream: the newest frame waits until it is taken, or as many as `receiving` says.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_watch(
    robot: Robot,
    from: *const c_char,
    topic: *const c_char,
    receiving: Option<&ReceivingOptions>,
    watch: Option<&mut MaybeUninit<Watch>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("watch", &watch)?;
        // SAFETY: as rect.h asks.
        let (from, topic) = unsafe { (text("from", from)?, text("topic", topic)?) };
        let program = robot.live()?;
        let declared = declare(&program, from, topic, receiving)?;
        let id = handle::insert(Waiting::new(declared, &program));
        give("watch", watch, Watch { id })
    })
}

/// The next frame; RECT_CODE_TIMED_OUT: there was none within `timeout_ms` (RECT_FOREVER: it waits as long as it takes);
/// RECT_CODE_CLOSED: the session was closed, or another thread dropped the watch.
///
/// Thread: any; of several that wait, one gets it.
#[no_mangle]
pub extern "C" fn rect_watch_next(
    watch: Watch,
    timeout_ms: u32,
    frame: Option<&mut MaybeUninit<Frame>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("frame", &frame)?;
        let waiting = handle::get::<Waiting<rect::Watch>>(watch.id)?;
        let next = waiting.next("frame", timeout_ms, rect::Watch::recv)?;
        give("frame", frame, frame::hold(next))
    })
}

/// Calls `callback` for each frame of a robot's stream, one after another, on a thread of its own, until the subscription is
/// dropped; while it runs, older frames are dropped as `receiving` says. `release` is called with `context` once, when
/// there will be no more calls, even where this call fails.
///
/// Thread: any. The callback may call any function of RECT, and drop its own subscription.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_on_frame(
    robot: Robot,
    from: *const c_char,
    topic: *const c_char,
    receiving: Option<&ReceivingOptions>,
    callback: OnFrame,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let called = Arc::new(Callback::new(context, release));
    call(error, || {
        wanted("subscription", &subscription)?;
        // SAFETY: as rect.h asks.
        let (from, topic) = unsafe { (text("from", from)?, text("topic", topic)?) };
        let callback = there("callback", callback)?;
        let program = robot.live()?;
        let declared = declare(&program, from, topic, receiving)?;
        let started = subscription::start(&program, declared, called, move |frame, context| {
            callback(&frame::view(frame), context);
        })?;
        give("subscription", subscription, started)
    })
}

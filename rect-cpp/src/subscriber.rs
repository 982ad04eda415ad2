//! Owns receiving: the messages of a pattern, one after another, or for a callback.
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
    handle,
    message::{self, Message},
    program::Program,
    robot::Robot,
    subscription::{self, Source, Subscription},
    text::choice,
    waiting::{Awaited, Waiting},
};

/// The messages of a pattern, which wait until they are taken. `rect_drop(&subscriber.id, ..)` when no more are wanted.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Subscriber {
    /// Its handle.
    pub id: u64,
}

/// What happens when one more comes than may wait.
#[repr(C)]
pub enum WhenFullChoice {
    /// The oldest is dropped: what the program gets is fresh. The default.
    NewestWins = 0,
    /// The new one is dropped: what the program gets has no gap before it is full.
    OldestWins = 1,
    /// Whoever sends waits. Nothing is dropped, and a program that does not read holds up everything of that urgency that
    /// comes over the same connection.
    Wait = 2,
}

/// How what comes waits for the program. `rect_receiving receiving = {0};` is the default, and so is NULL.
#[repr(C)]
pub struct ReceivingOptions {
    /// How many may wait; 0: 256 messages, or the newest frame alone.
    pub capacity: usize,
    /// What happens to more: a `rect_when_full`.
    pub when_full: u32,
}

/// Called with a message, which is there until it returns.
pub type OnMessage = Option<extern "C" fn(message: *const Message, context: *mut c_void)>;

impl ReceivingOptions {
    /// As the library has them, given its default.
    pub fn read(given: Option<&Self>, default: Receiving) -> Result<Receiving, Failure> {
        let Some(given) = given else {
            return Ok(default);
        };
        let rules = [
            (WhenFullChoice::NewestWins as u32, WhenFull::NewestWins),
            (WhenFullChoice::OldestWins as u32, WhenFull::OldestWins),
            (WhenFullChoice::Wait as u32, WhenFull::Wait),
        ];
        Ok(Receiving {
            capacity: match given.capacity {
                0 => default.capacity,
                capacity => capacity,
            },
            when_full: choice("receiving.when_full", &rules, given.when_full)?,
        })
    }
}

impl Awaited for rect::Subscriber {
    const KIND: &'static str = "subscriber";
}

impl Source for rect::Subscriber {
    type Item = rect::Message;

    async fn next(&self) -> Option<rect::Message> {
        self.recv().await
    }

    fn close(&self) {
        Self::close(self);
    }
}

fn declare(
    program: &Program,
    pattern: &str,
    receiving: Option<&ReceivingOptions>,
) -> Result<rect::Subscriber, Failure> {
    let receiving = ReceivingOptions::read(receiving, Receiving::default())?;
    program.wait(program.robot.subscribe_with(pattern, receiving))
}

/// The messages of a pattern, `<robot>/<topic>` with wildcards, as `*/arm/*`: what those robots say to all, and to this one
/// alone. `receiving`: NULL for the default.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_subscribe(
    robot: Robot,
    pattern: *const c_char,
    receiving: Option<&ReceivingOptions>,
    subscriber: Option<&mut MaybeUninit<Subscriber>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("subscriber", &subscriber)?;
        // SAFETY: as rect.h asks.
        let pattern = unsafe { text("pattern", pattern) }?;
        let program = robot.live()?;
        let declared = declare(&program, pattern, receiving)?;
        let id = handle::insert(Waiting::new(declared, &program));
        give("subscriber", subscriber, Subscriber { id })
    })
}

/// The next message; RECT_CODE_TIMED_OUT: there was none within `timeout_ms` (RECT_FOREVER: it waits as long as it takes);
/// RECT_CODE_CLOSED: the session was closed, or another thread dropped the subscriber.
///
/// Thread: any; of several that wait, one gets it.
#[no_mangle]
pub extern "C" fn rect_subscriber_next(
    subscriber: Subscriber,
    timeout_ms: u32,
    message: Option<&mut MaybeUninit<Message>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("message", &message)?;
        let waiting = handle::get::<Waiting<rect::Subscriber>>(subscriber.id)?;
        let next = waiting.next("message", timeout_ms, rect::Subscriber::recv)?;
        give("message", message, message::hold(next))
    })
}

/// How many messages were dropped because the program did not take them in time.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_subscriber_dropped(
    subscriber: Subscriber,
    dropped: Option<&mut MaybeUninit<u64>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let waiting = handle::get::<Waiting<rect::Subscriber>>(subscriber.id)?;
        give("dropped", dropped, waiting.source().dropped())
    })
}

/// Calls `callback` for each message of a pattern, one after another, on a thread of its own, until the subscription is
/// dropped. `release` is called with `context` once, when there will be no more calls, even where this call fails.
///
/// Thread: any. The callback may call any function of RECT, and drop its own subscription.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_on_message(
    robot: Robot,
    pattern: *const c_char,
    receiving: Option<&ReceivingOptions>,
    callback: OnMessage,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let called = Arc::new(Callback::new(context, release));
    call(error, || {
        wanted("subscription", &subscription)?;
        // SAFETY: as rect.h asks.
        let pattern = unsafe { text("pattern", pattern) }?;
        let callback = there("callback", callback)?;
        let program = robot.live()?;
        let declared = declare(&program, pattern, receiving)?;
        let started = subscription::start(&program, declared, called, move |message, context| {
            let flaw = message::flaw(message);
            callback(&message::view(message, flaw.as_deref()), context);
        })?;
        give("subscription", subscription, started)
    })
}

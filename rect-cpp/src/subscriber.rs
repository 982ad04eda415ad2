//! Subscribes to messages, which the program takes from a queue or receives in a callback.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::Arc,
};

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut},
    callback::{Callback, Release},
    cancellable::{Cancellable, Waitable},
    failure::{Code, Failure},
    handle,
    message::{self, Message},
    program::Program,
    robot::RobotHandle,
    sender_counts::{self, CountsBySender},
    subscription::{self, Source, Subscription},
    text::choice,
};

/// A subscription with a receive queue, from which `rect_subscriber_next` takes messages. `rect_drop(&subscriber.id, ..)`
/// ends the subscription.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Subscriber {
    /// The handle.
    pub id: u64,
}

/// The rule for an item that arrives when the receive queue is full.
#[repr(C)]
pub enum WhenFull {
    /// The oldest waiting item is dropped, so the program receives recent items. The default.
    DropOldest = 0,
    /// The new item is dropped, so the items that are already waiting have no gaps.
    DropNewest = 1,
    /// The sender waits, and nothing is dropped. A program that does not read then blocks all messages of the same urgency
    /// on the same link.
    Block = 2,
}

/// The settings of a receive queue. `rect_queue_options options = {0};` are the defaults, and so is NULL.
#[repr(C)]
pub struct QueueOptions {
    /// How many items may wait. 0 means the default: 256 messages, or 1 frame of a stream.
    pub capacity: usize,
    /// The rule for a full queue: a `rect_when_full`.
    pub when_full: u32,
}

/// The settings of a subscription. `rect_subscribe_options options = {0};` are the defaults, and so is NULL.
#[repr(C)]
pub struct SubscribeOptions {
    /// The settings of the receive queue.
    pub queue: QueueOptions,
    /// The largest number of messages of each topic per second, 0.01 to 1000; 0 means all, the default. The newest one wins. The
    /// router of the robot that publishes leaves out the others, so that they cost nothing on the air; they count as `skipped`, and not
    /// as missed. Messages that are sent to this robot alone, and retained ones, arrive as they are sent.
    pub max_hz: f64,
    /// Whether to receive only messages whose value differs from the last one. The default is no.
    pub on_change: bool,
}

/// A callback for messages. The message is valid until the callback returns.
pub type OnMessage = Option<extern "C" fn(message: *const Message, context: *mut c_void)>;

impl QueueOptions {
    /// Converts the options for the library, given its defaults.
    pub fn read(
        given: Option<&Self>,
        default: rect::QueueOptions,
    ) -> Result<rect::QueueOptions, Failure> {
        let Some(given) = given else {
            return Ok(default);
        };
        let rules = [
            (WhenFull::DropOldest as u32, rect::WhenFull::DropOldest),
            (WhenFull::DropNewest as u32, rect::WhenFull::DropNewest),
            (WhenFull::Block as u32, rect::WhenFull::Block),
        ];
        Ok(rect::QueueOptions {
            capacity: match given.capacity {
                0 => default.capacity,
                capacity => capacity,
            },
            when_full: choice("options.when_full", &rules, given.when_full)?,
        })
    }
}

impl Waitable for rect::Subscriber {
    const KIND: &'static str = "subscriber";
}

impl Source for rect::Subscriber {
    type Item = rect::Message;

    async fn next(&self) -> Option<rect::Message> {
        Self::next(self).await
    }

    fn close(&self) {
        Self::close(self);
    }
}

fn declare(
    program: &Program,
    pattern: &str,
    given: Option<&SubscribeOptions>,
) -> Result<rect::Subscriber, Failure> {
    let queue = given.map(|given| &given.queue);
    let mut options =
        rect::SubscribeOptions::from(QueueOptions::read(queue, rect::QueueOptions::default())?);
    if let Some(given) = given {
        options.max_hz = (given.max_hz != 0.0).then_some(given.max_hz);
        options.on_change = given.on_change;
    }
    program.wait(program.robot.subscribe_with(pattern, options))
}

/// Subscribes to a pattern, `<robot>/<topic>` with wildcards, e.g. `*/arm/*`, and writes the handle to `subscriber`. The
/// subscriber receives the matching messages that are published, and those that are sent to this robot. `options` may be
/// NULL for the defaults.
///
/// Returns `RECT_CODE_TOPIC` or `RECT_CODE_NAME` if the pattern is invalid, and `RECT_CODE_OPTION` if an option is. May be called on any
/// thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_subscribe(
    robot: RobotHandle,
    pattern: *const c_char,
    options: Option<&SubscribeOptions>,
    subscriber: Option<&mut MaybeUninit<Subscriber>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("subscriber", &subscriber)?;
        // SAFETY: the caller follows the rules of rect.h.
        let pattern = unsafe { text("pattern", pattern) }?;
        let program = robot.resolve()?;
        let declared = declare(&program, pattern, options)?;
        let id = handle::insert(Cancellable::new(declared, &program));
        write_out("subscriber", subscriber, Subscriber { id })
    })
}

/// Waits for the next message and writes it to `message`.
///
/// ```c
/// rect_message message;
/// while (rect_subscriber_next(subscriber, RECT_FOREVER, &message, &error) == RECT_CODE_OK) {
///     printf("%.*s\n", (int)message.sender.len, (const char *)message.sender.data);
///     rect_drop(&message.id, NULL);
/// }
/// ```
///
/// Returns `RECT_CODE_TIMED_OUT` if none arrives within `timeout_ms` (`RECT_FOREVER` waits without a limit), and
/// `RECT_CODE_CLOSED` if the session was closed or another thread dropped the subscriber.
///
/// May be called on any thread; if several threads wait, one of them receives the message.
#[no_mangle]
pub extern "C" fn rect_subscriber_next(
    subscriber: Subscriber,
    timeout_ms: u32,
    message: Option<&mut MaybeUninit<Message>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("message", &message)?;
        let waiting = handle::get::<Cancellable<rect::Subscriber>>(subscriber.id)?;
        let next = waiting.next("message", timeout_ms, rect::Subscriber::next)?;
        write_out("message", message, message::into_c(next))
    })
}

/// Writes the number of messages that the full receive queue has dropped to `dropped`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_subscriber_dropped(
    subscriber: Subscriber,
    dropped: Option<&mut MaybeUninit<u64>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let waiting = handle::get::<Cancellable<rect::Subscriber>>(subscriber.id)?;
        write_out("dropped", dropped, waiting.source().dropped())
    })
}

/// Writes how many messages of each robot the subscriber has received and missed to `counts`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_subscriber_counts_by_sender(
    subscriber: Subscriber,
    counts: Option<&mut MaybeUninit<CountsBySender>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("counts", &counts)?;
        let waiting = handle::get::<Cancellable<rect::Subscriber>>(subscriber.id)?;
        let counted = sender_counts::into_c(waiting.source().counts_by_sender());
        write_out("counts", counts, counted)
    })
}

/// Calls `callback` for each message that matches a pattern, one after another, on a thread of the subscription, until the
/// subscription is dropped. `pattern` and `options` are the same as for `rect_robot_subscribe`.
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// Returns `RECT_CODE_TOPIC` or `RECT_CODE_NAME` if the pattern is invalid, and `RECT_CODE_OPTION` if an option is. May be called on any
/// thread. The callback may call
/// any function of RECT and may drop its own subscription.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_on_message(
    robot: RobotHandle,
    pattern: *const c_char,
    options: Option<&SubscribeOptions>,
    callback: OnMessage,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("subscription", &subscription)?;
        // SAFETY: the caller follows the rules of rect.h.
        let pattern = unsafe { text("pattern", pattern) }?;
        let callback = require("callback", callback)?;
        let program = robot.resolve()?;
        let declared = declare(&program, pattern, options)?;
        let started = subscription::start(
            &program.runtime,
            declared,
            wrapper,
            move |message, context| {
                let problem = message::problem(message);
                callback(&message::view(message, problem.as_deref()), context);
            },
        )?;
        write_out("subscription", subscription, started)
    })
}

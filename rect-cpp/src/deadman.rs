//! Runs a dead man's switch: calls a callback for each command while commands arrive, and another one when the commander is lost.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc, Arc, Mutex,
    },
    thread::{self, JoinHandle, ThreadId},
    time::Duration,
};

use rect::{DeadmanCall, DeadmanCalls, Losses};
use rect_core::deadman::ENDED;
use tokio_util::sync::CancellationToken;

use crate::{
    argument::{require, text},
    boundary::{buffer, call, require_out, write_out, ErrorOut, ERROR_BYTES},
    callback::{Callback, Release},
    failure::{Code, Failure},
    handle::{self, lock, Object},
    message::{self, problem, Message},
    program::Program,
    robot::RobotHandle,
    subscriber::OnMessage,
};

/// A dead man's switch. `rect_drop(&deadman.id, ..)` ends it, which is a loss: when that returns, `on_lost` has been called, unless a
/// callback of the switch drops it. Then `on_lost` is called after this callback has returned.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Deadman {
    /// The handle.
    pub id: u64,
}

/// A callback that returns whether a message is a command. It is called before the message counts, and must not carry it out. The message
/// is valid until it returns.
pub type IsCommand = Option<extern "C" fn(message: *const Message, context: *mut c_void) -> bool>;

/// A callback for the loss of a commander, which stops the motors. `reason` is a text for people, which is valid until the callback
/// returns.
pub type OnLost = Option<extern "C" fn(reason: *const c_char, context: *mut c_void)>;

struct Switch {
    /// `None` after the end.
    calls: tokio::sync::Mutex<Option<DeadmanCalls<rect::Payload>>>,
    is_following: AtomicBool,
    end: CancellationToken,
}

type Call = DeadmanCall<rect::Message>;

struct RunningSwitch {
    switch: Arc<Switch>,
    /// The thread that calls `on_lost`. It ends after that of the commands.
    thread: Mutex<Option<JoinHandle<()>>>,
    /// The thread that calls `on_command`.
    commands: ThreadId,
}

impl Object for RunningSwitch {
    const KIND: &'static str = "dead man's switch";

    fn on_dropped(&self) {
        self.switch.end.cancel();
        let Some(thread) = lock(&self.thread).take() else {
            return;
        };
        if ![thread.thread().id(), self.commands].contains(&thread::current().id()) {
            // Fails only after a panic.
            let _ = thread.join();
        }
    }
}

impl Switch {
    fn declare(program: &Program, pattern: &str, within: Duration) -> Result<Self, Failure> {
        let calls = DeadmanCalls::begin(&program.robot, pattern, within);
        let calls = program.wait(calls).map_err(|failure| match failure {
            Failure::Rect(rect::Error::Option { source, .. }) => rect::Error::Option {
                option: "within_ms",
                value: within.as_millis().to_string(),
                source,
            }
            .into(),
            failure => failure,
        })?;
        Ok(Self {
            calls: tokio::sync::Mutex::new(Some(calls)),
            is_following: AtomicBool::new(false),
            end: CancellationToken::new(),
        })
    }

    /// Returns the next call of the program, and `None` after the end. Only one thread waits for it.
    async fn next<L: FnMut(&str)>(
        &self,
        losses: &Losses<L>,
        is_command: impl Fn(&rect::Message) -> bool,
    ) -> Option<Call> {
        let mut calls = self.calls.lock().await;
        let next = tokio::select! {
            biased;
            () = self.end.cancelled() => None,
            next = calls.as_mut()?.next(losses, is_command) => next,
        };
        let next = next.unwrap_or_else(|| {
            *calls = None;
            Call::Lost(ENDED.to_owned())
        });
        let is_following = matches!(next, Call::Command(_));
        self.is_following.store(is_following, Ordering::Release);
        Some(next)
    }
}

fn start(name: &str, run: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, Failure> {
    let thread = thread::Builder::new().name(name.to_owned()).spawn(run);
    Ok(thread.map_err(|source| rect::Error::Thread { source })?)
}

/// Calls a callback for messages, and returns its result; `None` if it is closed.
fn with_message<T>(
    callback: &Callback,
    message: &rect::Message,
    function: impl FnOnce(*const Message, *mut c_void) -> T,
) -> Option<T> {
    let problem = problem(message);
    let view = message::view(message, problem.as_deref());
    let mut result = None;
    callback.run(|context| result = Some(function(&view, context)));
    result
}

/// Carries out commands while they arrive: calls `on_command` for each message that matches `pattern`, and `on_lost`, which stops the
/// motors, when none has arrived for `within_ms` (20 to 60000), when the robot of the last one cannot be reached, while the fleet is
/// stopped (`rect_robot_fleet_stop`), and before the first one.
///
/// ```c
/// static void on_drive(const rect_message *message, void *context) { ... }
///
/// static void on_lost(const char *reason, void *context) {
///     stop_motors();
///     printf("stopped: %s\n", reason);
/// }
///
/// rect_robot_deadman(robot, "laptop/drive", 300, NULL, on_drive, on_lost, NULL, NULL, &deadman, &error);
/// ```
///
/// `on_lost` gets the reason, once for each loss; the next command resumes. After a stop, the first command that counts is a neutral one,
/// whose numbers are all 0. Retained and replayed messages never count, and neither do those that cannot be decoded, nor those for which
/// `is_command` returns false, such as a message that the program cannot read. `is_command` may be NULL.
///
/// `on_command` is called on a thread of its own, one command at a time. Commands that arrive meanwhile count only when it has returned: if
/// it takes longer than `within_ms`, the commander is lost. `on_lost` is called on another thread and does not wait for it: if
/// `on_command` is running, `on_lost` is called at once, and again as soon as that has returned, which may have started the motors in
/// between. `is_command` is called on the thread of `on_lost`, and not while `on_command` is running. All may call any function of RECT.
/// If this program itself hangs, nothing stops its motors: use the watchdog of the motor controller as well.
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// Returns `RECT_CODE_OPTION` if `within_ms` is invalid, and `RECT_CODE_TOPIC` or `RECT_CODE_NAME` if the pattern is. May be called on any
/// thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_deadman(
    robot: RobotHandle,
    pattern: *const c_char,
    within_ms: u32,
    is_command: IsCommand,
    on_command: OnMessage,
    on_lost: OnLost,
    context: *mut c_void,
    release: Release,
    deadman: Option<&mut MaybeUninit<Deadman>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let callback = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("deadman", &deadman)?;
        // SAFETY: the caller follows the rules of rect.h.
        let pattern = unsafe { text("pattern", pattern) }?;
        let on_command = require("on_command", on_command)?;
        let on_lost = require("on_lost", on_lost)?;
        let program = robot.resolve()?;
        let within = Duration::from_millis(within_ms.into());
        let switch = Arc::new(Switch::declare(&program, pattern, within)?);
        let (running, runtime) = (switch.clone(), program.runtime.clone());
        let of_losses = callback.clone();
        let losses = Arc::new(Losses::new(move |reason: &str| {
            let reason: [c_char; ERROR_BYTES] = buffer(reason);
            of_losses.run(|context| on_lost(reason.as_ptr(), context));
        }));
        let (sender, received) = mpsc::channel::<rect::Message>();
        let (of_commands, carried_out) = (callback.clone(), losses.clone());
        let commands = start("rect-commands", move || {
            for message in received {
                with_message(&of_commands, &message, |view, context| {
                    on_command(view, context);
                });
                carried_out.finish();
            }
        })?;
        let id_of_commands = commands.thread().id();
        let thread = start("rect-deadman", move || {
            let is_command = |message: &rect::Message| match is_command {
                Some(is_command) => with_message(&callback, message, |view, context| {
                    is_command(view, context)
                })
                .unwrap_or(false),
                None => true,
            };
            let act = |call| {
                match call {
                    Call::Command(message) => {
                        losses.begin();
                        // The other thread ends after this one.
                        let _ = sender.send(message);
                    }
                    Call::Lost(reason) => losses.on_lost(&reason),
                }
                true
            };
            runtime.for_each(|| running.next(&losses, is_command), act);
            drop(sender);
            // After a command that hangs, `on_lost` is called once more.
            let _ = commands.join();
            callback.close();
        })?;
        let id = handle::insert(RunningSwitch {
            switch,
            thread: Mutex::new(Some(thread)),
            commands: id_of_commands,
        });
        write_out("deadman", deadman, Deadman { id })
    })
}

/// Writes to `is_following` whether the robot follows commands. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_deadman_is_following(
    deadman: Deadman,
    is_following: Option<&mut MaybeUninit<bool>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let running: Arc<RunningSwitch> = handle::get(deadman.id)?;
        let following = running.switch.is_following.load(Ordering::Acquire);
        write_out("is_following", is_following, following)
    })
}

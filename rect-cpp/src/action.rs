//! Carries out the goals of actions with the callbacks of C programs.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::{Arc, Mutex},
    time::Duration,
};

use rect::{blocking::Runtime, Encoding, Payload};

use crate::{
    argument::{require, text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    callback::{Callback, Release},
    cancellable::{timeout, FOREVER},
    failure::{Code, Failure},
    handle::{self, lock, Object},
    payload::{readable_or_empty, PayloadView},
    program::Program,
    robot::RobotHandle,
    text::{string_into_c, StringView, Text},
};

/// An action of this program. `rect_drop(&action.id, ..)` ends it: its goals are cancelled, no further ones begin, and it waits for a call
/// in progress. A callback may drop its own action.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Action {
    /// The handle.
    pub id: u64,
}

/// The rules of an action. `rect_action_options options = {0};` are the defaults, and so is NULL.
#[repr(C)]
pub struct ActionOptions {
    /// The purpose of the action: at most 200 characters. NULL: nothing.
    pub about: *const c_char,
    /// Whether a new goal is refused while another one runs. Otherwise it preempts the other one, which is asked to end.
    pub refuse_when_busy: bool,
    /// How long the client of a goal has to be away until the goal is cancelled, in milliseconds: its program has ended, or its robot
    /// cannot be reached. 0: 5 s. `RECT_FOREVER`: the goal is carried out without its client, too.
    pub lost_after_ms: u32,
}

/// A goal that a callback carries out. It is valid until the callback returns.
#[repr(C)]
pub struct Goal {
    /// The handle, for the functions of the goal.
    pub id: u64,
    /// The id of the goal, which its client has chosen.
    pub goal_id: Text,
    /// The program that has started it: `<robot>/<program>`. The name is not verified: do not base permissions on it.
    pub by: Text,
    /// The goal itself: text, JSON or bytes. Empty if its client has given none.
    pub payload: PayloadView,
}

/// A callback that carries out a goal. The goal is valid until the callback returns.
pub type OnGoal = Option<extern "C" fn(goal: *const Goal, context: *mut c_void)>;

struct RunningAction {
    action: Mutex<Option<rect::Action>>,
    callback: Arc<Callback>,
}

impl Object for RunningAction {
    const KIND: &'static str = "action";

    fn on_dropped(&self) {
        let action = lock(&self.action).take();
        // Asks the callback to end.
        drop(action);
        self.callback.close();
    }
}

/// The result of a goal, or the text of its failure.
type GoalResult = Result<Payload, Payload>;

/// A goal that the callback carries out, with its result if there is one yet.
struct PendingGoal {
    goal: rect::Goal,
    payload: Payload,
    result: Mutex<Option<GoalResult>>,
    runtime: Arc<Runtime>,
}

impl Object for PendingGoal {
    const KIND: &'static str = "goal";
}

impl PendingGoal {
    fn set(&self, result: GoalResult) -> Result<(), Failure> {
        let mut known = lock(&self.result);
        if known.is_some() {
            return Err(Failure::argument("goal", "has a result already"));
        }
        *known = Some(result);
        Ok(())
    }
}

fn failure(text: &str) -> Payload {
    Payload::new(text.to_owned(), Encoding::TEXT)
}

/// Passes the goal to the program's callback and returns its result.
fn run_callback(
    goal: rect::Goal,
    runtime: Arc<Runtime>,
    callback: &Callback,
    function: extern "C" fn(*const Goal, *mut c_void),
) -> GoalResult {
    let pending = Arc::new(PendingGoal {
        payload: readable_or_empty(goal.payload.clone()),
        goal,
        result: Mutex::default(),
        runtime,
    });
    let called = callback.run(|context| {
        // Removed before the call ends, so that no handle is left when the action has been dropped.
        let id = handle::insert_shared(pending.clone());
        let view = Goal {
            id,
            goal_id: Text::of(&pending.goal.id),
            by: Text::of(&pending.goal.by),
            payload: PayloadView::of(&pending.payload),
        };
        function(&view, context);
        // Fails if the program has already dropped the goal.
        let _ = handle::remove(id);
    });
    if !called {
        return Err(failure("the action is ending"));
    }
    let result = lock(&pending.result).take();
    result.unwrap_or_else(|| Ok(Payload::new("", Encoding::BYTES)))
}

fn serve(
    program: &Program,
    options: rect::ActionOptions,
    function: extern "C" fn(*const Goal, *mut c_void),
    callback: Arc<Callback>,
) -> Result<Action, Failure> {
    // While a callback runs, the session has its runtime.
    let (wrapper, runtime) = (callback.clone(), program.runtime.clone());
    let action = program.robot.action(options, move |goal| {
        let (callback, runtime) = (wrapper.clone(), runtime.clone());
        async move {
            let work = move || run_callback(goal, runtime, &callback, function);
            let result = tokio::task::spawn_blocking(work).await;
            result.unwrap_or_else(|_| Err(failure("the action failed with an internal error")))
        }
    });
    let action = Mutex::new(Some(program.wait(action)?));
    let id = handle::insert(RunningAction { action, callback });
    Ok(Action { id })
}

/// Declares an action: a long task, such as driving to a place, which others start (`rect_robot_start`), follow and cancel. The callback
/// carries out one goal at a time, on a thread of its own. It ends a goal with `rect_goal_done` or `rect_goal_fail`, and returns; without
/// either, the goal is done and has no result.
///
/// ```c
/// static void on_dig(const rect_goal *goal, void *context) {
///     const rect_payload result = rect_payload_text("dug");
///     for (int done = 0; done < 10; ++done) {
///         rect_goal_feedback(goal->id, NULL, done / 10.0, NULL);
///         if (rect_goal_sleep(goal->id, 1000, NULL) != RECT_CODE_OK) {
///             return;
///         }
///     }
///     rect_goal_done(goal->id, &result, NULL);
/// }
///
/// rect_robot_action(robot, "dig", NULL, on_dig, NULL, NULL, &action, &error);
/// ```
///
/// Each goal has one end, which its client learns also after a cut. The robot's router keeps it for 10 minutes, and at most 16 for each
/// action. A result has at most 16 MB; this program keeps one of more than 48 kB for its clients, while it runs.
///
/// A callback that is cancelled should end soon (`rect_goal_is_cancelled`): a newer goal waits for that. A goal is also cancelled
/// when its client has left (`lost_after_ms`), and by the stop of the fleet, in which this program takes part.
///
/// `action_name` has 1 to 40 letters, digits, `_`, `-` and `.`. `options` may be NULL: the defaults. `release` is called once with
/// `context` when no more calls will follow, even if this function fails.
///
/// Returns `RECT_CODE_ACTION` if the name is invalid, and `RECT_CODE_SERVICE_REFUSED` if a program of this robot has the action already.
/// May be called on any thread. The callback may call any function of RECT.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_action(
    robot: RobotHandle,
    action_name: *const c_char,
    options: Option<&ActionOptions>,
    callback: OnGoal,
    context: *mut c_void,
    release: Release,
    action: Option<&mut MaybeUninit<Action>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("action", &action)?;
        // SAFETY: the caller follows the rules of rect.h.
        let name = unsafe { text("action_name", action_name) }?;
        let mut described = rect::ActionOptions::new(name);
        if let Some(options) = options {
            // SAFETY: the caller follows the rules of rect.h.
            let about = unsafe { text_or_none("options.about", options.about) }?;
            described = described.about(about.unwrap_or_default());
            if options.refuse_when_busy {
                described = described.refuse_when_busy();
            }
            described = match options.lost_after_ms {
                0 => described,
                FOREVER => described.lost_after(None),
                ms => described.lost_after(Some(timeout(ms))),
            };
        }
        let callback = require("callback", callback)?;
        let running = serve(&*robot.resolve()?, described, callback, wrapper)?;
        write_out("action", action, running)
    })
}

/// Reports news to those who follow a goal. `goal` is its `id`. `value` is a payload of at most 48 kB, and NULL for none. `progress` is how
/// much is done, from 0 to 1, and NAN if that is not known. The newest counts, and it is sent 10 times a second at most, without delaying
/// anything else. Does not wait.
///
/// Returns `RECT_CODE_ACTION` if the value is too large, and `RECT_CODE_HANDLE` after the callback has returned. May be called on any
/// thread.
#[no_mangle]
pub unsafe extern "C" fn rect_goal_feedback(
    goal: u64,
    value: Option<&PayloadView>,
    progress: f64,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let value = match value {
            // SAFETY: the caller follows the rules of rect.h.
            Some(value) => unsafe { value.read() }?,
            None => Payload::new("", Encoding::BYTES),
        };
        let pending: Arc<PendingGoal> = handle::get(goal)?;
        let progress = (!progress.is_nan()).then_some(progress);
        Ok(pending.goal.feedback(value, progress)?)
    })
}

/// Returns whether the callback should end: somebody has cancelled the goal, a newer one takes its place, its client has left, the fleet is
/// stopped, or the action ends. `goal` is the goal's `id`. If the callback returns after this was true, the goal counts as cancelled or
/// preempted, and otherwise as done. Returns true after the callback has returned. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_goal_is_cancelled(goal: u64) -> bool {
    let mut is_cancelled = true;
    // Fails after the callback has returned.
    let _ = call(None, || {
        is_cancelled = handle::get::<PendingGoal>(goal)?.goal.is_cancelled();
        Ok(())
    });
    is_cancelled
}

/// Writes to `reason` why the callback should end, as `rect_goal_is_cancelled` describes; empty if it should not. `goal` is the goal's
/// `id`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_goal_cancel_reason(
    goal: u64,
    reason: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("reason", &reason)?;
        let known = handle::get::<PendingGoal>(goal)?.goal.cancel_reason();
        write_out("reason", reason, string_into_c(known.unwrap_or_default()))
    })
}

/// Sleeps for `ms` milliseconds. `goal` is the goal's `id`.
///
/// Returns `RECT_CODE_CANCELLED` as soon as the callback should end, with the reason as the text, and `RECT_CODE_HANDLE` after it has
/// returned. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_goal_sleep(
    goal: u64,
    ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let pending: Arc<PendingGoal> = handle::get(goal)?;
        let time = Duration::from_millis(ms.into());
        // The timer needs the runtime when it is created.
        let slept = pending
            .runtime
            .wait(async { pending.goal.sleep(time).await });
        slept.map_err(|cancelled| Failure::Cancelled(cancelled.0))
    })
}

/// Gives a goal its result: a payload of at most 16 MB. NULL: none. `goal` is the goal's `id`. The goal ends when the callback returns. This
/// program keeps a result of more than 48 kB for 10 minutes, as long as it runs.
///
/// Returns `RECT_CODE_ARGUMENT` if it has a result or a failure already, and `RECT_CODE_HANDLE` after the callback has returned. May be
/// called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_goal_done(
    goal: u64,
    result: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let result = match result {
            // SAFETY: the caller follows the rules of rect.h.
            Some(result) => unsafe { result.read() }?,
            None => Payload::new("", Encoding::BYTES),
        };
        handle::get::<PendingGoal>(goal)?.set(Ok(result))
    })
}

/// Lets a goal fail. `reason` is a text for people. `goal` is the goal's `id`. The goal ends when the callback returns.
///
/// Returns the codes of `rect_goal_done`. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_goal_fail(
    goal: u64,
    reason: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let reason = unsafe { text("reason", reason) }?;
        handle::get::<PendingGoal>(goal)?.set(Err(failure(reason)))
    })
}

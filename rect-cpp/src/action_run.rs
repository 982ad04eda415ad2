//! Starts goals of actions of other programs, and follows them.
use std::{
    ffi::{c_char, c_void, CStr},
    mem::MaybeUninit,
    sync::Arc,
    time::Duration,
};

use rect::{Payload, Phase as LibraryPhase};
use tokio::sync::Mutex;
use tokio_util::sync::CancellationToken;

use crate::{
    argument::{require, text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    callback::{Callback, Release},
    cancellable::{timeout, Cancellable, Waitable, FOREVER},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::{self, readable, readable_or_empty, Buffer, PayloadView},
    program::Program,
    robot::RobotHandle,
    subscription::{self, Source, Subscription},
    text::{number, Text},
};

/// A goal that this program has started or found. `rect_drop(&run.id, ..)` does not cancel the goal.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct ActionRun {
    /// The handle.
    pub id: u64,
}

/// How a goal is started. `rect_start_options options = {0};` are the defaults, and so is NULL.
#[repr(C)]
pub struct StartOptions {
    /// The id of the goal: 1 to 40 letters, digits, underscores, hyphens and dots. NULL: RECT chooses it. A goal that is started again with its id
    /// runs once.
    pub goal_id: *const c_char,
    /// How often feedback is sent at most, per second: 0.1 to 50. 0: 10.
    pub feedback_per_s: f64,
}

/// How far a goal has come.
#[repr(C)]
pub enum Phase {
    /// It waits for the end of another goal.
    Waiting = 0,
    /// It is being carried out.
    Running = 1,
    /// It is being carried out, and was asked to end.
    Cancelling = 2,
    /// It was carried out. This and the following ones are the ends.
    Done = 3,
    /// It was not accepted, and never began.
    Refused = 4,
    /// Its program has failed at it.
    Failed = 5,
    /// Somebody has cancelled it.
    Cancelled = 6,
    /// A newer goal has taken its place.
    Preempted = 7,
    /// The program that carried it out has ended, so that nobody knows how far it came.
    Lost = 8,
}

const PHASES: [(u32, LibraryPhase); 9] = [
    (Phase::Waiting as u32, LibraryPhase::Waiting),
    (Phase::Running as u32, LibraryPhase::Running),
    (Phase::Cancelling as u32, LibraryPhase::Cancelling),
    (Phase::Done as u32, LibraryPhase::Done),
    (Phase::Refused as u32, LibraryPhase::Refused),
    (Phase::Failed as u32, LibraryPhase::Failed),
    (Phase::Cancelled as u32, LibraryPhase::Cancelled),
    (Phase::Preempted as u32, LibraryPhase::Preempted),
    (Phase::Lost as u32, LibraryPhase::Lost),
];

/// The status of a goal, as far as a program that follows it knows. Release it with `rect_drop(&status.id, ..)`.
#[repr(C)]
pub struct GoalStatus {
    /// The handle.
    pub id: u64,
    /// The robot that carries out the goal.
    pub robot: Text,
    /// The action.
    pub action: Text,
    /// The id of the goal.
    pub goal_id: Text,
    /// How far it has come: a `rect_phase`. It has ended from `RECT_PHASE_DONE` on.
    pub phase: u32,
    /// For how long it has been in this phase, in milliseconds. If its phase is `RECT_PHASE_CANCELLING`, it does not heed its cancel.
    pub phase_ms: u64,
    /// Why it has ended, or is asked to; empty if that is clear.
    pub reason: Text,
    /// How much is done, from 0 to 1, as its program has said last; NAN if it has not.
    pub progress: f64,
    /// Whether there was feedback.
    pub has_feedback: bool,
    /// The value of the newest feedback; empty if it has none.
    pub feedback: PayloadView,
    /// Whether the robot is reachable. If it is not, the goal goes on meanwhile, unless the rules of its action say otherwise.
    pub is_reachable: bool,
    /// For how long the robot has not been reachable, in milliseconds; 0 if it is.
    pub unreachable_ms: u64,
}

/// News of a goal. It is valid until the callback returns.
#[repr(C)]
pub struct Feedback {
    /// The value; empty if there is none.
    pub value: PayloadView,
    /// How much is done, from 0 to 1; NAN if that is not known.
    pub progress: f64,
}

/// A callback for feedback. The feedback is valid until the callback returns.
pub type OnFeedback = Option<extern "C" fn(feedback: *const Feedback, context: *mut c_void)>;

/// A goal of some robot, as its router keeps it.
#[repr(C)]
pub struct KnownGoal {
    /// The robot that carries it out.
    pub robot: Text,
    /// The action.
    pub action: Text,
    /// The id of the goal.
    pub goal_id: Text,
    /// How far it has come: a `rect_phase`.
    pub phase: u32,
    /// Why it has ended, or is asked to; empty if that is clear.
    pub reason: Text,
    /// The program that has started it: `<robot>/<program>`.
    pub by: Text,
    /// The program that carries it out; empty if it has no name.
    pub program: Text,
    /// When it was started, in milliseconds since 1970 by the clock of its robot.
    pub began_ms: u64,
    /// When it ended; 0 if it has not.
    pub ended_ms: u64,
    /// For how long the robot's router has known this state, in milliseconds: how long ago it began or ended, whatever the clock of the
    /// robot says.
    pub age_ms: u64,
    /// The goal itself; empty if it is long, or there is none.
    pub goal: PayloadView,
    /// Whether `result` has one.
    pub has_result: bool,
    /// The result; empty if there is none, or it has more than 48 kB: `rect_action_run_result` writes it.
    pub result: PayloadView,
}

/// A list of goals. Release it with `rect_drop(&goals.id, ..)`.
#[repr(C)]
pub struct KnownGoals {
    /// The handle.
    pub id: u64,
    /// The first goal.
    pub items: *const KnownGoal,
    /// Number of goals.
    pub len: usize,
}

struct Run {
    run: Arc<rect::ActionRun>,
    changes: Mutex<rect::ActionChanges>,
}

impl Waitable for Run {
    const KIND: &'static str = "goal that is followed";
}

impl Run {
    async fn next_change(&self) -> Option<()> {
        self.changes.lock().await.next().await
    }
}

/// The text and payloads of a status.
struct OwnedStatus {
    run: Arc<rect::ActionRun>,
    reason: String,
    feedback: Option<Payload>,
}

impl Object for OwnedStatus {
    const KIND: &'static str = "status of a goal";
}

struct OwnedGoals {
    _goals: Vec<(rect::KnownGoal, Option<Payload>, Option<Payload>)>,
    _views: Vec<KnownGoal>,
}

// SAFETY: the views point into the goals stored next to them, which never change.
unsafe impl Send for OwnedGoals {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedGoals {}

impl Object for OwnedGoals {
    const KIND: &'static str = "list of goals";
}

/// The feedback of a goal.
struct NewFeedback {
    /// Follows the goal.
    run: Arc<rect::ActionRun>,
    state: Mutex<(rect::ActionChanges, Option<News>)>,
    stop: CancellationToken,
}

/// The value and the progress of feedback.
type News = (Payload, Option<f64>);

impl Source for NewFeedback {
    type Item = News;

    async fn next(&self) -> Option<News> {
        let mut state = self.state.lock().await;
        let (changes, last) = &mut *state;
        loop {
            let news = news(&self.run);
            if news.is_some() && news != *last && !self.stop.is_cancelled() {
                last.clone_from(&news);
                return news;
            }
            tokio::select! {
                biased;
                () = self.stop.cancelled() => return None,
                changed = changes.next() => changed?,
            }
        }
    }

    fn close(&self) {
        self.stop.cancel();
    }
}

fn news(run: &rect::ActionRun) -> Option<News> {
    let value = run.feedback()?;
    Some((readable_or_empty(value), run.progress()))
}

fn resolve(run: ActionRun) -> Result<Arc<Cancellable<Run>>, Failure> {
    handle::get(run.id)
}

fn into_c(program: &Program, run: rect::ActionRun) -> ActionRun {
    let run = Run {
        changes: Mutex::new(run.changes()),
        run: Arc::new(run),
    };
    let id = handle::insert(Cancellable::new(run, program));
    ActionRun { id }
}

fn ms(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

fn view(payload: Option<&Payload>) -> PayloadView {
    payload.map_or(PayloadView::EMPTY, PayloadView::of)
}

/// Returns the name of a phase, a `rect_phase`, in lower case: `running`. Returns an empty text if there is no such phase. May be called
/// on any thread.
#[no_mangle]
pub extern "C" fn rect_phase_name(phase: u32) -> *const c_char {
    const NAMES: [&CStr; 9] = [
        c"waiting",
        c"running",
        c"cancelling",
        c"done",
        c"refused",
        c"failed",
        c"cancelled",
        c"preempted",
        c"lost",
    ];
    NAMES.get(phase as usize).unwrap_or(&c"").as_ptr()
}

/// Starts a goal of an action of the robot `target`, and writes the handle to `run`: returns as soon as it is accepted or refused, which
/// is its end.
///
/// ```c
/// const rect_payload depth = rect_payload_json("3");
/// rect_buffer result;
/// must(rect_robot_start(robot, "wombat-2", "dig", &depth, NULL, 10000, &run, &error));
/// must(rect_action_run_result(run, 60000, &result, &error));
/// ```
///
/// `goal` is a payload of at most 48 kB, and NULL for none. `options` may be NULL: the defaults. `timeout_ms` is at most 10 minutes.
///
/// Returns `RECT_CODE_NO_ACTION` if no program of the robot has the action, `RECT_CODE_ACTION` if an argument is invalid, and
/// `RECT_CODE_TIMED_OUT` or `RECT_CODE_INTERRUPTED` if the robot did not answer: the goal may have begun. Then start it again with the same
/// id, which is safe, or find it. The other codes are those of `rect_robot_request`. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_start(
    robot: RobotHandle,
    target: *const c_char,
    action_name: *const c_char,
    goal: Option<&PayloadView>,
    options: Option<&StartOptions>,
    timeout_ms: u32,
    run: Option<&mut MaybeUninit<ActionRun>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("run", &run)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (target, action) =
            unsafe { (text("target", target)?, text("action_name", action_name)?) };
        let mut described = rect::StartOptions::new();
        if let Some(options) = options {
            // SAFETY: the caller follows the rules of rect.h.
            if let Some(id) = unsafe { text_or_none("options.goal_id", options.goal_id) }? {
                described = described.id(id);
            }
            if options.feedback_per_s != 0.0 {
                described = described.feedback_per_s(options.feedback_per_s);
            }
        }
        let goal = match goal {
            // SAFETY: the caller follows the rules of rect.h.
            Some(goal) => unsafe { goal.read() }?,
            None => Payload::new("", rect::Encoding::BYTES),
        };
        let program = robot.resolve()?;
        let patient = program.robot.with_timeout(timeout(timeout_ms));
        let started = program.wait(patient.start_with(target, action, goal, described))?;
        write_out("run", run, into_c(&program, started))
    })
}

/// Finds a goal that this program or another one has started, and writes the handle to `run`: also after its end, which the robot's router
/// keeps for 10 minutes.
///
/// Returns `RECT_CODE_NO_GOAL` if the robot does not know it, or does not answer within `timeout_ms`. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_find(
    robot: RobotHandle,
    target: *const c_char,
    action_name: *const c_char,
    goal_id: *const c_char,
    timeout_ms: u32,
    run: Option<&mut MaybeUninit<ActionRun>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("run", &run)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (target, action, goal_id) = unsafe {
            (
                text("target", target)?,
                text("action_name", action_name)?,
                text("goal_id", goal_id)?,
            )
        };
        let program = robot.resolve()?;
        let patient = program.robot.with_timeout(timeout(timeout_ms));
        let found = program.wait(patient.find(target, action, goal_id))?;
        write_out("run", run, into_c(&program, found))
    })
}

/// Writes the goals of all actions of the robot `target`, or of all robots (`*`), to `goals`, the newest first: those that have not ended,
/// and those that did so within the last 10 minutes. A robot that does not answer within `timeout_ms` has none in the list.
///
/// Returns `RECT_CODE_NAME` if the name is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_goals(
    robot: RobotHandle,
    target: *const c_char,
    timeout_ms: u32,
    goals: Option<&mut MaybeUninit<KnownGoals>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("goals", &goals)?;
        // SAFETY: the caller follows the rules of rect.h.
        let target = match unsafe { text("target", target) }? {
            "*" => None,
            name => Some(rect::Name::new(name)?),
        };
        let program = robot.resolve()?;
        let patient = program.robot.with_timeout(timeout(timeout_ms));
        let known = program.wait(patient.goals(target.as_ref()))?;
        write_out("goals", goals, goals_into_c(known))
    })
}

fn goals_into_c(goals: Vec<rect::KnownGoal>) -> KnownGoals {
    let with_payloads = goals.into_iter().map(|known| {
        let goal = known.state.goal.as_ref().map(rect_core::action::to_payload);
        let (goal, result) = (goal.map(readable), known.state.result().map(readable));
        (known, goal, result)
    });
    let goals: Vec<_> = with_payloads.collect();
    let views = goals.iter().map(|(known, goal, result)| KnownGoal {
        robot: Text::of(known.robot.as_str()),
        action: Text::of(&known.action),
        goal_id: Text::of(&known.id),
        phase: number(&PHASES, &known.state.phase),
        reason: Text::of(&known.state.reason),
        by: Text::of(&known.state.by),
        program: Text::of(&known.state.program),
        began_ms: known.state.began_ms,
        ended_ms: known.state.ended_ms.unwrap_or(0),
        age_ms: ms(known.state.age),
        goal: view(goal.as_ref()),
        has_result: result.is_some(),
        result: view(result.as_ref()),
    });
    let views: Vec<_> = views.collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedGoals {
        _goals: goals,
        _views: views,
    });
    KnownGoals { id, items, len }
}

/// Writes what is known of a goal now to `status`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_action_run_status(
    run: ActionRun,
    status: Option<&mut MaybeUninit<GoalStatus>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("status", &status)?;
        let run = resolve(run)?.source().run.clone();
        let owned = Arc::new(OwnedStatus {
            reason: run.reason(),
            feedback: run.feedback().map(readable_or_empty),
            run,
        });
        let run = &owned.run;
        let unreachable = run.unreachable_for();
        let known = GoalStatus {
            id: handle::insert_shared(owned.clone()),
            robot: Text::of(run.robot().as_str()),
            action: Text::of(run.action()),
            goal_id: Text::of(run.id()),
            phase: number(&PHASES, &run.phase()),
            phase_ms: ms(run.phase_for()),
            reason: Text::of(&owned.reason),
            progress: run.progress().unwrap_or(f64::NAN),
            has_feedback: owned.feedback.is_some(),
            feedback: view(owned.feedback.as_ref()),
            is_reachable: unreachable.is_none(),
            unreachable_ms: ms(unreachable.unwrap_or_default()),
        };
        write_out("status", status, known)
    })
}

/// Waits for a change of a goal that was not known when this was called last, or when the handle was created: of its phase, of its
/// feedback, and whether its robot is reachable. Several are reported as one.
///
/// Returns `RECT_CODE_END` if the goal has ended and that was reported, `RECT_CODE_TIMED_OUT` if there is no change within `timeout_ms`
/// (`RECT_FOREVER` waits without a limit), and `RECT_CODE_CLOSED` if the session was closed or another thread dropped the handle. May be
/// called on any thread; if several threads wait, one of them continues.
#[no_mangle]
pub extern "C" fn rect_action_run_wait_for_change(
    run: ActionRun,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let waiting = resolve(run)?;
        let changed = waiting.next("change", timeout_ms, |run| async {
            Some(run.next_change().await)
        })?;
        let has_ended = || waiting.source().run.phase().is_end();
        changed.ok_or_else(|| match has_ended() {
            true => Failure::End,
            false => Failure::Closed,
        })
    })
}

/// Calls a callback for the newest feedback of a goal, at once if there is some, and then whenever there is newer one, until
/// `rect_drop(&subscription.id, ..)`, also after the run was dropped. The calls are made one after another, on a thread of the subscription;
/// feedback that arrives meanwhile replaces earlier one. Feedback that does not differ from the one before is not reported.
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// May be called on any thread. The callback may call any function of RECT and may drop its own subscription.
#[no_mangle]
pub extern "C" fn rect_action_run_on_feedback(
    run: ActionRun,
    callback: OnFeedback,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("subscription", &subscription)?;
        let callback = require("callback", callback)?;
        let followed = resolve(run)?;
        let run = followed.source().run.clone();
        let source = NewFeedback {
            state: Mutex::new((run.changes(), None)),
            run,
            stop: CancellationToken::new(),
        };
        let invoke = move |(value, progress): &News, context: *mut c_void| {
            let feedback = Feedback {
                value: PayloadView::of(value),
                progress: progress.unwrap_or(f64::NAN),
            };
            callback(&feedback, context);
        };
        let started = subscription::start(followed.runtime(), source, wrapper, invoke)?;
        write_out("subscription", subscription, started)
    })
}

/// Asks the callback of a goal to end. Returns when its robot has the wish; the end follows as soon as the callback heeds it. Nothing
/// happens if the goal has ended. Returns the codes of `rect_robot_request`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_action_run_cancel(
    run: ActionRun,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        resolve(run)?.wait(|followed| followed.run.cancel())
    })
}

/// Waits for the end of a goal, and writes its result to `result`: text, JSON or bytes; `null` as JSON if there is none. A robot that cannot
/// be reached does not end the wait. A result of more than 48 kB is received from the program that has carried out the goal, which has to
/// run until then.
///
/// Returns `RECT_CODE_GOAL` if the goal was not reached, or its result is lost: the text states the end and the reason, and
/// `rect_action_run_status` has both; `RECT_CODE_TIMED_OUT` if it has not ended within `timeout_ms` (`RECT_FOREVER` waits without a limit):
/// the text states its phase, and for how long it has been in it, or how much of the result has arrived; and `RECT_CODE_CLOSED` if the
/// session was closed or another thread dropped the handle. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_action_run_result(
    run: ActionRun,
    timeout_ms: u32,
    result: Option<&mut MaybeUninit<Buffer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("result", &result)?;
        let end = resolve(run)?.wait(|followed| async move {
            match timeout_ms {
                FOREVER => followed.run.end().await,
                ms => {
                    followed
                        .run
                        .end_within(Duration::from_millis(ms.into()))
                        .await
                }
            }
        })?;
        write_out("result", result, payload::into_c(readable(end)))
    })
}

//! The blocking form of actions: their handlers run on threads of their own.
use std::{fmt, sync::Arc, time::Duration};

use serde::de::DeserializeOwned;

use super::{Robot, Runtime};
use crate::{
    session, Action, ActionOptions, Cancelled, Error, KnownGoal, Name, Payload, Phase,
    StartOptions, ToPayload,
};

/// A goal that a handler carries out; see [`Robot::action`]. Clones are the same one.
#[derive(Clone)]
pub struct Goal {
    /// The id, which its client has chosen.
    pub id: String,
    /// The program that has started it: `<robot>/<program>`. Zenoh does not verify the name.
    pub by: String,
    /// The goal itself: `goal.payload.value::<Target>()`. Empty if its client has given none.
    pub payload: Payload,
    goal: session::Goal,
    runtime: Arc<Runtime>,
}

/// A goal that this program has [started](Robot::start) or [found](Robot::find). Dropping it does not cancel the goal.
pub struct ActionRun {
    run: session::ActionRun,
    runtime: Arc<Runtime>,
}

/// Reports changes of a goal; created by [`ActionRun::changes`]. The iterator blocks until the next one, and ends with the goal.
#[derive(Debug)]
pub struct ActionChanges {
    changes: session::ActionChanges,
    runtime: Arc<Runtime>,
}

impl Robot {
    /// Declares an action, whose goals `handler` carries out, one at a time, on a thread of its own; see [`crate::Robot::action`].
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # fn dig(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// let _action = robot.action("dig", |goal| {
    ///     let depth: u32 = goal.payload.value().map_err(|error| error.to_string())?;
    ///     for done in 0..depth {
    ///         goal.feedback("", Some(f64::from(done) / f64::from(depth))).map_err(|error| error.to_string())?;
    ///         goal.sleep(Duration::from_secs(1)).map_err(|cancelled| cancelled.to_string())?;
    ///     }
    ///     Ok::<_, String>("dug")
    /// })?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn action<F, V, E>(
        &self,
        action: impl Into<ActionOptions>,
        handler: F,
    ) -> Result<Action, Error>
    where
        F: Fn(Goal) -> Result<V, E> + Send + Sync + 'static,
        V: ToPayload + Send + 'static,
        E: ToPayload + Send + 'static,
    {
        let handler = Arc::new(handler);
        // While a handler runs, the session has its runtime.
        let runtime = self.runtime.clone();
        let action = self.robot.action(action, move |goal: session::Goal| {
            let (handler, runtime) = (handler.clone(), runtime.clone());
            async move {
                let goal = Goal::new(goal, runtime);
                match tokio::task::spawn_blocking(move || handler(goal)).await {
                    Ok(result) => result,
                    // The action reports the panic, as that of its own function.
                    Err(error) => match error.try_into_panic() {
                        Ok(panic) => std::panic::resume_unwind(panic),
                        Err(_) => std::future::pending().await,
                    },
                }
            }
        });
        self.runtime.wait(action)
    }

    /// Starts a goal of an action of `robot`, and blocks until it is accepted or refused, which is its end; see [`crate::Robot::start`].
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # fn dig(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// let run = robot.start("wombat-2", "dig", rect::Json(3))?;
    /// let result = run.result::<String>(Some(Duration::from_secs(60)))?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn start(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        action: &str,
        goal: impl ToPayload,
    ) -> Result<ActionRun, Error> {
        self.run(self.runtime.wait(self.robot.start(robot, action, goal)))
    }

    /// Does the same as [`start`](Self::start), with an id for the goal, or another rate of feedback; see [`crate::Robot::start_with`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn start_with(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        action: &str,
        goal: impl ToPayload,
        options: StartOptions,
    ) -> Result<ActionRun, Error> {
        let started = self.robot.start_with(robot, action, goal, options);
        self.run(self.runtime.wait(started))
    }

    /// Returns a goal that this program or another one has started; see [`crate::Robot::find`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn find(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        action: &str,
        id: &str,
    ) -> Result<ActionRun, Error> {
        self.run(self.runtime.wait(self.robot.find(robot, action, id)))
    }

    /// Returns the goals of all actions of `robot`, or of all robots (`None`); see [`crate::Robot::goals`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn goals(&self, robot: Option<&Name>) -> Result<Vec<KnownGoal>, Error> {
        self.runtime.wait(self.robot.goals(robot))
    }

    fn run(&self, run: Result<session::ActionRun, Error>) -> Result<ActionRun, Error> {
        let runtime = self.runtime.clone();
        Ok(ActionRun { run: run?, runtime })
    }
}

impl Goal {
    fn new(goal: session::Goal, runtime: Arc<Runtime>) -> Self {
        Self {
            id: goal.id.clone(),
            by: goal.by.clone(),
            payload: goal.payload.clone(),
            goal,
            runtime,
        }
    }

    /// Reports news to those who follow the goal; see [`crate::Goal::feedback`]. Does not wait.
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn feedback(&self, value: impl ToPayload, progress: Option<f64>) -> Result<(), Error> {
        self.goal.feedback(value, progress)
    }

    /// Returns whether the handler should end; see [`crate::Goal::is_cancelled`].
    pub fn is_cancelled(&self) -> bool {
        self.goal.is_cancelled()
    }

    /// Returns why the handler should end, as [`is_cancelled`](Self::is_cancelled) describes.
    pub fn cancel_reason(&self) -> Option<String> {
        self.goal.cancel_reason()
    }

    /// Sleeps.
    ///
    /// # Errors
    /// [`Cancelled`] as soon as the handler should end.
    pub fn sleep(&self, time: Duration) -> Result<(), Cancelled> {
        // The timer needs the runtime when it is created.
        self.runtime.wait(async { self.goal.sleep(time).await })
    }
}

impl ActionRun {
    /// Returns the id of the goal.
    pub fn id(&self) -> &str {
        self.run.id()
    }

    /// Returns the robot that carries out the goal.
    pub fn robot(&self) -> &Name {
        self.run.robot()
    }

    /// Returns the action.
    pub fn action(&self) -> &str {
        self.run.action()
    }

    /// Returns how far the goal has come.
    pub fn phase(&self) -> Phase {
        self.run.phase()
    }

    /// Returns for how long the goal has been in this phase; see [`crate::ActionRun::phase_for`].
    pub fn phase_for(&self) -> Duration {
        self.run.phase_for()
    }

    /// Returns why the goal has ended, or is asked to; empty if that is clear.
    pub fn reason(&self) -> String {
        self.run.reason()
    }

    /// Returns how much is done, from 0 to 1, as its handler has said last.
    pub fn progress(&self) -> Option<f64> {
        self.run.progress()
    }

    /// Returns the value of the newest feedback.
    pub fn feedback(&self) -> Option<Payload> {
        self.run.feedback()
    }

    /// Returns for how long the robot has not been reachable; see [`crate::ActionRun::unreachable_for`].
    pub fn unreachable_for(&self) -> Option<Duration> {
        self.run.unreachable_for()
    }

    /// Reports changes from now on: of the phase, of the feedback, and whether the robot is reachable.
    pub fn changes(&self) -> ActionChanges {
        ActionChanges {
            changes: self.run.changes(),
            runtime: self.runtime.clone(),
        }
    }

    /// Asks the handler to end; see [`crate::ActionRun::cancel`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn cancel(&self) -> Result<(), Error> {
        self.runtime.wait(self.run.cancel())
    }

    /// Blocks until the end of the goal, and returns its result as a value. A robot that cannot be reached does not end the wait:
    /// `timeout` limits it (`None`: nothing does).
    ///
    /// # Errors
    /// [`Error::TimedOut`] if it has not ended in time: the error states its phase, and for how long it has been in it. The other errors
    /// are those of [`crate::ActionRun::result`].
    pub fn result<T: DeserializeOwned>(&self, timeout: Option<Duration>) -> Result<T, Error> {
        Ok(self.end(timeout)?.value()?)
    }

    /// Does the same as [`result`](Self::result), and returns the payload of the result.
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn end(&self, timeout: Option<Duration>) -> Result<Payload, Error> {
        self.runtime.wait(async {
            match timeout {
                Some(timeout) => self.run.end_within(timeout).await,
                None => self.run.end().await,
            }
        })
    }
}

impl Iterator for ActionChanges {
    type Item = ();

    fn next(&mut self) -> Option<()> {
        self.runtime.wait(self.changes.next())
    }
}

impl fmt::Debug for Goal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.goal.fmt(f)
    }
}

impl fmt::Debug for ActionRun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.run.fmt(f)
    }
}

//! Starts goals at other programs, and follows them.
use std::{
    fmt,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use rect_core::{
    action::{
        self, goal_id,
        order::{self, Order},
        run,
        state::{Feedback, KnownGoal, Phase},
        to_optional_value, to_payload,
    },
    catalogue::{Program, DECLARED_WITHIN},
    message::{
        encoding::Encoding,
        payload::{Payload, ToPayload},
        Message,
    },
    name::{
        parameter::is_name,
        topic::{Pattern, Topic},
        Name,
    },
    text::humanize,
    transfer::Progress,
};
use serde::de::DeserializeOwned;
use tokio::{sync::watch, task::JoinHandle};

use crate::{
    error::{valid, Error},
    session::{
        action::{pull::Pulled, StartOptions},
        events::Events,
        robot::Robot,
        shared::{lock, sleep_until},
        subscriber::Subscriber,
    },
};

/// A goal that this program has [started](Robot::start) or [found](Robot::find). Dropping it does not cancel the goal.
pub struct ActionRun {
    followed: Arc<Followed>,
    task: Option<JoinHandle<()>>,
}

/// Reports changes of a goal; created by [`ActionRun::changes`].
pub struct ActionChanges(watch::Receiver<()>, Arc<Followed>);

struct Followed {
    robot: Robot,
    target: Name,
    action: String,
    id: String,
    run: Mutex<run::ActionRun>,
    pulled: Pulled,
    changes: watch::Sender<()>,
}

/// The subscriptions to a goal.
struct Received {
    states: Subscriber<Payload>,
    feedback: Subscriber<Payload>,
    events: Events,
}

impl Robot {
    /// Starts a goal of an action of `robot`, and returns as soon as it is accepted or refused, which is its end.
    ///
    /// ```no_run
    /// # async fn dig(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let run = robot.start("wombat-2", "dig", rect::Json(3)).await?;
    /// let result = run.result::<String>().await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::NoAction`] if no program of the robot has the action, [`Error::Action`] if an argument is invalid, and
    /// [`Error::TimedOut`] or [`Error::Interrupted`] if the robot did not answer: the goal may have begun. Then start it
    /// [again with the same id](StartOptions::id), which is safe, or [find](Self::find) it. The other errors are those of
    /// [`request`](Self::request).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the goal may have begun.
    pub async fn start(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        action: &str,
        goal: impl ToPayload,
    ) -> Result<ActionRun, Error> {
        self.start_with(robot, action, goal, StartOptions::default())
            .await
    }

    /// Does the same as [`start`](Self::start), with an id for the goal, or another rate of feedback.
    ///
    /// # Errors
    /// Returns the same errors.
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the goal may have begun.
    pub async fn start_with(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        action: &str,
        goal: impl ToPayload,
        options: StartOptions,
    ) -> Result<ActionRun, Error> {
        let target: Name = valid(robot)?;
        let wrong = |reason| Error::Action { reason };
        if !is_name(action) {
            return Err(wrong(action::wrong_action(action)));
        }
        let goal = to_optional_value(&goal.into_payload()?.sendable()?).map_err(wrong)?;
        let id = options.id.unwrap_or_else(|| goal_id(rand::random()));
        let order = Order::Start(order::Start {
            id: id.clone(),
            goal,
            by: self.program_name(),
            feedback_per_s: options.feedback_per_s,
        });
        let payload = order.write();
        Order::read(&payload).map_err(wrong)?;
        // Before the goal begins, so that its first feedback arrives.
        let received = self.receive(&target, action, &id).await?;
        match self.retrying().give_order(&target, action, &payload).await {
            Ok(()) => {}
            Err(Error::Service { payload, .. }) => {
                let reason = payload.text().unwrap_or("the action gave no reason");
                let refused = run::ActionRun::refused(target.clone(), reason, Instant::now());
                let followed = Followed::new(self, target, action, &id, refused);
                return Ok(ActionRun {
                    followed,
                    task: None,
                });
            }
            Err(error) => return Err(error),
        }
        Ok(self.follow(target, action, &id, received, None))
    }

    /// Returns a goal that this program or another one has started.
    ///
    /// # Errors
    /// [`Error::NoGoal`] if the robot does not know it, [`Error::NotReachable`] if it does not answer, and [`Error::Closed`] if the
    /// session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn find(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        action: &str,
        id: &str,
    ) -> Result<ActionRun, Error> {
        let target: Name = valid(robot)?;
        let asked = self.ask_for_goals(target.as_str(), action, id, self.timeout);
        let answers = asked.await?;
        if answers.goals.is_empty() {
            return Err(match answers.robots.contains(&target) {
                true => Error::NoGoal {
                    robot: target,
                    action: action.to_owned(),
                    goal: id.to_owned(),
                },
                false => Error::NotReachable {
                    available: self.peers().await.unwrap_or_default(),
                    robot: target,
                },
            });
        }
        let received = self.receive(&target, action, id).await?;
        Ok(self.follow(target, action, id, received, answers.goals.first()))
    }

    /// Returns the goals of all actions of `robot`, or of all robots (`None`), which have not ended or did so within the last 10 minutes,
    /// the newest first.
    ///
    /// # Errors
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn goals(&self, robot: Option<&Name>) -> Result<Vec<KnownGoal>, Error> {
        let robot = robot.map_or("*", Name::as_str);
        let answers = self.ask_for_goals(robot, "*", "*", self.timeout).await?;
        let mut goals: Vec<_> = answers.goals.iter().filter_map(KnownGoal::of).collect();
        goals.sort_by_key(|goal| std::cmp::Reverse(goal.state.began_ms));
        Ok(goals)
    }

    async fn receive(&self, target: &Name, action: &str, id: &str) -> Result<Received, Error> {
        let of_goal = |topic: String| Pattern::of(Some(target.clone()), &topic);
        Ok(Received {
            states: self.subscribe(of_goal(action::topic(action, id))?).await?,
            feedback: self
                .subscribe(of_goal(action::feedback_topic(action, id))?)
                .await?,
            events: self.events().await?,
        })
    }

    /// Follows a goal that was accepted, or was found: then with the answer about its state.
    fn follow(
        &self,
        target: Name,
        action: &str,
        id: &str,
        received: Received,
        found: Option<&Message>,
    ) -> ActionRun {
        let mut run = run::ActionRun::new(target.clone(), Instant::now());
        if found.is_some() {
            run.on_answer(found, Instant::now());
        }
        let followed = Followed::new(self, target, action, id, run);
        let task = self.inner.runtime.spawn(followed.clone().follow(received));
        ActionRun {
            followed,
            task: Some(task),
        }
    }

    /// Gives an order to an action.
    async fn give_order(&self, robot: &Name, action: &str, order: &Payload) -> Result<(), Error> {
        let topic = Topic::of_action(action).ok_or_else(|| Error::Action {
            reason: action::wrong_action(action),
        })?;
        let until = Instant::now() + DECLARED_WITHIN;
        loop {
            match self.request::<Payload>(robot, topic.clone(), order).await {
                Ok(_) => return Ok(()),
                Err(Error::NoService { .. }) => {
                    let actions = |program: &Program| {
                        program.actions().map(|(name, _)| name.to_owned()).collect()
                    };
                    if let Some(available) =
                        self.unless_declared(robot, action, until, actions).await
                    {
                        return Err(Error::NoAction {
                            robot: robot.clone(),
                            action: action.to_owned(),
                            available,
                        });
                    }
                }
                Err(error) => return Err(error),
            }
        }
    }
}

impl Followed {
    fn new(robot: &Robot, target: Name, action: &str, id: &str, run: run::ActionRun) -> Arc<Self> {
        Arc::new(Self {
            robot: robot.clone(),
            target,
            action: action.to_owned(),
            id: id.to_owned(),
            run: Mutex::new(run),
            pulled: Pulled::default(),
            changes: watch::Sender::new(()),
        })
    }

    /// Follows the goal to its end, or to that of the session.
    async fn follow(self: Arc<Self>, received: Received) {
        self.follow_to_end(received).await;
        self.changes.send_replace(());
    }

    async fn follow_to_end(&self, received: Received) {
        let Received {
            states,
            feedback,
            events,
        } = received;
        while !lock(&self.run).has_ended() {
            let deadline = lock(&self.run).deadline();
            let due = sleep_until(deadline);
            let has_changed = tokio::select! {
                biased;
                message = states.next() => {
                    let Some(message) = message else { return };
                    lock(&self.run).on_message(&message, Instant::now())
                }
                message = feedback.next() => {
                    let Some(message) = message else { return };
                    let feedback = Feedback::read(&message.payload);
                    feedback.is_ok_and(|feedback| {
                        lock(&self.run).on_feedback(feedback, Instant::now());
                        true
                    })
                }
                event = events.next() => {
                    let Some(event) = event else { return };
                    lock(&self.run).on_event(&event, Instant::now())
                }
                () = due => {
                    let asks = lock(&self.run).asks(Instant::now());
                    asks && self.ask().await
                }
            };
            if has_changed {
                self.changes.send_replace(());
            }
        }
    }

    /// Asks the robot for the state.
    async fn ask(&self) -> bool {
        let Self { robot, target, .. } = self;
        let asked = robot.ask_for_goals(target.as_str(), &self.action, &self.id, robot.timeout);
        let answer = asked.await;
        let mut run = lock(&self.run);
        match answer {
            Ok(answers) if answers.robots.contains(target) => {
                run.on_answer(answers.goals.first(), Instant::now())
            }
            _ => {
                run.on_no_answer(Instant::now());
                false
            }
        }
    }
}

impl ActionRun {
    /// Returns the id of the goal.
    pub fn id(&self) -> &str {
        &self.followed.id
    }

    /// Returns the robot that carries out the goal.
    pub fn robot(&self) -> &Name {
        &self.followed.target
    }

    /// Returns the action.
    pub fn action(&self) -> &str {
        &self.followed.action
    }

    /// Returns how far the goal has come.
    pub fn phase(&self) -> Phase {
        lock(&self.followed.run).state().phase
    }

    /// Returns for how long the goal has been in this phase: for a goal that does not heed its cancel, how long ago that was.
    pub fn phase_for(&self) -> Duration {
        lock(&self.followed.run).since().elapsed()
    }

    /// Returns why the goal has ended, or is asked to; empty if that is clear.
    pub fn reason(&self) -> String {
        lock(&self.followed.run).state().reason.clone()
    }

    /// Returns how much is done, from 0 to 1, as its handler has said last.
    pub fn progress(&self) -> Option<f64> {
        lock(&self.followed.run).feedback()?.progress
    }

    /// Returns the value of the newest feedback.
    pub fn feedback(&self) -> Option<Payload> {
        let run = lock(&self.followed.run);
        run.feedback().map(|feedback| to_payload(&feedback.value))
    }

    /// Returns how much of a result of more than 48 kB has arrived, since [`end`](Self::end) or [`result`](Self::result) has asked for it and
    /// until all of it has.
    pub fn result_progress(&self) -> Option<Progress> {
        self.followed.pulled.progress()
    }

    /// Returns for how long the robot has not been reachable; `None` if it is. The goal goes on meanwhile, unless the rules of its action
    /// say otherwise.
    pub fn unreachable_for(&self) -> Option<Duration> {
        let since = lock(&self.followed.run).unreachable_since();
        since.map(|since| since.elapsed())
    }

    /// Reports changes from now on: of the phase, of the feedback, and whether the robot is reachable.
    pub fn changes(&self) -> ActionChanges {
        ActionChanges(self.followed.changes.subscribe(), self.followed.clone())
    }

    /// Asks the handler to end. Returns when the robot has the wish; the end follows as soon as the handler heeds it.
    ///
    /// # Errors
    /// Returns the errors of [`request`](Robot::request).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the goal may be cancelled or not.
    pub async fn cancel(&self) -> Result<(), Error> {
        let Followed {
            robot,
            target,
            action,
            id,
            run,
            ..
        } = &*self.followed;
        if lock(run).has_ended() {
            return Ok(());
        }
        let order = Order::Cancel(order::Cancel {
            id: id.clone(),
            by: robot.program_name(),
        });
        robot
            .urgent()
            .give_order(target, action, &order.write())
            .await
    }

    /// Waits for the end of the goal, and returns its result as a value. A goal does not end because its robot cannot be reached: set a limit with
    /// [`tokio::time::timeout`] if you do not want to wait for it. A result of more than 48 kB is received from the program that has carried
    /// out the goal, which has to run until then.
    ///
    /// # Errors
    /// [`Error::Goal`] if the goal was not reached, or its result is lost, [`Error::Payload`] if the result does not fit `T`, and
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, nothing is lost: the next call returns the result.
    pub async fn result<T: DeserializeOwned>(&self) -> Result<T, Error> {
        Ok(self.end().await?.value()?)
    }

    /// Does the same as [`result`](Self::result), and returns the payload of the result.
    ///
    /// # Errors
    /// Returns the same errors.
    ///
    /// # Cancel safety
    /// If the future is dropped, nothing is lost.
    pub async fn end(&self) -> Result<Payload, Error> {
        let mut changes = self.changes();
        let has_ended = || lock(&self.followed.run).has_ended();
        while !has_ended() {
            // The goal may have ended meanwhile: then no change follows, either.
            if changes.next().await.is_none() && !has_ended() {
                return Err(Error::Closed);
            }
        }
        let state = lock(&self.followed.run).state().clone();
        match (state.phase, &state.transfer) {
            (Phase::Done, Some(large)) => {
                let followed = &self.followed;
                let goal = (&followed.target, &*followed.action, &*followed.id);
                followed.pulled.pull(&followed.robot, goal, large).await
            }
            (Phase::Done, None) => Ok(state
                .result()
                .unwrap_or_else(|| Payload::new("null", Encoding::JSON))),
            (phase, _) => Err(Error::Goal {
                phase,
                reason: state.reason,
            }),
        }
    }

    /// Does the same as [`end`](Self::end), and waits at most for `timeout`.
    ///
    /// # Errors
    /// [`Error::TimedOut`] if the goal has not ended in time: the error states its phase, and for how long it has been in it, or how much of
    /// the result has arrived. The other errors are those of [`result`](Self::result).
    ///
    /// # Cancel safety
    /// If the future is dropped, nothing is lost.
    pub async fn end_within(&self, timeout: Duration) -> Result<Payload, Error> {
        let ended = tokio::time::timeout(timeout, self.end()).await;
        ended.unwrap_or_else(|_| {
            if let Some(expected) = self.followed.pulled.expected() {
                return Err(Error::TimedOut { expected, timeout });
            }
            let (phase, time) = (self.phase(), humanize::duration(self.phase_for()));
            let unreachable = self.unreachable_for().map_or_else(String::new, |time| {
                let time = humanize::duration(time);
                format!(", and {} has not been reachable for {time}", self.robot())
            });
            Err(Error::TimedOut {
                expected: format!(
                    "end of the goal, which has been {phase} for {time}{unreachable},"
                ),
                timeout,
            })
        })
    }
}

impl ActionChanges {
    /// Waits until something has changed since the last call. Several changes are one. Returns `None` once the goal has ended and the
    /// program knows that, or the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, no change is lost.
    pub async fn next(&mut self) -> Option<()> {
        let Self(changes, followed) = self;
        if changes.has_changed().unwrap_or(false) {
            changes.mark_unchanged();
            return Some(());
        }
        let has_ended = || lock(&followed.run).has_ended() || followed.robot.is_closed();
        if has_ended() {
            return None;
        }
        changes.changed().await.ok()
    }
}

impl Drop for ActionRun {
    fn drop(&mut self) {
        if let Some(task) = &self.task {
            task.abort();
        }
    }
}

impl fmt::Debug for ActionChanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ActionChanges").finish_non_exhaustive()
    }
}

impl fmt::Debug for ActionRun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ActionRun")
            .field("robot", self.robot())
            .field("action", &self.action())
            .field("id", &self.id())
            .field("phase", &self.phase())
            .finish_non_exhaustive()
    }
}

//! Decides for a program that carries out the goals of one action. Its executor performs [`Work`], and [`Publication`] beside it.
use std::{
    collections::{BTreeMap, VecDeque},
    time::{Duration, Instant},
};

use bytes::Bytes;
use ciborium::Value;

use super::{
    order::{Cancel, Order, Start},
    result::{GoalResult, LargeResult},
    short,
    state::{Feedback, GoalState, Phase, PROGRAM_ENDED},
    FEEDBACK_PER_S, KEPT_FOR, LOST_AFTER, MAX_KEPT, URGENT_END,
};
use crate::{
    message::payload::Payload,
    name::{parameter::is_name, Name},
    registry::connection::Event,
    state::retain::NO_KEEPER,
    stop::AGAIN_AFTER,
    text::humanize,
};

/// The limits of the rate of feedback, per second.
const FEEDBACK_RATES: (f64, f64) = (0.1, 50.0);
/// The maximum number of goals that have not ended. A flood of them is refused.
const MAX_OPEN: usize = 8;

/// The rules of an action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rules {
    /// Whether a new goal is refused while another one runs. Otherwise it preempts the other one.
    pub refuses: bool,
    /// How long the client of a goal has to be away until the goal is cancelled; `None`: it is carried out without its client, too.
    pub lost_after: Option<Duration>,
}

/// The goals of one action of a program: at most one is carried out at a time.
#[derive(Debug)]
pub struct ActionServer {
    /// The name of the program; empty if it has none.
    program: String,
    rules: Rules,
    goals: BTreeMap<String, Goal>,
    /// The ids of the goals that have not begun, in the order in which they arrived.
    waiting: VecDeque<String>,
    /// The goal whose handler runs.
    running: Option<String>,
    /// Why the fleet is stopped.
    stopped: Option<String>,
    work: VecDeque<Work>,
    /// The goals that are to be published, in order.
    unpublished: VecDeque<String>,
    publish_after: Option<Instant>,
    /// The goals that are to be forgotten.
    forgotten: VecDeque<String>,
}

/// A goal.
#[derive(Debug)]
struct Goal {
    state: GoalState,
    /// The robot of the client, and the name of its program, if it has one.
    client: Option<(Name, String)>,
    /// The orders that are answered as soon as the router has the state.
    orders: Vec<u64>,
    /// Whether the router has the goal, so that nobody else begins it.
    is_kept: bool,
    /// The bytes of a large result that nobody has yet.
    unserved: Option<Bytes>,
    /// How it ends if its handler notices.
    cancelled: Option<(Phase, String)>,
    /// When it is cancelled, because its client is away.
    lost_at: Option<Instant>,
    feedback: Option<Feedback>,
    feedback_at: Option<Instant>,
    feedback_pause: Duration,
    forget_at: Option<Instant>,
}

/// Something that an executor does at once.
#[derive(Clone, Debug, PartialEq)]
pub enum Work {
    /// Answer an order.
    Reply {
        /// The number of the order, which the executor has chosen.
        order: u64,
        /// The reason why it is refused, if it is.
        refused: Option<String>,
    },
    /// Call the handler. Report its end with [`ActionServer::on_end`].
    Run {
        /// The goal.
        id: String,
        /// Its value.
        goal: Value,
        /// The client: `<robot>/<program>`.
        by: String,
    },
    /// Ask the handler of a goal to end.
    Cancel {
        /// The goal.
        id: String,
        /// Why.
        reason: String,
    },
    /// Wait until this time, or until something happens.
    Wait(Option<Instant>),
}

/// A message that an executor publishes.
#[derive(Clone, Debug, PartialEq)]
pub enum Publication {
    /// Serve the bytes of a large result ([`Results::keep`](super::results::Results::keep)).
    Serve {
        /// Its description.
        result: LargeResult,
        /// The bytes.
        bytes: Bytes,
    },
    /// The state of a goal, which is retained. Report with [`ActionServer::on_published`] whether it is.
    State {
        /// The goal.
        id: String,
        /// The state.
        payload: Payload,
        /// Whether it is urgent.
        is_urgent: bool,
    },
    /// The feedback of a goal, with the least urgency.
    Feedback {
        /// The goal.
        id: String,
        /// The feedback.
        payload: Payload,
    },
    /// The state of a goal is forgotten.
    Forget {
        /// The goal.
        id: String,
    },
    /// Wait until this time, or until something happens.
    Wait(Option<Instant>),
}

/// How a handler has ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// It has returned a result. `noticed`: it knew that it was asked to end.
    Done {
        /// The result.
        result: GoalResult,
        /// Whether it knew that it was asked to end.
        noticed: bool,
    },
    /// It has failed.
    Failed(String),
    /// It has ended because it was asked to.
    Cancelled,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            refuses: false,
            lost_after: Some(LOST_AFTER),
        }
    }
}

impl ActionServer {
    /// Creates an action of a program, without goals.
    pub fn new(program: Option<&Name>, rules: Rules) -> Self {
        Self {
            program: program.map(Name::to_string).unwrap_or_default(),
            rules,
            goals: BTreeMap::new(),
            waiting: VecDeque::new(),
            running: None,
            stopped: None,
            work: VecDeque::new(),
            unpublished: VecDeque::new(),
            publish_after: None,
            forgotten: VecDeque::new(),
        }
    }

    /// Handles a goal that the robot's router has kept of an earlier run of the program. One that has not ended is lost, and never carried
    /// out again.
    pub fn on_earlier(&mut self, id: &str, payload: &Payload, now: Instant, now_ms: u64) {
        let Ok(mut state) = GoalState::read(payload) else {
            return;
        };
        if !is_name(id) || self.goals.contains_key(id) {
            return;
        }
        let is_lost = !state.phase.is_end();
        if is_lost {
            state.phase = Phase::Lost;
            state.reason = PROGRAM_ENDED.to_owned();
            state.ended_ms = Some(now_ms);
        }
        let goal = Goal {
            is_kept: true,
            forget_at: Some(now + KEPT_FOR),
            ..Goal::new(state, None, None)
        };
        self.goals.insert(id.to_owned(), goal);
        if is_lost {
            self.unpublished.push_back(id.to_owned());
        }
        self.limit();
    }

    /// Handles an order of a program of the robot `from`; `None` if the sender is not known. `number`: chosen by the executor.
    pub fn on_order(&mut self, number: u64, from: Option<&Name>, payload: &Payload, now_ms: u64) {
        let refused = match Order::read(payload) {
            Ok(Order::Start(start)) => match self.on_start(number, from, start, now_ms) {
                // The reply follows when the router has the goal.
                Ok(()) => return,
                Err(reason) => Some(reason),
            },
            Ok(Order::Cancel(cancel)) => self.on_cancel(from, &cancel, now_ms).err(),
            Err(reason) => Some(reason),
        };
        self.reply(number, refused);
    }

    fn on_start(
        &mut self,
        number: u64,
        from: Option<&Name>,
        start: Start,
        now_ms: u64,
    ) -> Result<(), String> {
        if let Some(known) = self.goals.get_mut(&start.id) {
            if known.is_kept {
                self.reply(number, None);
            } else {
                known.orders.push(number);
            }
            return Ok(());
        }
        if let Some(reason) = &self.stopped {
            return Err(reason.clone());
        }
        let open = self.goals.values().filter(|goal| !goal.has_ended());
        let open: Vec<&str> = open.map(|goal| goal.state.by.as_str()).collect();
        match open.first() {
            Some(by) if self.rules.refuses => {
                return Err(format!(
                    "busy with a goal of {by}: cancel it, or wait for its end"
                ));
            }
            _ if open.len() >= MAX_OPEN => return Err(format!("busy with {MAX_OPEN} goals")),
            _ => {}
        }
        let client = from.map(|robot| (robot.clone(), start.by.clone()));
        let phase = match open.is_empty() {
            true => Phase::Running,
            false => Phase::Waiting,
        };
        let state = GoalState {
            goal: Some(start.goal).filter(|goal| !goal.is_null()),
            by: client_name(from, &start.by),
            program: self.program.clone(),
            began_ms: now_ms,
            ..GoalState::new(phase)
        };
        let goal = Goal {
            orders: vec![number],
            ..Goal::new(state, client, start.feedback_per_s)
        };
        self.goals.insert(start.id.clone(), goal);
        self.unpublished.push_back(start.id);
        Ok(())
    }

    fn on_cancel(
        &mut self,
        from: Option<&Name>,
        cancel: &Cancel,
        now_ms: u64,
    ) -> Result<(), String> {
        if !self.goals.contains_key(&cancel.id) {
            return Err(format!(
                "no goal {}: it never began, or ended long ago",
                cancel.id
            ));
        }
        let reason = format!("by {}", client_name(from, &cancel.by));
        self.cancel(&cancel.id, Phase::Cancelled, &reason, now_ms);
        Ok(())
    }

    /// Handles whether the router keeps the state that was published.
    pub fn on_published(
        &mut self,
        id: &str,
        result: Result<(), String>,
        now: Instant,
        now_ms: u64,
    ) {
        let Some(goal) = self.goals.get_mut(id) else {
            return;
        };
        match result {
            Ok(()) if goal.is_kept => {}
            Ok(()) => {
                goal.is_kept = true;
                let (by, orders) = (goal.state.by.clone(), std::mem::take(&mut goal.orders));
                if !goal.has_ended() {
                    self.waiting.push_back(id.to_owned());
                    self.preempt_others(id, &by, now_ms);
                }
                for order in orders {
                    self.reply(order, None);
                }
                self.begin_next();
            }
            // It never began.
            Err(reason) if !goal.is_kept => {
                for order in std::mem::take(&mut goal.orders) {
                    self.reply(
                        order,
                        Some(format!("the robot cannot keep the goal: {reason}")),
                    );
                }
                self.goals.remove(id);
            }
            Err(reason) if goal.state.result.is_some() && !reason.contains(NO_KEEPER) => {
                // A result for which there is no room must not keep others from learning of the end. A router that is being restarted
                // gets it later.
                goal.state.result = None;
                goal.state.reason = short(&format!("the robot cannot keep the result: {reason}"));
                self.publish_again(id, now);
            }
            Err(_) => self.publish_again(id, now),
        }
    }

    /// Handles feedback of a handler, of which the newest counts.
    pub fn on_feedback(&mut self, id: &str, feedback: Feedback) {
        if let Some(goal) = self.goals.get_mut(id).filter(|goal| !goal.has_ended()) {
            goal.feedback = Some(feedback);
        }
    }

    /// Handles the end of the handler of a goal.
    pub fn on_end(&mut self, id: &str, outcome: Outcome, now_ms: u64) {
        if self.running.as_deref() != Some(id) {
            return;
        }
        self.running = None;
        if let Some(goal) = self.goals.get_mut(id) {
            let asked = goal.cancelled.take();
            let (phase, reason, result) = match (outcome, asked) {
                (Outcome::Failed(reason), _) => (Phase::Failed, reason, None),
                (
                    Outcome::Done {
                        result,
                        noticed: true,
                    },
                    Some((phase, reason)),
                ) => (phase, reason, Some(result)),
                (Outcome::Done { result, .. }, _) => (Phase::Done, String::new(), Some(result)),
                (Outcome::Cancelled, Some((phase, reason))) => (phase, reason, None),
                (Outcome::Cancelled, None) => {
                    (Phase::Cancelled, "by the program itself".to_owned(), None)
                }
            };
            match result {
                Some(GoalResult::Value(value)) if !value.is_null() => {
                    goal.state.result = Some(value);
                }
                // Nobody asks for that of a goal that is not done.
                Some(GoalResult::Large(described, bytes)) if phase == Phase::Done => {
                    (goal.state.transfer, goal.unserved) = (Some(described), Some(bytes));
                }
                _ => {}
            }
            self.end(id, phase, &reason, now_ms);
        }
        self.begin_next();
    }

    /// Handles that robots and programs come and go: clients are among them.
    pub fn on_event(&mut self, event: &Event, now: Instant) {
        let Some(lost_after) = self.rules.lost_after else {
            return;
        };
        for goal in self.goals.values_mut().filter(|goal| !goal.has_ended()) {
            let Some((client, program)) = &goal.client else {
                continue;
            };
            match event {
                Event::PeerDown { robot } if robot == client => {
                    goal.lost_at.get_or_insert(now + lost_after);
                }
                Event::ProgramDown {
                    robot,
                    program: name,
                } if robot == client && name.as_str() == program => {
                    goal.lost_at.get_or_insert(now + lost_after);
                }
                Event::PeerUp { robot } if robot == client && program.is_empty() => {
                    goal.lost_at = None;
                }
                Event::ProgramUp {
                    robot,
                    program: name,
                } if robot == client && name.as_str() == program => {
                    goal.lost_at = None;
                }
                _ => {}
            }
        }
    }

    /// Handles that the fleet was stopped, for this reason, or released (`None`). A stop cancels all goals.
    pub fn on_stop(&mut self, stopped: Option<String>, now_ms: u64) {
        self.stopped = stopped;
        if let Some(reason) = self.stopped.clone() {
            for id in self.open() {
                self.cancel(&id, Phase::Cancelled, &reason, now_ms);
            }
        }
    }

    /// Cancels all goals, because the action ends.
    pub fn close(&mut self, now_ms: u64) {
        for id in self.open() {
            self.cancel(&id, Phase::Cancelled, "the action has ended", now_ms);
        }
    }

    /// Returns what to do next. Call it again after everything that has happened.
    pub fn work(&mut self, now: Instant, now_ms: u64) -> Work {
        let goals = self.goals.iter();
        let lost = goals.filter(|(_, goal)| goal.lost_at.is_some_and(|at| at <= now));
        let lost = lost.map(|(id, goal)| (id.clone(), goal.state.by.clone()));
        let lost: Vec<_> = lost.collect();
        let after = humanize::duration(self.rules.lost_after.unwrap_or_default());
        for (id, by) in lost {
            let reason = format!("{by} has been away for {after}");
            self.cancel(&id, Phase::Cancelled, &reason, now_ms);
        }
        self.work.pop_front().unwrap_or_else(|| {
            let times = self.goals.values().filter_map(|goal| goal.lost_at);
            Work::Wait(times.min())
        })
    }

    /// Returns what to publish next. The executor publishes one after the other, beside its other work.
    pub fn publication(&mut self, now: Instant) -> Publication {
        let goals = self.goals.iter();
        let old = goals.filter(|(_, goal)| goal.forget_at.is_some_and(|at| at <= now));
        let old: Vec<_> = old.map(|(id, _)| id.clone()).collect();
        for id in old {
            self.forget(&id);
        }
        if self.publish_after.is_none_or(|at| at <= now) {
            self.publish_after = None;
            while let Some(id) = self.unpublished.pop_front() {
                if let Some(goal) = self.goals.get_mut(&id) {
                    if let (Some(result), Some(bytes)) =
                        (&goal.state.transfer, goal.unserved.take())
                    {
                        let result = result.clone();
                        self.unpublished.push_front(id);
                        return Publication::Serve { result, bytes };
                    }
                    if goal.has_ended() {
                        goal.forget_at = Some(now + KEPT_FOR);
                    }
                    let payload = goal.state.write();
                    let is_urgent = goal.has_ended() && payload.bytes.len() <= URGENT_END;
                    return Publication::State {
                        id,
                        payload,
                        is_urgent,
                    };
                }
            }
            while let Some(id) = self.forgotten.pop_front() {
                // Somebody may have started it again since.
                if !self.goals.contains_key(&id) {
                    return Publication::Forget { id };
                }
            }
        }
        let is_due =
            |goal: &Goal| goal.feedback.is_some() && goal.feedback_at.is_none_or(|at| at <= now);
        let next = self.goals.iter_mut().find(|(_, goal)| is_due(goal));
        if let Some((id, goal)) = next {
            if let Some(feedback) = goal.feedback.take() {
                goal.feedback_at = Some(now + goal.feedback_pause);
                return Publication::Feedback {
                    id: id.clone(),
                    payload: feedback.write(),
                };
            }
        }
        let of_feedback = |goal: &Goal| goal.feedback.as_ref().and(goal.feedback_at);
        let times = self
            .goals
            .values()
            .flat_map(|goal| [of_feedback(goal), goal.forget_at]);
        Publication::Wait(times.flatten().chain(self.publish_after).min())
    }

    /// Returns whether all goals have ended, and all of that is published.
    pub fn is_finished(&self) -> bool {
        self.open().is_empty() && self.unpublished.is_empty()
    }

    /// Returns the goals that have not ended.
    pub fn open(&self) -> Vec<String> {
        let open = self.goals.iter().filter(|(_, goal)| !goal.has_ended());
        open.map(|(id, _)| id.clone()).collect()
    }

    #[cfg(test)]
    pub(super) fn phase(&self, id: &str) -> Option<Phase> {
        self.goals.get(id).map(|goal| goal.state.phase)
    }

    #[cfg(test)]
    pub(super) fn known(&self) -> usize {
        self.goals.len()
    }

    fn reply(&mut self, order: u64, refused: Option<String>) {
        self.work.push_back(Work::Reply { order, refused });
    }

    /// Ends all goals but a new one, as soon as their handlers allow.
    fn preempt_others(&mut self, new: &str, by: &str, now_ms: u64) {
        let reason = format!("by a newer goal of {by}");
        for id in self.open() {
            if id != new && self.goals.get(&id).is_some_and(|goal| goal.is_kept) {
                self.cancel(&id, Phase::Preempted, &reason, now_ms);
            }
        }
    }

    fn cancel(&mut self, id: &str, phase: Phase, reason: &str, now_ms: u64) {
        let Some(goal) = self.goals.get_mut(id) else {
            return;
        };
        goal.lost_at = None;
        if goal.has_ended() || goal.cancelled.is_some() {
            return;
        }
        if self.running.as_deref() != Some(id) {
            self.waiting.retain(|waiting| waiting != id);
            self.end(id, phase, reason, now_ms);
            return;
        }
        let reason = short(reason);
        goal.cancelled = Some((phase, reason.clone()));
        goal.state.phase = Phase::Cancelling;
        goal.state.reason.clone_from(&reason);
        let id = id.to_owned();
        self.unpublished.push_back(id.clone());
        // It comes before goals that have not begun.
        self.work.push_front(Work::Cancel { id, reason });
    }

    fn end(&mut self, id: &str, phase: Phase, reason: &str, now_ms: u64) {
        if let Some(goal) = self.goals.get_mut(id) {
            goal.state.phase = phase;
            goal.state.reason = short(reason);
            goal.state.ended_ms = Some(now_ms);
            goal.feedback = None;
            goal.lost_at = None;
            self.unpublished.push_back(id.to_owned());
        }
        self.limit();
    }

    fn begin_next(&mut self) {
        if self.running.is_some() {
            return;
        }
        let Some(id) = self.waiting.pop_front() else {
            return;
        };
        let Some(goal) = self.goals.get_mut(&id) else {
            return;
        };
        if goal.state.phase != Phase::Running {
            goal.state.phase = Phase::Running;
            self.unpublished.push_back(id.clone());
        }
        self.work.push_back(Work::Run {
            goal: goal.state.goal.clone().unwrap_or(Value::Null),
            by: goal.state.by.clone(),
            id: id.clone(),
        });
        self.running = Some(id);
    }

    fn publish_again(&mut self, id: &str, now: Instant) {
        self.unpublished.push_front(id.to_owned());
        self.publish_after = Some(now + AGAIN_AFTER);
    }

    fn forget(&mut self, id: &str) {
        self.goals.remove(id);
        self.forgotten.push_back(id.to_owned());
    }

    /// Forgets the goals that ended first, if there are too many.
    fn limit(&mut self) {
        let ended = self.goals.iter().filter(|(_, goal)| goal.has_ended());
        let ended = ended.map(|(id, goal)| (goal.state.ended_ms, id.clone()));
        let mut ended: Vec<_> = ended.collect();
        ended.sort();
        let surplus = ended.len().saturating_sub(MAX_KEPT);
        for (_, id) in ended.into_iter().take(surplus) {
            self.forget(&id);
        }
    }
}

impl Goal {
    fn new(state: GoalState, client: Option<(Name, String)>, feedback_per_s: Option<f64>) -> Self {
        let (least, most) = FEEDBACK_RATES;
        let asked = feedback_per_s.filter(|rate| !rate.is_nan());
        let rate = asked.unwrap_or(FEEDBACK_PER_S).clamp(least, most);
        Self {
            state,
            client,
            orders: Vec::new(),
            is_kept: false,
            unserved: None,
            cancelled: None,
            lost_at: None,
            feedback: None,
            feedback_at: None,
            feedback_pause: Duration::from_secs_f64(1.0 / rate),
            forget_at: None,
        }
    }

    fn has_ended(&self) -> bool {
        self.state.phase.is_end()
    }
}

/// Returns the name of a client: `<robot>/<program>`.
fn client_name(robot: Option<&Name>, program: &str) -> String {
    match (robot, program) {
        (None, _) => "a Zenoh program".to_owned(),
        (Some(robot), "") => robot.to_string(),
        (Some(robot), program) => short(&format!("{robot}/{program}")),
    }
}

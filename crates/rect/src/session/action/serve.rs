//! Carries out the goals of an action of this program.
use std::{
    collections::{BTreeMap, HashMap},
    fmt,
    future::Future,
    pin::Pin,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex,
    },
    time::{Duration, Instant, SystemTime},
};

use rect_core::{
    action::{
        self,
        query::{Answers, GoalsQuery},
        result::GoalResult,
        server::{ActionServer, Outcome, Publication, Work},
        state::{Feedback, KnownGoal},
        to_payload,
    },
    catalogue::ServiceEntry,
    clock::unix::ms_since_1970,
    message::{
        encoding::Encoding,
        payload::{Payload, ToPayload},
    },
};
use tokio::{
    sync::{watch, Notify},
    time::timeout_at,
};

use super::{
    goal::{Cancel, Goal},
    options::ActionOptions,
};
use crate::{
    error::Error,
    session::{
        events::Events,
        executor::Executor,
        results::KeptResults,
        robot::Robot,
        service::{Request, Requests},
        shared::{lock, sleep_until, NoItems},
        stop::{FleetStop, StopChanges},
        warnings::warn,
    },
};

/// How long the robot's router may take to answer which goals it knows.
const EARLIER_WITHIN: Duration = Duration::from_secs(2);

/// An action of this program; created by [`Robot::action`]. Dropping it ends the action: its goals are cancelled, and no further ones
/// begin.
pub struct Action(Arc<Shared>);

type Handler = dyn Fn(Goal) -> Pin<Box<dyn Future<Output = Outcome> + Send>> + Send + Sync;

struct Shared {
    robot: Robot,
    action: String,
    server: Mutex<ActionServer>,
    handler: Box<Handler>,
    /// The orders that wait for a reply.
    orders: Mutex<HashMap<u64, Request>>,
    /// The goals whose handlers run.
    running: Mutex<HashMap<String, watch::Sender<Option<String>>>>,
    /// The newest feedback that was not published yet.
    news: Mutex<BTreeMap<String, Payload>>,
    /// Wakes the task that works, the one that publishes, and its part for feedback.
    work: Notify,
    publications: Notify,
    has_news: Notify,
    is_closing: AtomicBool,
}

/// The events that an action follows.
struct Followed {
    requests: Option<Requests>,
    events: Events,
    stop: FleetStop,
    stops: StopChanges,
}

impl Robot {
    /// Declares an action: a long task, such as driving to a place, which others [start](Self::start), follow and cancel. `handler`
    /// carries out one goal at a time, and its result is the result of the goal; an error is its failure. `action` is the name of the
    /// action, or [`ActionOptions`].
    ///
    /// Each goal has one end, which its client learns also after a cut. The robot's router keeps it for 10 minutes, and at most 16 for each
    /// action. A result has at most 16 MB; this program keeps one of more than 48 kB for its clients, while it runs. A handler that is cancelled should end soon ([`Goal::is_cancelled`]): a newer goal waits for that. A goal is also
    /// cancelled when its client has been away for 5 s, and by the [stop of the fleet](Self::fleet_stop), in which this program takes part.
    ///
    /// ```no_run
    /// # use std::time::Duration;
    /// # async fn dig(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let _action = robot.action("dig", |goal| async move {
    ///     let depth: u32 = goal.payload.value().map_err(|error| error.to_string())?;
    ///     for done in 0..depth {
    ///         goal.feedback("", Some(f64::from(done) / f64::from(depth))).map_err(|error| error.to_string())?;
    ///         goal.sleep(Duration::from_secs(1)).await.map_err(|cancelled| cancelled.to_string())?;
    ///     }
    ///     Ok::<_, String>("dug")
    /// }).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Action`] if the name is invalid, [`Error::ServiceRefused`] if a program of this robot has the action already, and
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no action.
    pub async fn action<F, A, V, E>(
        &self,
        action: impl Into<ActionOptions>,
        handler: F,
    ) -> Result<Action, Error>
    where
        F: Fn(Goal) -> A + Send + Sync + 'static,
        A: Future<Output = Result<V, E>> + Send + 'static,
        V: ToPayload + Send,
        E: ToPayload + Send,
    {
        let options = action.into();
        let entry = ServiceEntry::of_action(&options.action, &options.about);
        let entry = entry.ok_or_else(|| Error::Action {
            reason: action::wrong_action(&options.action),
        })?;
        let program = self.inner.program.driver().program().name.clone();
        let mut server = ActionServer::new(program.as_ref(), options.rules);
        let stop = self.fleet_stop().await?;
        server.on_stop(stop.reason(), now_ms());
        let (stops, events) = (stop.changes(), self.events().await?);
        let own = self.name().as_str();
        let earlier = self.ask_for_goals(own, &options.action, "*", EARLIER_WITHIN);
        for earlier in earlier.await?.goals {
            if let Some(KnownGoal { id, .. }) = KnownGoal::of(&earlier) {
                server.on_earlier(&id, &earlier.payload, Instant::now(), now_ms());
            }
        }
        let handler = move |goal: Goal| -> Pin<Box<dyn Future<Output = Outcome> + Send>> {
            let (id, cancel) = (goal.id.clone(), goal.cancel.clone());
            let running = handler(goal);
            Box::pin(async move { outcome(&id, running.await, cancel.is_noticed()) })
        };
        let requests = Some(self.requests_of(entry).await?);
        let shared = Arc::new(Shared {
            robot: self.clone(),
            action: options.action,
            server: Mutex::new(server),
            handler: Box::new(handler),
            orders: Mutex::default(),
            running: Mutex::default(),
            news: Mutex::default(),
            has_news: Notify::new(),
            work: Notify::new(),
            publications: Notify::new(),
            is_closing: AtomicBool::new(false),
        });
        let followed = Followed {
            requests,
            events,
            stop,
            stops,
        };
        let runtime = &self.inner.runtime;
        runtime.spawn(shared.clone().serve(followed));
        runtime.spawn(shared.clone().publish());
        Ok(Action(shared))
    }

    /// Asks robots for goals; `*` stands for all robots, actions and goals.
    pub(super) async fn ask_for_goals(
        &self,
        robot: &str,
        action: &str,
        goal: &str,
        timeout: Duration,
    ) -> Result<Answers, Error> {
        let inner = &self.inner;
        let query = GoalsQuery::new(inner.place.clone(), robot, action, goal, timeout)?;
        Executor::new(&inner.session, query, NoItems).run().await
    }
}

fn now_ms() -> u64 {
    ms_since_1970(SystemTime::now())
}

/// Returns the outcome of the handler of the goal `id`. `noticed`: it knew that it should end.
fn outcome<V: ToPayload, E: ToPayload>(id: &str, result: Result<V, E>, noticed: bool) -> Outcome {
    let result = match result {
        Ok(result) => result.into_payload().map_err(|error| error.to_string()),
        Err(_) if noticed => return Outcome::Cancelled,
        Err(error) => {
            let text = error.into_payload();
            let text = text.map(|text| text.text().unwrap_or("the handler failed").to_owned());
            return Outcome::Failed(text.unwrap_or_else(|error| error.to_string()));
        }
    };
    match result.and_then(|payload| GoalResult::new(id, payload)) {
        Ok(result) => Outcome::Done { result, noticed },
        Err(reason) => Outcome::Failed(format!("the result cannot be sent: {reason}")),
    }
}

impl Shared {
    /// Returns the large results of the program, which begin to be kept with the first one.
    fn results(&self) -> Result<&KeptResults, Error> {
        let inner = &self.robot.inner;
        if let Some(kept) = inner.results.get() {
            return Ok(kept);
        }
        let started = KeptResults::start(&inner.session, inner.place.clone())?;
        Ok(inner.results.get_or_init(|| started))
    }

    fn on_feedback(&self, id: &str, feedback: Feedback) {
        lock(&self.server).on_feedback(id, feedback);
        self.publications.notify_one();
    }

    /// Does the work of the server until the action has ended and its last handler, too.
    async fn serve(self: Arc<Self>, followed: Followed) {
        self.serve_to_end(followed).await;
        // After the end of the session, nobody else tells them.
        for cancel in lock(&self.running).values() {
            cancel.send_replace(Some("the session is closed".to_owned()));
        }
    }

    async fn serve_to_end(self: &Arc<Self>, mut followed: Followed) {
        let mut number = 0;
        loop {
            if self.is_closing.load(Ordering::Relaxed) && followed.requests.take().is_some() {
                lock(&self.server).close(now_ms());
            }
            let until = self.work();
            self.publications.notify_one();
            if followed.requests.is_none() && self.has_ended() {
                return;
            }
            let Followed {
                requests,
                events,
                stop,
                stops,
            } = &mut followed;
            let next = async {
                match requests {
                    Some(requests) => requests.next().await,
                    None => std::future::pending().await,
                }
            };
            let due = sleep_until(until);
            tokio::select! {
                biased;
                changed = stops.next() => {
                    if changed.is_none() { return }
                    lock(&self.server).on_stop(stop.reason(), now_ms());
                }
                request = next => {
                    let Some(request) = request else { return };
                    number += 1;
                    let (sender, payload) = (request.sender.clone(), request.payload.clone());
                    lock(&self.orders).insert(number, request);
                    lock(&self.server).on_order(number, sender.as_ref(), &payload, now_ms());
                }
                event = events.next() => {
                    let Some(event) = event else { return };
                    lock(&self.server).on_event(&event, Instant::now());
                }
                () = self.work.notified() => {}
                () = due => {}
            }
        }
    }

    /// Does what is to do now, and returns until when there is nothing else.
    fn work(self: &Arc<Self>) -> Option<Instant> {
        loop {
            let work = lock(&self.server).work(Instant::now(), now_ms());
            match work {
                Work::Wait(until) => return until,
                Work::Reply { order, refused } => {
                    let Some(request) = lock(&self.orders).remove(&order) else {
                        continue;
                    };
                    // An error means that the session is closed.
                    let _ = match refused {
                        None => request.reply(""),
                        Some(reason) => request.refuse(reason),
                    };
                    let _ = request.finish();
                }
                Work::Run { id, goal, by } => {
                    let (sender, cancel) = Cancel::new();
                    lock(&self.running).insert(id.clone(), sender);
                    let (shared, of) = (self.clone(), id.clone());
                    let goal = Goal {
                        on_feedback: Arc::new(move |feedback| shared.on_feedback(&of, feedback)),
                        id: id.clone(),
                        by,
                        payload: match goal.is_null() {
                            true => Payload::new("", Encoding::TEXT),
                            false => to_payload(&goal),
                        },
                        cancel,
                    };
                    let handled = self.robot.inner.runtime.spawn((self.handler)(goal));
                    let shared = self.clone();
                    self.robot.inner.runtime.spawn(async move {
                        let panicked = |_| Outcome::Failed("the handler panicked".to_owned());
                        shared.on_end(&id, handled.await.unwrap_or_else(panicked));
                    });
                }
                Work::Cancel { id, reason } => {
                    if let Some(cancel) = lock(&self.running).get(&id) {
                        cancel.send_replace(Some(reason));
                    }
                }
            }
        }
    }

    fn on_end(&self, id: &str, outcome: Outcome) {
        lock(&self.running).remove(id);
        lock(&self.server).on_end(id, outcome, now_ms());
        self.work.notify_one();
        self.publications.notify_one();
    }

    fn has_ended(&self) -> bool {
        lock(&self.server).open().is_empty()
    }

    /// Publishes states, and feedback beside them: a link that is busy with feedback does not delay an end.
    async fn publish(self: Arc<Self>) {
        tokio::select! {
            () = self.publish_states() => {}
            () = self.publish_feedback() => {}
        }
    }

    async fn publish_feedback(&self) {
        loop {
            let newest = lock(&self.news).pop_first();
            let Some((id, payload)) = newest else {
                self.has_news.notified().await;
                continue;
            };
            let topic = action::feedback_topic(&self.action, &id);
            // An error means that the session is closed, or that nobody gets the feedback.
            let _ = self.robot.bulk().publish(topic.as_str(), payload).await;
        }
    }

    async fn publish_states(&self) {
        loop {
            let publication = lock(&self.server).publication(Instant::now());
            match publication {
                Publication::State {
                    id,
                    payload,
                    is_urgent,
                } => {
                    let robot = match is_urgent {
                        true => self.robot.urgent().retained(),
                        false => self.robot.retained(),
                    };
                    let topic = action::topic(&self.action, &id);
                    let published = robot.publish(topic.as_str(), payload).await;
                    let published = match published {
                        Err(Error::Closed) => return,
                        other => other.map_err(|error| error.to_string()),
                    };
                    let mut server = lock(&self.server);
                    server.on_published(&id, published, Instant::now(), now_ms());
                    drop(server);
                    self.work.notify_one();
                }
                Publication::Serve { result, bytes } => match self.results() {
                    Ok(results) => results.keep(&result, bytes),
                    Err(error) => warn(&format!("a result cannot be kept: {error}")),
                },
                Publication::Feedback { id, payload } => {
                    lock(&self.news).insert(id, payload);
                    self.has_news.notify_one();
                }
                Publication::Forget { id } => {
                    let topic = action::topic(&self.action, &id);
                    match self.robot.forget(topic.as_str()).await {
                        Ok(()) => {}
                        Err(Error::Closed) => return,
                        Err(error) => warn(&error.to_string()),
                    }
                }
                Publication::Wait(until) => {
                    if self.is_closing.load(Ordering::Relaxed) && lock(&self.server).is_finished() {
                        return;
                    }
                    let woken = self.publications.notified();
                    match until {
                        None => woken.await,
                        // The end of the time is a reason to look again, too.
                        Some(until) => drop(timeout_at(until.into(), woken).await),
                    }
                }
            }
        }
    }
}

impl Drop for Action {
    fn drop(&mut self) {
        self.0.is_closing.store(true, Ordering::Relaxed);
        self.0.work.notify_one();
        self.0.publications.notify_one();
    }
}

impl fmt::Debug for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Action({})", self.0.action)
    }
}

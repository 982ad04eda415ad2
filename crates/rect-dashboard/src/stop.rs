//! Implements the Stop button: asks all robots to stop, and shows all browsers what each of them has answered, until somebody
//! clears it.
mod answers;

use std::{
    collections::BTreeMap,
    pin::pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use rect::{Error, Event, Name, Payload, Robot, Topic};
use tokio::{task::JoinSet, time::sleep};

use self::answers::{Answer, Answers};
use crate::{
    browsers::Browsers,
    protocol::{now_ms, State, StopState, StoppedRobot},
};

/// How long robots may take to answer. Robots that become reachable within this time are asked, too.
const WITHIN: Duration = Duration::from_secs(60);
/// When robots that have not answered the request to all are asked by their names. Only the answer to such a request shows that a robot
/// does not provide the service, or why it refuses: an error does not say reliably from which robot it is.
const ASKED_BY_NAME_AFTER: Duration = Duration::from_millis(500);
/// When a robot is asked again that did not provide the service: the services of a robot become known shortly after the robot, and a
/// program may just be starting.
const ASKED_AGAIN_AFTER: Duration = Duration::from_secs(1);
/// The largest number of replies to the request to all that are read.
const MAX_REPLIES: usize = 1000;

/// The Stop button of all browsers.
pub struct Stop {
    robot: Robot,
    service: Topic,
    browsers: Arc<Browsers>,
    inner: Mutex<Inner>,
}

struct Inner {
    /// The robots of the fleet that were reachable once, and whether they are.
    robots: BTreeMap<Name, bool>,
    is_connected: bool,
    /// The number of stops so far.
    count: u64,
    /// The last stop, until it is cleared.
    run: Option<Run>,
}

/// A stop since somebody has pressed the button.
struct Run {
    /// Its number, so that answers to an older one are ignored.
    number: u64,
    pressed: Instant,
    at_ms: u64,
    answers: Answers,
    /// Whether the request was passed to the router.
    is_sent: bool,
    /// Whether a service has still to answer the request to all.
    is_open: bool,
    problem: Option<String>,
    tasks: JoinSet<()>,
}

impl Stop {
    /// Creates the button, which calls `service` of all robots.
    pub fn new(robot: Robot, service: Topic, browsers: Arc<Browsers>) -> Arc<Self> {
        let inner = Inner {
            robots: BTreeMap::from([(robot.name().clone(), true)]),
            is_connected: true,
            count: 0,
            run: None,
        };
        show(&inner, &browsers);
        Arc::new(Self {
            robot,
            service,
            browsers,
            inner: Mutex::new(inner),
        })
    }

    /// Returns the service.
    pub fn service(&self) -> &Topic {
        &self.service
    }

    /// Asks all robots to stop. `again`: only those that have not confirmed the last stop. Must be called on tokio's runtime.
    pub fn press(self: &Arc<Self>, again: bool) {
        let mut inner = self.inner();
        inner.count += 1;
        let last = inner.run.take().filter(|_| again);
        let mut run = Run {
            number: inner.count,
            pressed: Instant::now(),
            at_ms: now_ms(),
            answers: Answers::of(inner.robots.keys().cloned()),
            is_sent: false,
            is_open: false,
            problem: None,
            tasks: JoinSet::new(),
        };
        match last {
            // Robots that are not known by name answer the request to all only.
            Some(last) if last.is_sent && inner.is_connected => {
                run.answers = last.answers;
                run.answers.ask_again();
                run.is_sent = true;
                let waiting: Vec<_> = run.answers.waiting().cloned().collect();
                for robot in waiting {
                    self.ask(&mut run, robot);
                }
            }
            _ if inner.is_connected => self.ask_all(&mut run),
            _ => {
                run.problem = Some(
                    "Not sent: the router of this computer cannot be reached. If it is back within a minute, the stop is sent then"
                        .to_owned(),
                );
            }
        }
        inner.run = Some(run);
        show(&inner, &self.browsers);
    }

    /// Clears what browsers show. Requests that were sent remain so.
    pub fn clear(&self) {
        let mut inner = self.inner();
        if let Some(mut run) = inner.run.take() {
            run.tasks.detach_all();
        }
        show(&inner, &self.browsers);
    }

    /// Handles a change of the fleet.
    pub fn on_event(self: &Arc<Self>, event: &Event) {
        let mut guard = self.inner();
        let inner = &mut *guard;
        let is_recent = |run: &&mut Run| run.pressed.elapsed() < WITHIN;
        let run = inner.run.as_mut().filter(is_recent);
        match event {
            Event::PeerUp { robot } => {
                inner.robots.insert(robot.clone(), true);
                let run = run.filter(|run| run.is_sent && !run.answers.has_confirmed(robot));
                if let Some(run) = run {
                    run.answers.on_answer(robot.clone(), Answer::Waiting);
                    self.ask(run, robot.clone());
                }
            }
            Event::PeerDown { robot } => {
                inner.robots.insert(robot.clone(), false);
            }
            Event::RouterUp => {
                inner.is_connected = true;
                // It may have been lost with the router.
                if let Some(run) = run.filter(|run| !run.answers.are_confirmed()) {
                    run.problem = None;
                    self.ask_all(run);
                }
            }
            Event::RouterDown => {
                inner.is_connected = false;
                if let Some(run) = run.filter(|run| run.is_sent) {
                    run.answers.on_router_lost();
                    run.problem = Some(
                        "The router of this computer cannot be reached. Robots that have not confirmed may not have received the stop"
                            .to_owned(),
                    );
                }
            }
            _ => return,
        }
        show(inner, &self.browsers);
    }

    /// Sends the request to all robots.
    fn ask_all(self: &Arc<Self>, run: &mut Run) {
        (run.is_sent, run.is_open) = (true, true);
        let (stop, number) = (self.clone(), run.number);
        run.tasks.spawn(async move {
            if let Err(error) = stop.receive_all(number).await {
                let problem = format!("Not sent: {error}");
                stop.change(number, |run| run.problem = Some(problem));
            }
            stop.change(number, |run| run.is_open = false);
        });
    }

    async fn receive_all(self: &Arc<Self>, number: u64) -> Result<(), Error> {
        let urgent = self.robot.urgent().with_timeout(WITHIN);
        let replies = urgent
            .request_all::<Payload>(self.service.clone(), "")
            .await?;
        let mut by_name = pin!(sleep(ASKED_BY_NAME_AFTER));
        let mut is_asked_by_name = false;
        for _ in 0..MAX_REPLIES {
            tokio::select! {
                reply = replies.next() => match reply {
                    Some(Ok(reply)) => self.on_confirmed(number, reply.sender),
                    Some(Err(error)) => self.on_error(number, &error),
                    None => break,
                },
                () = by_name.as_mut(), if !is_asked_by_name => {
                    is_asked_by_name = true;
                    self.ask_by_name(number);
                }
            }
        }
        if !is_asked_by_name {
            self.ask_by_name(number);
        }
        Ok(())
    }

    /// Asks the robots by their names that can be reached and have not answered.
    fn ask_by_name(self: &Arc<Self>, number: u64) {
        let mut guard = self.inner();
        let inner = &mut *guard;
        let Some(run) = inner.run.as_mut().filter(|run| run.number == number) else {
            return;
        };
        let robots = &inner.robots;
        let waiting = run.answers.waiting();
        let reachable = waiting.filter(|robot| robots.get(*robot) == Some(&true));
        for robot in reachable.cloned().collect::<Vec<_>>() {
            self.ask(run, robot);
        }
    }

    /// Sends the request to one robot, again and again while it does not provide the service.
    fn ask(self: &Arc<Self>, run: &mut Run, robot: Name) {
        while run.tasks.try_join_next().is_some() {}
        let (stop, number) = (self.clone(), run.number);
        run.tasks.spawn(async move {
            while stop.is_asking(number, &robot) {
                let urgent = stop.robot.urgent().with_timeout(WITHIN);
                let asked = urgent.request::<Payload>(robot.clone(), stop.service.clone(), "");
                let answer = match asked.await {
                    Ok(_) => return stop.on_confirmed(number, robot),
                    Err(Error::NoService { .. }) => {
                        stop.on_answer(number, robot.clone(), Answer::NoService);
                        sleep(ASKED_AGAIN_AFTER).await;
                        continue;
                    }
                    Err(Error::TimedOut { .. }) => Answer::Silent,
                    Err(Error::Service { payload, .. }) => {
                        Answer::Failed(beginning(&payload.bytes))
                    }
                    Err(error) => Answer::Failed(error.to_string()),
                };
                return stop.on_answer(number, robot, answer);
            }
        });
    }

    /// Returns whether a robot has still to confirm that stop, which was pressed within the last minute.
    fn is_asking(&self, number: u64, robot: &Name) -> bool {
        let inner = self.inner();
        let run = inner.run.as_ref().filter(|run| run.number == number);
        run.is_some_and(|run| run.pressed.elapsed() < WITHIN && !run.answers.has_confirmed(robot))
    }

    fn on_confirmed(&self, number: u64, robot: Name) {
        self.change(number, |run| {
            let answer = Answer::Confirmed(run.pressed.elapsed());
            run.answers.on_answer(robot, answer);
        });
    }

    fn on_answer(&self, number: u64, robot: Name, answer: Answer) {
        let mut inner = self.inner();
        // Without the router, the request has reached nobody.
        let is_unknown = answer == Answer::NoService && !inner.is_connected;
        let run = inner.run.as_mut().filter(|run| run.number == number);
        if let Some(run) = run.filter(|_| !is_unknown) {
            run.answers.on_answer(robot, answer);
            show(&inner, &self.browsers);
        }
    }

    /// Handles an error in place of a reply to the request to all. A robot that is known is asked by its name for it.
    fn on_error(&self, number: u64, error: &Error) {
        let is_known = |robot: &Name| self.inner().robots.contains_key(robot);
        match error {
            Error::TimedOut { .. } => {}
            Error::Service {
                robot: Some(robot), ..
            } if is_known(robot) => {}
            error => self.change(number, |run| run.problem = Some(error.to_string())),
        }
    }

    fn change(&self, number: u64, change: impl FnOnce(&mut Run)) {
        let mut inner = self.inner();
        if let Some(run) = inner.run.as_mut().filter(|run| run.number == number) {
            change(run);
            show(&inner, &self.browsers);
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Sends the last stop to all browsers, and to those that come later.
fn show(inner: &Inner, browsers: &Browsers) {
    let run = inner.run.as_ref().map(|run| StopState {
        at_ms: run.at_ms,
        is_sent: run.is_sent,
        is_open: run.is_open,
        problem: run.problem.clone(),
        robots: run
            .answers
            .all()
            .map(|(robot, answer)| stopped(robot, answer, inner.robots.get(robot) != Some(&false)))
            .collect(),
    });
    browsers.publish("stop", &State::Stop { run });
}

fn stopped(robot: &Name, answer: &Answer, is_reachable: bool) -> StoppedRobot {
    let (outcome, ms, error) = match answer {
        Answer::Confirmed(after) => {
            let ms = (after.as_secs_f64() * 10_000.0).round() / 10.0;
            ("confirmed", Some(ms), None)
        }
        Answer::Failed(error) => ("failed", None, Some(error.clone())),
        Answer::Waiting | Answer::NoService | Answer::Silent if !is_reachable => {
            ("unreachable", None, None)
        }
        Answer::Waiting => ("waiting", None, None),
        Answer::NoService => ("no_service", None, None),
        Answer::Silent => ("silent", None, None),
    };
    StoppedRobot {
        robot: robot.to_string(),
        outcome,
        ms,
        error,
    }
}

/// Returns the first 500 characters of a service's error.
fn beginning(error: &[u8]) -> String {
    String::from_utf8_lossy(error).chars().take(500).collect()
}

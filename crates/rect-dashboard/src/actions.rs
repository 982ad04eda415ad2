//! Shows browsers the goals of the actions of all robots, while one of them shows that view: otherwise nothing is put on the air.
use std::{
    collections::BTreeMap,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
    time::{Duration, SystemTime},
};

use rect::{Error, KnownGoal, Message, Name, Pattern, Payload, QueueOptions, Robot, Subscriber};
use rect_core::{
    action::{
        self,
        state::{Feedback, GoalState},
        to_payload,
    },
    clock::unix::ms_since_1970,
    text::humanize::bytes,
};
use rect_recording::view;
use tokio::{
    sync::Notify,
    task::JoinSet,
    time::{interval, sleep, MissedTickBehavior},
};

use crate::{
    browsers::Browsers,
    protocol::{FeedbackRow, GoalRow, State},
};

/// The number of messages that wait. The goals that are kept arrive together.
const CAPACITY: usize = 4096;
/// The largest number of goals that are shown.
const MAX_GOALS: usize = 500;
/// The largest goal or result that is shown, in characters of its JSON.
const MAX_SHOWN: usize = 2000;
/// How often changes are shown at most.
const SHOWN_EVERY: Duration = Duration::from_millis(100);
/// How often the router of this computer is asked whether the programs of goals have ended. That puts nothing on the air.
const ASKED_EVERY: Duration = Duration::from_secs(5);
/// How long it may take to answer.
const TIMEOUT: Duration = Duration::from_secs(2);
/// How long to wait before this program subscribes again.
const AGAIN_AFTER: Duration = Duration::from_secs(2);

/// The goals of all robots.
pub struct Actions {
    robot: Robot,
    browsers: Arc<Browsers>,
    /// How many browsers show them.
    showing: AtomicUsize,
    changed: Notify,
}

/// Counts a browser that shows goals, until it is dropped.
pub struct ShowingActions(Arc<Actions>);

/// The robot of a goal, its action and its id.
type Key = (Name, String, String);
/// The newest feedback of the goals that have not ended.
type News = BTreeMap<Key, FeedbackRow>;
type Goals = BTreeMap<Key, GoalRow>;

/// The subscriptions while a browser shows goals.
struct Received {
    states: Subscriber<Payload>,
    feedback: Subscriber<Payload>,
}

impl Actions {
    /// Creates the goals that a program of `robot` receives. [`run`](Self::run) has to run.
    pub fn new(robot: Robot, browsers: Arc<Browsers>) -> Arc<Self> {
        Arc::new(Self {
            robot,
            browsers,
            showing: AtomicUsize::new(0),
            changed: Notify::new(),
        })
    }

    /// Counts a browser that shows goals.
    pub fn show(self: &Arc<Self>) -> ShowingActions {
        self.showing.fetch_add(1, Ordering::Relaxed);
        self.changed.notify_one();
        ShowingActions(self.clone())
    }

    /// Shows goals until the session is closed.
    pub async fn run(&self) {
        loop {
            while !self.is_shown() {
                self.changed.notified().await;
            }
            match self.subscribe().await {
                Ok(received) => {
                    if !self.follow(received).await {
                        return;
                    }
                }
                Err(Error::Closed) => return,
                Err(error) => {
                    tracing::warn!("goals of actions are not shown: {error}");
                    sleep(AGAIN_AFTER).await;
                }
            }
        }
    }

    fn is_shown(&self) -> bool {
        self.showing.load(Ordering::Relaxed) > 0
    }

    async fn subscribe(&self) -> Result<Received, Error> {
        let queue = QueueOptions {
            capacity: CAPACITY,
            ..QueueOptions::default()
        };
        let feedback = Pattern::of(None, &action::feedback_topic("*", "*"))?;
        let states = Pattern::of(None, &action::topic("*", "*"))?;
        Ok(Received {
            // First, so that none of a goal that is started from now on is missed.
            feedback: self.robot.subscribe::<Payload>(feedback).await?,
            states: self.robot.subscribe_with::<Payload>(states, queue).await?,
        })
    }

    /// Shows what arrives while a browser shows it. Returns whether the session is still open.
    async fn follow(&self, received: Received) -> bool {
        let (mut goals, mut news) = (Goals::new(), News::new());
        let mut asking = JoinSet::new();
        let (mut ask, mut show) = (interval(ASKED_EVERY), interval(SHOWN_EVERY));
        for tick in [&mut ask, &mut show] {
            tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        }
        let mut is_shown = false;
        while self.is_shown() {
            tokio::select! {
                message = received.states.next() => {
                    let Some(message) = message else { return false };
                    on_message(&mut goals, &message);
                    is_shown = false;
                }
                message = received.feedback.next() => {
                    let Some(message) = message else { return false };
                    on_feedback(&mut news, &message);
                    is_shown = false;
                }
                Some(Ok(answers)) = asking.join_next() => {
                    let answers: Vec<Message> = answers;
                    answers.iter().for_each(|message| on_message(&mut goals, message));
                    is_shown = false;
                }
                () = self.changed.notified() => {}
                _ = ask.tick() => self.ask(&goals, &mut asking),
                _ = show.tick(), if !is_shown => {
                    news.retain(|key, _| goals.get(key).is_none_or(|goal| !goal.phase.is_end()));
                    self.publish(&goals, &news);
                    is_shown = true;
                }
            }
        }
        // A browser that shows them later must not see what is old.
        self.publish(&Goals::new(), &News::new());
        true
    }

    /// Asks whether the programs of goals that have not ended have: such a state is not published again then.
    fn ask(&self, goals: &Goals, asking: &mut JoinSet<Vec<Message>>) {
        let open = goals.iter().filter(|(_, goal)| !goal.phase.is_end());
        let open: Vec<_> = open.map(|(key, _)| key.clone()).collect();
        if open.is_empty() || !asking.is_empty() {
            return;
        }
        let robot = self.robot.with_timeout(TIMEOUT);
        asking.spawn(async move {
            let mut answers = Vec::new();
            for (of, action, id) in open {
                let topic = action::topic(&action, &id);
                let answer = robot.latest::<Payload>(of, topic.as_str()).await;
                answers.extend(answer.ok().flatten());
            }
            answers
        });
    }

    fn publish(&self, goals: &Goals, news: &News) {
        let news: Vec<_> = news.values().collect();
        self.browsers
            .publish("feedback", &State::Feedback { goals: &news });
        let mut goals: Vec<_> = goals.values().collect();
        goals.sort_by_key(|goal| std::cmp::Reverse(goal.since_ms));
        self.browsers
            .publish("actions", &State::Actions { goals: &goals });
    }
}

impl Drop for ShowingActions {
    fn drop(&mut self) {
        self.0.showing.fetch_sub(1, Ordering::Relaxed);
        self.0.changed.notify_one();
    }
}

/// Takes over the feedback of a goal.
fn on_feedback(news: &mut News, message: &Message) {
    let state = message.topic.as_str().rsplit_once('/');
    let goal = state.and_then(|(state, _)| action::of_topic(state));
    let (Some((action, id)), Ok(feedback)) = (goal, Feedback::read(&message.payload)) else {
        return;
    };
    let key = (message.sender.clone(), action.to_owned(), id.to_owned());
    if message.replayed || (news.len() >= MAX_GOALS && !news.contains_key(&key)) {
        return;
    }
    let row = FeedbackRow {
        robot: key.0.to_string(),
        action: key.1.clone(),
        id: key.2.clone(),
        progress: feedback.progress,
        value: (!feedback.value.is_null()).then(|| shown(&to_payload(&feedback.value))),
    };
    news.insert(key, row);
}

/// Takes over a goal that has begun, changed, or is forgotten.
fn on_message(goals: &mut Goals, message: &Message) {
    // A goal that a recording repeats is not carried out now.
    if message.replayed {
        return;
    }
    let Some((action, id)) = action::of_topic(message.topic.as_str()) else {
        return;
    };
    let key = (message.sender.clone(), action.to_owned(), id.to_owned());
    let Some(KnownGoal { state, .. }) = KnownGoal::of(message) else {
        if message.is_forgotten() {
            goals.remove(&key);
        }
        return;
    };
    if goals.len() >= MAX_GOALS && !goals.contains_key(&key) {
        return;
    }
    let known = goals.get(&key);
    let since_ms = match known.filter(|known| known.phase == state.phase) {
        Some(known) => known.since_ms,
        // The age does not depend on the clock of the robot.
        None => SystemTime::now()
            .checked_sub(state.age)
            .map_or(state.began_ms, ms_since_1970),
    };
    let row = GoalRow {
        robot: key.0.to_string(),
        action: key.1.clone(),
        id: key.2.clone(),
        phase: state.phase,
        reason: state.reason.clone(),
        goal: state.goal.as_ref().map(|goal| shown(&to_payload(goal))),
        result: result(&state),
        by: state.by,
        program: state.program,
        since_ms,
    };
    goals.insert(key, row);
}

/// Returns the result as text. Only programs that ask for a large one receive it.
fn result(state: &GoalState) -> Option<String> {
    match &state.transfer {
        Some(large) => Some(format!("{}, not shown", bytes(large.size_bytes))),
        None => state.result().as_ref().map(shown),
    }
}

/// Returns a value as JSON, of which a long one is cut.
fn shown(payload: &Payload) -> String {
    let json = view::value(payload).to_string();
    match json.char_indices().nth(MAX_SHOWN) {
        Some((end, _)) => format!("{}…", &json[..end]),
        None => json,
    }
}

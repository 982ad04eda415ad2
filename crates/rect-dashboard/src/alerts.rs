//! Shows browsers the alerts of all robots.
use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, SystemTime},
};

use rect::{Alert, Error, Message, Name, Pattern, Payload, QueueOptions, Robot, Subscriber, Topic};
use rect_core::{alert::TOPICS, clock::unix::ms_since_1970};
use tokio::{
    sync::Notify,
    task::JoinSet,
    time::{interval, sleep, MissedTickBehavior},
};

use crate::{
    browsers::Browsers,
    protocol::{AlertState, State},
};

/// The number of messages that wait. Alerts that are retained arrive together.
const CAPACITY: usize = 1024;
/// The largest number of alerts that are shown.
const MAX_ALERTS: usize = 500;
/// How often the router of this computer is asked whether the programs of alerts have ended. That puts nothing on the air.
const ASKED_EVERY: Duration = Duration::from_secs(10);
/// How long it may take to answer.
const TIMEOUT: Duration = Duration::from_secs(2);
/// How long to wait before this program subscribes again.
const AGAIN_AFTER: Duration = Duration::from_secs(2);

/// The alerts of all robots.
pub struct Alerts {
    robot: Robot,
    browsers: Arc<Browsers>,
    program_ended: Notify,
}

/// The robot of an alert, and its topic.
type Key = (Name, Topic);

impl Alerts {
    /// Creates the alerts that a program of `robot` receives. [`run`](Self::run) has to run.
    pub fn new(robot: Robot, browsers: Arc<Browsers>) -> Arc<Self> {
        let alerts = Self {
            robot,
            browsers,
            program_ended: Notify::new(),
        };
        alerts.show(&BTreeMap::new());
        Arc::new(alerts)
    }

    /// Handles the end of a program, which may have raised an alert.
    pub fn on_program_end(&self) {
        self.program_ended.notify_one();
    }

    /// Shows alerts until the session is closed.
    pub async fn run(&self) {
        loop {
            match self.subscribe().await {
                Ok(subscriber) => return self.follow(subscriber).await,
                Err(Error::Closed) => return,
                Err(error) => {
                    tracing::warn!("alerts are not shown: {error}");
                    sleep(AGAIN_AFTER).await;
                }
            }
        }
    }

    async fn subscribe(&self) -> Result<Subscriber<Payload>, Error> {
        let queue = QueueOptions {
            capacity: CAPACITY,
            ..QueueOptions::default()
        };
        let pattern = Pattern::of(None, TOPICS)?;
        self.robot.subscribe_with::<Payload>(pattern, queue).await
    }

    async fn follow(&self, subscriber: Subscriber<Payload>) {
        let mut alerts = BTreeMap::new();
        let mut asking = JoinSet::new();
        let mut tick = interval(ASKED_EVERY);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                message = subscriber.next() => match message {
                    Some(message) => on_message(&mut alerts, message),
                    None => return,
                },
                Some(Ok(ended)) = asking.join_next() => for key in ended {
                    if let Some(alert) = alerts.get_mut(&key) {
                        alert.has_ended = true;
                    }
                },
                () = self.program_ended.notified() => self.ask(&alerts, &mut asking),
                _ = tick.tick(), if self.browsers.any() => self.ask(&alerts, &mut asking),
            }
            self.show(&alerts);
        }
    }

    /// Asks which programs that have raised alerts have ended: the alert itself is not published again then.
    fn ask(&self, alerts: &BTreeMap<Key, AlertState>, asking: &mut JoinSet<Vec<Key>>) {
        let running = alerts.iter().filter(|(_, alert)| !alert.has_ended);
        let keys: Vec<_> = running.map(|(key, _)| key.clone()).collect();
        if keys.is_empty() || !asking.is_empty() {
            return;
        }
        let robot = self.robot.with_timeout(TIMEOUT);
        asking.spawn(async move {
            let mut ended = Vec::new();
            for (name, topic) in keys {
                let latest = robot.latest::<Payload>(name.clone(), topic.clone()).await;
                let retained = latest.ok().flatten().and_then(|message| message.retained);
                if retained.is_some_and(|retained| retained.has_ended) {
                    ended.push((name, topic));
                }
            }
            ended
        });
    }

    fn show(&self, alerts: &BTreeMap<Key, AlertState>) {
        let alerts: Vec<_> = alerts.values().collect();
        self.browsers
            .publish("alerts", &State::Alerts { alerts: &alerts });
    }
}

/// Takes over an alert that was raised, changed or cleared.
fn on_message(alerts: &mut BTreeMap<Key, AlertState>, message: Message) {
    // An alert that a recording repeats does not hold now.
    if message.replayed {
        return;
    }
    let key = (message.sender, message.topic);
    let retained = message.retained;
    let is_forgotten = retained.is_some_and(|retained| retained.is_forgotten);
    let alert = match is_forgotten {
        true => None,
        false => Alert::read(&key.1, &message.payload),
    };
    let Some(alert) = alert else {
        alerts.remove(&key);
        return;
    };
    if alerts.len() >= MAX_ALERTS && !alerts.contains_key(&key) {
        return;
    }
    // The age does not depend on the clock of the robot.
    let age = retained.map(|retained| retained.age).unwrap_or_default();
    let since = SystemTime::now().checked_sub(age);
    let state = AlertState {
        robot: key.0.to_string(),
        name: key.1.as_str().to_owned(),
        text: alert.text,
        level: alert.level,
        since_ms: since.map_or(alert.at, ms_since_1970),
        program: alert.program,
        has_ended: retained.is_some_and(|retained| retained.has_ended),
    };
    alerts.insert(key, state);
}

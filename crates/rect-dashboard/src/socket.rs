//! Serves one browser over its WebSocket: executes its commands, and sends what it shows.
use std::{collections::HashMap, sync::Arc, time::Duration};

use axum::body::Bytes;
use axum::extract::ws::{close_code, CloseFrame, Message, WebSocket};
use tokio::{
    sync::{broadcast::error::RecvError, Notify, Semaphore},
    task::{AbortHandle, JoinSet},
    time::{interval, timeout, MissedTickBehavior},
};

use crate::{
    actions::ShowingActions,
    browsers::ShowingTopics,
    commands,
    feed::FeedKey,
    login::Access,
    logs::ShowingLog,
    outbox::Outbox,
    protocol::{self, Command, State, VERSION},
    App,
};

/// The largest number of topics that one browser receives.
const MAX_WATCHES: usize = 64;
/// The largest number of commands of one browser that are executed at the same time, apart from stops.
const MAX_COMMANDS: usize = 8;
/// The largest number of stops of one browser that are executed at the same time. No other command delays them.
const MAX_STOPS: usize = 2;
/// How often a browser is asked for a sign of life.
const PING_EVERY: Duration = Duration::from_secs(10);
/// How long a browser may take nothing before the connection is ended.
const STALLED_AFTER: Duration = Duration::from_secs(30);

/// A browser that shows the page.
struct Browser<'a, F> {
    app: &'a Arc<App>,
    /// Returns what the browser may do now.
    access: &'a F,
    /// The user who has logged in.
    user: Option<String>,
    outbox: Arc<Outbox>,
    watches: HashMap<u32, Watch>,
    tasks: JoinSet<()>,
    permits: Arc<Semaphore>,
    stop_permits: Arc<Semaphore>,
    showing_topics: Option<ShowingTopics>,
    showing_actions: Option<ShowingActions>,
    /// The lines that it receives, and their number.
    showing_log: Option<(u32, ShowingLog)>,
}

/// A topic that a browser receives.
struct Watch {
    task: AbortHandle,
    asks_for_key: Arc<Notify>,
}

/// Serves a browser until it leaves, or may do less than at the beginning because its login has ended. `access` returns what it
/// may do. `login`: the user who has logged in at the browser, if there is one; `None` if there are no logins.
pub async fn run<F: Fn() -> Access>(
    mut stream: WebSocket,
    app: &Arc<App>,
    login: Option<Option<String>>,
    access: &F,
) {
    let at_first = access();
    let is_logged_in = login.as_ref().map(Option::is_some);
    let Some(outbox) = app.browsers.open(is_logged_in != Some(false)) else {
        close(
            &mut stream,
            close_code::AGAIN,
            "too many browsers show the dashboard: close one",
        )
        .await;
        return;
    };
    let mut browser = Browser {
        app,
        access,
        user: login.clone().flatten(),
        outbox,
        watches: HashMap::new(),
        tasks: JoinSet::new(),
        permits: Arc::new(Semaphore::new(MAX_COMMANDS)),
        stop_permits: Arc::new(Semaphore::new(MAX_STOPS)),
        showing_topics: None,
        showing_actions: None,
        showing_log: None,
    };
    browser
        .outbox
        .put_answer(browser.hello(at_first, is_logged_in));
    let mut ping = interval(PING_EVERY);
    ping.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut answered = true;
    loop {
        let outgoing = tokio::select! {
            incoming = stream.recv() => {
                answered = true;
                match incoming {
                    Some(Ok(Message::Text(text))) => {
                        if let Err(problem) = browser.on_command(&text) {
                            close(&mut stream, close_code::POLICY, &problem).await;
                            return;
                        }
                        continue;
                    }
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => continue,
                    Some(Ok(Message::Binary(_))) => {
                        close(&mut stream, close_code::UNSUPPORTED, "commands are text").await;
                        return;
                    }
                    Some(Ok(Message::Close(_)) | Err(_)) | None => return,
                }
            }
            message = browser.outbox.next() => Message::Binary(message),
            _ = ping.tick() => {
                if access() < at_first {
                    close(&mut stream, close_code::POLICY, "the login has ended").await;
                    return;
                }
                // It has slept, or was carried out of range.
                if !std::mem::take(&mut answered) {
                    return;
                }
                Message::Ping(Bytes::new())
            }
        };
        // Commands wait meanwhile, so a browser that does not read cannot fill this program with answers.
        match timeout(STALLED_AFTER, stream.send(outgoing)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) | Err(_) => return,
        }
    }
}

async fn close(stream: &mut WebSocket, code: u16, reason: &str) {
    let reason: String = reason.chars().take(100).collect();
    let frame = CloseFrame {
        code,
        reason: reason.into(),
    };
    let closed = stream.send(Message::Close(Some(frame)));
    // It is closed either way.
    let _ = timeout(Duration::from_secs(1), closed).await;
}

impl<F: Fn() -> Access> Browser<'_, F> {
    fn hello(&self, access: Access, is_logged_in: Option<bool>) -> Bytes {
        let app = self.app;
        protocol::state(&State::Hello {
            version: VERSION,
            robot: app.robot.name().as_str(),
            fleet: app.robot.fleet().as_str(),
            read_only: access < Access::Change,
            logged_in: is_logged_in,
            record: app.recording.is_some(),
        })
    }

    /// Executes a command. The result of those that take long is sent later.
    ///
    /// # Errors
    /// Fails if the page cannot have sent it.
    fn on_command(&mut self, text: &str) -> Result<(), String> {
        let command =
            serde_json::from_str(text).map_err(|error| format!("not a command: {error}"))?;
        while self.tasks.try_join_next().is_some() {}
        match command {
            Command::Show { topics, actions } => {
                let (shown, app) = (&mut self.showing_topics, self.app);
                *shown =
                    topics.then(|| shown.take().unwrap_or_else(|| app.browsers.count_topics()));
                let shown = &mut self.showing_actions;
                *shown = actions.then(|| shown.take().unwrap_or_else(|| app.actions.show()));
            }
            Command::Watch {
                id,
                topic,
                stream,
                video,
            } => {
                let key = FeedKey {
                    topic,
                    stream,
                    video,
                };
                self.watch(id, key);
            }
            Command::Key { id } => {
                if let Some(watch) = self.watches.get(&id) {
                    watch.asks_for_key.notify_one();
                }
            }
            Command::Log { id, level } => {
                let showing = self.app.logs.show(id, level, self.outbox.clone());
                self.showing_log = Some((id, showing));
            }
            Command::Unwatch { id } => {
                self.showing_log.take_if(|(log, _)| *log == id);
                if let Some(watch) = self.watches.remove(&id) {
                    watch.task.abort();
                }
            }
            command => self.execute(command),
        }
        Ok(())
    }

    fn execute(&mut self, command: Command) {
        let id = commands::id_of(&command);
        let (app, outbox, access) = (self.app.clone(), self.outbox.clone(), (self.access)());
        let user = self.user.clone();
        let permits = match command {
            Command::Stop { .. } => &self.stop_permits,
            _ => &self.permits,
        };
        let Ok(permit) = permits.clone().try_acquire_owned() else {
            let problem = "too many commands at once: wait for the answers".to_owned();
            outbox.put_answer(answer(id, Err(problem)));
            return;
        };
        self.tasks.spawn(async move {
            let result = commands::execute(&app, command, access, user.as_deref()).await;
            outbox.put_answer(answer(id, result));
            drop(permit);
        });
    }

    fn watch(&mut self, id: u32, key: FeedKey) {
        if let Some(old) = self.watches.remove(&id) {
            old.task.abort();
        }
        if self.watches.len() >= MAX_WATCHES {
            let problem = format!("a page shows at most {MAX_WATCHES} topics");
            self.outbox.put_answer(answer(id, Err(problem)));
            return;
        }
        let (app, outbox) = (self.app.clone(), self.outbox.clone());
        let asks_for_key = Arc::new(Notify::new());
        let asked = asks_for_key.clone();
        let task = self.tasks.spawn(async move {
            let feed = match app.feeds.open(key).await {
                Ok(feed) => feed,
                Err(problem) => {
                    outbox.put_answer(answer(id, Err(problem)));
                    return;
                }
            };
            let (last, mut values) = feed.subscribe();
            if let Some(last) = last {
                outbox.put_value(last.message(id));
            }
            loop {
                let value = tokio::select! {
                    value = values.recv() => value,
                    () = asked.notified() => {
                        feed.ask_for_key();
                        continue;
                    }
                };
                match value {
                    Ok(value) => outbox.put_value(value.message(id)),
                    Err(RecvError::Lagged(count)) => outbox.count_dropped(count),
                    Err(RecvError::Closed) => return,
                }
            }
        });
        self.watches.insert(id, Watch { task, asks_for_key });
    }
}

fn answer(id: u32, result: Result<serde_json::Value, String>) -> Bytes {
    let (value, error) = match result {
        Ok(value) => (Some(value), None),
        Err(error) => (None, Some(error)),
    };
    protocol::state(&State::Answer {
        id,
        value,
        error: error.as_deref(),
    })
}

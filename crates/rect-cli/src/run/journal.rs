//! Brings the lines of a program to the router of its robot, which may not run yet.
use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, SystemTime},
};

use rect::{Level, LogLine, Name, ProgramLog, Robot};
use rect_core::{
    alert::{self, Alert},
    clock::unix::ms_since_1970,
};
use tokio::{task::JoinHandle, time::timeout};

use crate::session::JoinArguments;

/// The maximum number of lines that wait for the router.
const MAX_WAITING: usize = 1000;
/// The pause between two attempts to connect.
const AGAIN_AFTER: Duration = Duration::from_secs(2);
/// How long the end of a program waits for the router.
const CONNECT_AT_END: Duration = Duration::from_secs(2);
/// The logger of what `rect run` itself reports.
const LOGGER: &str = "rect run";

/// The log of a program. It never blocks it.
pub struct Journal {
    shared: Arc<Shared>,
    connecting: JoinHandle<()>,
}

struct Shared {
    program: Name,
    is_private: bool,
    state: Mutex<State>,
}

enum State {
    /// The router does not answer yet.
    Waiting {
        lines: VecDeque<LogLine>,
        alert: Option<Option<String>>,
    },
    Connected(Robot, Arc<ProgramLog>),
}

impl Journal {
    /// Connects to the router in the background, again and again.
    pub fn open(join: JoinArguments, program: Name, is_private: bool) -> Self {
        let shared = Arc::new(Shared {
            program,
            is_private,
            state: Mutex::new(State::Waiting {
                lines: VecDeque::new(),
                alert: None,
            }),
        });
        let connecting = tokio::spawn(connect(Arc::clone(&shared), join));
        Self { shared, connecting }
    }

    /// Keeps a line of the program's output.
    pub fn output(&self, stream: &str, level: Level, text: String) {
        self.add(LogLine {
            logger: stream.to_owned(),
            ..line(level, text)
        });
    }

    /// Keeps what has happened to the program, with the figures of its run.
    pub fn report(&self, level: Level, text: String, fields: &[(&str, serde_json::Value)]) {
        let fields = fields.iter();
        self.add(LogLine {
            logger: LOGGER.to_owned(),
            fields: fields
                .map(|(name, value)| ((*name).to_owned(), value.clone()))
                .collect(),
            ..line(level, text)
        });
    }

    fn add(&self, line: LogLine) {
        let mut state = self.shared.state();
        match &mut *state {
            State::Connected(_, log) => log.log(line, self.shared.is_private),
            State::Waiting { lines, .. } => {
                lines.push_back(line);
                if lines.len() > MAX_WAITING {
                    lines.pop_front();
                }
            }
        }
    }

    /// Raises the alert that the program has stopped, or clears it (`None`).
    pub async fn alert(&self, text: Option<String>) {
        let robot = match &mut *self.shared.state() {
            State::Waiting { alert, .. } => {
                *alert = Some(text);
                return;
            }
            State::Connected(robot, _) => robot.clone(),
        };
        give_alert(&robot, &self.shared.program, text).await;
    }

    /// Waits until the last lines were sent, and ends the session. A router that does not answer is given a moment: the program may have
    /// ended before the session began.
    pub async fn close(mut self) {
        if timeout(CONNECT_AT_END, &mut self.connecting).await.is_err() {
            self.connecting.abort();
        }
        let connected = match &*self.shared.state() {
            State::Connected(robot, log) => Some((robot.clone(), Arc::clone(log))),
            State::Waiting { .. } => None,
        };
        if let Some((robot, log)) = connected {
            log.flush().await;
            // Nothing is lost if it is closed already.
            drop(robot.close().await);
        }
    }
}

impl Shared {
    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn line(level: Level, text: String) -> LogLine {
    LogLine::new(ms_since_1970(SystemTime::now()), level, text)
}

async fn connect(shared: Arc<Shared>, join: JoinArguments) {
    let mut is_reported = false;
    loop {
        let joined = join.join().await.and_then(|robot| {
            let log = robot.log_of(&shared.program)?;
            Ok((robot, log))
        });
        let (robot, log) = match joined {
            Ok(joined) => joined,
            Err(error) => {
                if !std::mem::replace(&mut is_reported, true) {
                    rect_terminal::errln!(
                        "rect run: the output is not kept until a router answers: {error}"
                    );
                }
                tokio::time::sleep(AGAIN_AFTER).await;
                continue;
            }
        };
        let connected = State::Connected(robot.clone(), Arc::new(log));
        let (waited, log) = {
            let mut state = shared.state();
            let waited = std::mem::replace(&mut *state, connected);
            let State::Connected(_, log) = &*state else {
                return;
            };
            // Under the lock, so that no later line overtakes them.
            if let State::Waiting { lines, .. } = &waited {
                for line in lines {
                    log.log(line.clone(), shared.is_private);
                }
            }
            (waited, Arc::clone(log))
        };
        drop(log);
        if let State::Waiting {
            alert: Some(text), ..
        } = waited
        {
            give_alert(&robot, &shared.program, text).await;
        }
        return;
    }
}

/// A program without an alert is not worth a message, and a router that cannot retain one keeps the lines nevertheless.
async fn give_alert(robot: &Robot, program: &Name, text: Option<String>) {
    let name = format!("{program} stopped");
    let given = match text {
        Some(text) => {
            // As that of the program, and not of this command.
            let alert = Alert {
                text,
                level: Level::Error,
                at: ms_since_1970(SystemTime::now()),
                program: program.to_string(),
            };
            match alert::topic(&name) {
                Ok(topic) => robot.retained().publish(topic, alert.write()).await,
                Err(error) => Err(error.into()),
            }
        }
        None => robot.clear_alert(&name).await,
    };
    if let Err(error) = given {
        tracing::debug!("the alert of {program}: {error}");
    }
}

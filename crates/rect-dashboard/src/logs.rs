//! Reads the logs of all robots while a browser shows them, and keeps what this computer has seen of them in files, for robots that
//! are silent.
mod remembered;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        atomic::{AtomicU64, Ordering},
        Arc,
    },
    time::Duration,
};

use axum::body::Bytes;
use rect::{Level, LogItem, LogOptions, Name, Robot};
use rect_core::log::seen::SeenLine;
use serde::Serialize;
use tokio::{
    sync::mpsc::{unbounded_channel, UnboundedReceiver, UnboundedSender},
    time::{interval, MissedTickBehavior},
};

use self::remembered::Remembered;
use crate::{
    outbox::Outbox,
    protocol::{self, now_ms, DataHeader},
};

/// The number of earlier lines of each robot that are read. Compressed, they take some 6 kB on the air.
const LAST: usize = 200;
/// How often the files are written while lines arrive.
const SAVED_EVERY: Duration = Duration::from_secs(5);
/// The size of the remembered lines that a browser gets first, in bytes of their JSON.
const REMEMBERED_BYTES: usize = 384 << 10;
/// The name that stands for all robots.
const ALL: &str = "*";

/// The logs of all robots.
pub struct Logs {
    requests: UnboundedSender<Request>,
    next_key: AtomicU64,
}

/// Makes a browser receive lines until it is dropped.
pub struct ShowingLog {
    key: u64,
    requests: UnboundedSender<Request>,
}

enum Request {
    Show(u64, Browser),
    Hide(u64),
}

/// A browser that shows lines.
struct Browser {
    /// The number of the lines in their headers.
    id: u32,
    /// The least important level that it shows.
    level: Level,
    outbox: Arc<Outbox>,
}

/// Lines of a robot, for the page.
#[derive(Serialize)]
struct Lines<'a> {
    robot: &'a Name,
    lines: &'a [SeenLine],
    /// Whether they were logged now, rather than before.
    is_new: bool,
    /// Whether new lines before these were missed.
    missed: bool,
    /// Whether the robot's router has answered since the reading began.
    has_answered: bool,
}

impl Logs {
    /// Creates the logs that a program of `robot` reads, on a task of tokio.
    pub fn new(robot: Robot) -> Self {
        let (requests, received) = unbounded_channel();
        let worker = Worker {
            robot,
            browsers: BTreeMap::new(),
            reading: None,
            remembered: None,
            answered: BTreeSet::new(),
        };
        tokio::spawn(worker.run(received));
        Self {
            requests,
            next_key: AtomicU64::new(0),
        }
    }

    /// Sends a browser the lines of `level` and above in values with the number `id`, until the result is dropped: first the
    /// remembered ones.
    pub fn show(&self, id: u32, level: Level, outbox: Arc<Outbox>) -> ShowingLog {
        let key = self.next_key.fetch_add(1, Ordering::Relaxed);
        let browser = Browser { id, level, outbox };
        // The worker ends with the session. Then there are no lines.
        let _ = self.requests.send(Request::Show(key, browser));
        ShowingLog {
            key,
            requests: self.requests.clone(),
        }
    }
}

impl Drop for ShowingLog {
    fn drop(&mut self) {
        let _ = self.requests.send(Request::Hide(self.key));
    }
}

struct Worker {
    robot: Robot,
    browsers: BTreeMap<u64, Browser>,
    /// The reading, and its least important level.
    reading: Option<(Level, rect::Logs)>,
    /// `None` while no browser shows lines, because another program may write the files then.
    remembered: Option<Remembered>,
    /// The robots that have answered since the reading began.
    answered: BTreeSet<Name>,
}

impl Worker {
    async fn run(mut self, mut requests: UnboundedReceiver<Request>) {
        let mut save = interval(SAVED_EVERY);
        save.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                request = requests.recv() => match request {
                    Some(request) => self.on_request(request).await,
                    None => break,
                },
                item = next(self.reading.as_ref()) => match item {
                    Some(item) => self.on_item(item),
                    None => break,
                },
                _ = save.tick(), if !self.browsers.is_empty() => self.save().await,
            }
            self.adjust().await;
        }
        self.save().await;
    }

    async fn on_request(&mut self, request: Request) {
        match request {
            Request::Show(key, browser) => {
                if self.remembered.is_none() {
                    self.remembered = Some(Remembered::load(self.robot.fleet().clone()).await);
                }
                self.show_remembered(&browser);
                self.browsers.insert(key, browser);
            }
            Request::Hide(key) => {
                self.browsers.remove(&key);
            }
        }
    }

    /// Reads what the browsers show: nothing, if there is none.
    async fn adjust(&mut self) {
        let least = self.browsers.values().map(|browser| browser.level).min();
        let read = self.reading.as_ref().map(|(level, _)| *level);
        if least == read {
            return;
        }
        self.reading = None;
        self.answered.clear();
        let Some(level) = least else {
            self.save().await;
            self.remembered = None;
            return;
        };
        let options = LogOptions::new().level(level).last(LAST).follow();
        match self.robot.logs(ALL, options).await {
            Ok(logs) => self.reading = Some((level, logs)),
            Err(error) => tracing::warn!("cannot read the logs of the robots: {error}"),
        }
    }

    fn on_item(&mut self, item: LogItem) {
        let (robot, lines, is_new) = match item {
            LogItem::Lines {
                robot,
                lines,
                is_new,
            } => (robot, lines, is_new),
            LogItem::Missed(robot) => return self.show_missed(&robot),
            LogItem::Complete => return,
        };
        let seen = now_ms();
        if let Some(remembered) = &mut self.remembered {
            remembered.add(&robot, &lines, seen);
        }
        self.answered.insert(robot.clone());
        let lines = lines.into_iter().map(|kept| SeenLine { seen, kept });
        self.show(&Lines {
            robot: &robot,
            lines: &Vec::from_iter(lines),
            is_new,
            missed: false,
            has_answered: true,
        });
    }

    fn show_missed(&self, robot: &Name) {
        self.show(&Lines {
            robot,
            lines: &[],
            is_new: true,
            missed: true,
            has_answered: true,
        });
    }

    fn show(&self, lines: &Lines<'_>) {
        let value = written(lines);
        for browser in self.browsers.values() {
            browser.put(&value);
        }
    }

    /// Sends a browser what is remembered.
    fn show_remembered(&self, browser: &Browser) {
        let Some(remembered) = &self.remembered else {
            return;
        };
        for (robot, lines) in remembered.newest(browser.level, REMEMBERED_BYTES) {
            browser.put(&written(&Lines {
                robot,
                lines: &lines,
                is_new: false,
                missed: false,
                has_answered: self.answered.contains(robot),
            }));
        }
    }

    async fn save(&mut self) {
        if let Some(remembered) = self.remembered.take() {
            self.remembered = Some(remembered.save().await);
        }
    }
}

impl Browser {
    fn put(&self, value: &[u8]) {
        let header = DataHeader {
            id: self.id,
            form: "json",
            at_ms: now_ms() as f64,
            bytes: value.len(),
            ..DataHeader::default()
        };
        self.outbox.put_value(protocol::data(&header, value));
    }
}

fn written(lines: &Lines<'_>) -> Bytes {
    // These types can be written.
    serde_json::to_vec(lines).unwrap_or_default().into()
}

/// Waits for the next lines.
async fn next(reading: Option<&(Level, rect::Logs)>) -> Option<LogItem> {
    match reading {
        Some((_, logs)) => logs.next().await,
        None => std::future::pending().await,
    }
}

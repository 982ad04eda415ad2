//! The logs of robots, which viewers show in their log panels. A log is read only while a viewer shows it.
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Instant, SystemTime},
};

use foxglove::{Context, RawChannel, SinkId};
use rect::{LogItem, LogOptions, Logs as Reading, Name, Pattern, Robot};
use rect_core::{clock::unix::ms_since_1970, log::page::Kept, registry::topics::Topics};
use rect_recording::{log, view::JSON};
use tokio::task::JoinSet;

use super::{
    listener::Event,
    live::{channel, KEPT},
};

/// The number of lines that a viewer gets first.
const LAST: usize = 50;
/// The largest number of robots whose logs are offered.
const MAX_ROBOTS: usize = 256;

/// The logs of the fleet.
pub struct Logs {
    robot: Robot,
    context: Arc<Context>,
    patterns: Vec<Pattern>,
    robots: BTreeMap<Name, Offered>,
}

/// A log that viewers can select.
struct Offered {
    shown: Arc<Shown>,
    /// The task that reads it while a viewer shows it.
    reading: JoinSet<()>,
    unused_since: Option<Instant>,
}

/// The channel of a log.
struct Shown {
    channel: Arc<RawChannel>,
    /// The last lines, for a viewer that begins to show them.
    last: Mutex<VecDeque<Vec<u8>>>,
}

impl Logs {
    /// Creates the list for the robots that one of the patterns selects; without patterns, for all.
    pub fn new(robot: Robot, context: Arc<Context>, patterns: Vec<Pattern>) -> Self {
        Self {
            robot,
            context,
            patterns,
            robots: BTreeMap::new(),
        }
    }

    /// Offers the logs of the robots whose routers have answered.
    pub fn on_topics(&mut self, found: &[(String, Topics)]) {
        for robot in found.iter().filter_map(|(robot, _)| Name::new(robot).ok()) {
            let selects = |pattern: &Pattern| pattern.robot().is_none_or(|name| *name == robot);
            let is_selected = self.patterns.is_empty() || self.patterns.iter().any(selects);
            let is_new = !self.robots.contains_key(&robot) && self.robots.len() < MAX_ROBOTS;
            if !is_selected || !is_new {
                continue;
            }
            let topic = log::topic(&robot);
            if let Some(channel) = channel(&self.context, &topic, JSON, Some(log::schema())) {
                let offered = Offered {
                    shown: Arc::new(Shown {
                        channel,
                        last: Mutex::default(),
                    }),
                    reading: JoinSet::new(),
                    unused_since: None,
                };
                self.robots.insert(robot, offered);
            }
        }
    }

    /// Handles a change of what viewers show.
    pub fn on_event(&self, event: &Event) {
        let Event::Shown { channel, viewer } = *event else {
            return;
        };
        let mut all = self.robots.values().map(|offered| &offered.shown);
        if let Some(shown) = all.find(|shown| shown.channel.id() == channel) {
            shown.repeat(viewer);
        }
    }

    /// Begins to read the logs that are shown, and ends it for the others.
    ///
    /// # Errors
    /// Fails if the session is closed.
    pub async fn update(&mut self) -> Result<(), rect::Error> {
        for (name, offered) in &mut self.robots {
            if offered.shown.channel.has_sinks() {
                offered.unused_since = None;
                if offered.reading.is_empty() {
                    // The computer of a viewer may be any.
                    let options = LogOptions::new().last(LAST).follow().without_private();
                    let logs = self.robot.logs(name.as_str(), options).await?;
                    let shown = offered.shown.clone();
                    shown.last().clear();
                    offered.reading.spawn(read(logs, shown));
                }
            } else if !offered.reading.is_empty() {
                let since = *offered.unused_since.get_or_insert_with(Instant::now);
                if since.elapsed() >= KEPT {
                    offered.reading.shutdown().await;
                }
            }
        }
        Ok(())
    }
}

async fn read(logs: Reading, shown: Arc<Shown>) {
    // The lines that were logged before arrive newest first, and viewers expect the order of time.
    let mut earlier = Some(VecDeque::<Kept>::new());
    while let Some(item) = logs.next().await {
        let is_earlier = matches!(item, LogItem::Lines { is_new: false, .. });
        match (&mut earlier, item) {
            (Some(earlier), LogItem::Lines { lines, .. }) if is_earlier => {
                for kept in lines.into_iter().rev() {
                    earlier.push_front(kept);
                }
                continue;
            }
            (earlier, item) => {
                for kept in earlier.take().into_iter().flatten() {
                    shown.show(&kept);
                }
                match item {
                    LogItem::Lines { lines, .. } => {
                        for kept in &lines {
                            shown.show(kept);
                        }
                    }
                    LogItem::Missed(_) => {
                        shown.show(&log::missed(ms_since_1970(SystemTime::now())))
                    }
                    LogItem::Complete => {}
                }
            }
        }
    }
}

impl Shown {
    fn show(&self, kept: &Kept) {
        let message = log::message(kept);
        let mut last = self.last();
        self.channel.log(&message);
        last.push_back(message);
        if last.len() > LAST {
            last.pop_front();
        }
    }

    /// Shows the last lines to a viewer that has just begun to show the log.
    fn repeat(&self, viewer: SinkId) {
        for message in &*self.last() {
            self.channel.log_to_sink(message, Some(viewer));
        }
    }

    fn last(&self) -> MutexGuard<'_, VecDeque<Vec<u8>>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

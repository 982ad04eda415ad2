//! The topics that viewers can select. Those that a viewer shows are subscribed to.
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant, SystemTime},
};

use foxglove::{websocket::ConnectionGraph, ChannelBuilder, Context, RawChannel, Schema, SinkId};
use rect::{Pattern, Robot, SubscribeOptions, Subscriber};
use rect_core::{clock::unix::since_1970, message::encoding::Encoding, registry::topics::Topics};
use rect_recording::{
    entry::Entry,
    inferred::Inferred,
    picture::{self, Kind},
    schema,
    view::{View, JSON},
};
use tokio::task::JoinSet;

use super::listener::Event;

/// How long a topic is received that no viewer shows any more: a viewer that changes its layout shows it again at once.
pub(super) const KEPT: Duration = Duration::from_secs(2);
/// The shortest time between two forms of a topic, because each one is a new channel for all viewers.
const CHANGED_AT_MOST_EVERY: Duration = Duration::from_secs(5);
/// How many messages of a topic a viewer is sent a second at most: as many as a screen shows.
const SHOWN_HZ: f64 = 60.0;
/// The largest number of topics that are offered.
const MAX_TOPICS: usize = 4096;

/// The topics of the fleet.
pub struct Live {
    robot: Robot,
    context: Arc<Context>,
    patterns: Vec<Pattern>,
    topics: BTreeMap<String, Offered>,
}

/// A topic that viewers can select.
struct Offered {
    pattern: Pattern,
    shown: Arc<Mutex<Shown>>,
    /// The task that receives its messages while a viewer shows it.
    receiving: JoinSet<()>,
    unused_since: Option<Instant>,
}

impl Live {
    /// Creates the list for the topics that match one of the patterns; without patterns, for all.
    pub fn new(robot: Robot, context: Arc<Context>, patterns: Vec<Pattern>) -> Self {
        Self {
            robot,
            context,
            patterns,
            topics: BTreeMap::new(),
        }
    }

    /// Offers the topics that the routers have reported.
    pub fn on_topics(&mut self, found: &[(String, Topics)]) {
        for (robot, topics) in found {
            for report in &topics.topics {
                let topic = format!("{robot}/{}", report.topic);
                if self.topics.len() < MAX_TOPICS && !self.topics.contains_key(&topic) {
                    self.offer(topic, &report.encoding);
                }
            }
        }
    }

    fn offer(&mut self, topic: String, encoding: &str) {
        let selects = |pattern: &Pattern| pattern.matches(&topic);
        if !self.patterns.is_empty() && !self.patterns.iter().any(selects) {
            return;
        }
        // A topic of another Zenoh program may be none for RECT.
        let Ok(pattern) = Pattern::new(&topic) else {
            return;
        };
        let kind = Kind::of(&Encoding::new(encoding.to_owned()));
        let Some(shown) = Shown::new(&self.context, &topic, kind) else {
            return;
        };
        let offered = Offered {
            pattern,
            shown: Arc::new(Mutex::new(shown)),
            receiving: JoinSet::new(),
            unused_since: None,
        };
        self.topics.insert(topic, offered);
    }

    /// Handles a change of what viewers show.
    pub fn on_event(&self, event: Event) {
        let Event::Shown { channel, viewer } = event else {
            return;
        };
        let mut all = self.topics.values().map(|offered| lock(&offered.shown));
        if let Some(shown) = all.find(|shown| shown.channel.id() == channel) {
            shown.repeat(viewer);
        }
    }

    /// Begins to receive the topics that are shown, and ends it for the others.
    ///
    /// # Errors
    /// Fails if the session is closed.
    pub async fn update(&mut self) -> Result<(), rect::Error> {
        for offered in self.topics.values_mut() {
            let is_shown = lock(&offered.shown).channel.has_sinks();
            if is_shown {
                offered.unused_since = None;
                if offered.receiving.is_empty() {
                    let options = SubscribeOptions {
                        max_hz: Some(SHOWN_HZ),
                        ..SubscribeOptions::default()
                    };
                    let pattern = offered.pattern.clone();
                    let subscriber = self.robot.subscribe_with(pattern, options).await?;
                    offered
                        .receiving
                        .spawn(receive(subscriber, offered.shown.clone()));
                }
            } else if !offered.receiving.is_empty() {
                let since = *offered.unused_since.get_or_insert_with(Instant::now);
                if since.elapsed() >= KEPT {
                    offered.receiving.shutdown().await;
                }
            }
        }
        Ok(())
    }

    /// Returns which robot publishes which topic.
    pub fn graph(&self) -> ConnectionGraph {
        let mut graph = ConnectionGraph::new();
        for (topic, offered) in &self.topics {
            let publishers = offered.pattern.robot().map(ToString::to_string);
            graph.set_published_topic(format!("/{topic}"), publishers);
        }
        graph
    }
}

async fn receive(subscriber: Subscriber, shown: Arc<Mutex<Shown>>) {
    while let Some(message) = subscriber.next().await {
        // It has no value, and viewers have nothing to show for that.
        if message.is_forgotten() {
            continue;
        }
        lock(&shown).show(&Entry::of(message, since_1970(SystemTime::now())));
    }
}

fn lock(shown: &Mutex<Shown>) -> MutexGuard<'_, Shown> {
    shown.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The channel of a topic, whose form is that of its messages.
struct Shown {
    context: Arc<Context>,
    topic: String,
    channel: Arc<RawChannel>,
    /// The common shape of the objects of the topic.
    inferred: Inferred,
    /// How often the schema had changed when the channel was created.
    version: u8,
    changed: Option<Instant>,
    last: Option<View>,
}

impl Shown {
    /// Creates the channel of a topic, whose messages are not known yet.
    fn new(context: &Arc<Context>, topic: &str, kind: Option<Kind>) -> Option<Self> {
        let channel = match kind {
            Some(kind) => channel(context, topic, picture::PROTOBUF, Some(kind.schema())),
            None => channel(context, topic, JSON, None),
        };
        Some(Self {
            channel: channel?,
            context: context.clone(),
            topic: topic.to_owned(),
            inferred: Inferred::default(),
            version: 0,
            changed: None,
            last: None,
        })
    }

    /// Shows a message. Its form may require another channel, which viewers select by themselves.
    fn show(&mut self, entry: &Entry) {
        let view = View::of(entry);
        let version = match &view {
            View::Picture(..) => 0,
            View::Object(_, text) => self.inferred.add(text),
        };
        let is_encoding = self.channel.message_encoding() == view.encoding();
        if !is_encoding || self.version != version {
            let now = Instant::now();
            let is_late = |at| now.duration_since(at) >= CHANGED_AT_MOST_EVERY;
            let changes = self.changed.is_none_or(is_late);
            let schema = || match &view {
                View::Picture(kind, _) => kind.schema(),
                View::Object(..) => self.inferred.schema(&self.topic),
            };
            let (context, topic) = (&self.context, &self.topic);
            let channel = changes.then(|| channel(context, topic, view.encoding(), Some(schema())));
            match channel.flatten() {
                Some(channel) => {
                    self.channel.close();
                    (self.channel, self.version) = (channel, version);
                    self.changed = Some(now);
                }
                None if !is_encoding => return,
                // Viewers show it, but do not offer its new fields yet.
                None => {}
            }
        }
        self.channel.log(view.message());
        self.last = Some(view);
    }

    /// Shows the last message to a viewer that has just begun to show the topic.
    fn repeat(&self, viewer: SinkId) {
        if let Some(last) = &self.last {
            self.channel.log_to_sink(last.message(), Some(viewer));
        }
    }
}

/// Creates the channel of a topic. Without a schema, the form of its messages is not known yet.
pub(super) fn channel(
    context: &Arc<Context>,
    topic: &str,
    encoding: &str,
    schema: Option<schema::Schema>,
) -> Option<Arc<RawChannel>> {
    let schema = schema.map(|schema| Schema::new(schema.name, schema.encoding, schema.text));
    let channel = ChannelBuilder::new(format!("/{topic}"))
        .context(context)
        .message_encoding(encoding)
        .schema(schema)
        .build_raw();
    if let Err(error) = &channel {
        tracing::warn!("{topic} cannot be shown: {error}");
    }
    channel.ok()
}

//! Receives topics and streams, once for all browsers that show them.
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak},
    time::{Duration, SystemTime},
};

use axum::body::Bytes;
use rect::{
    EncodingKind, Frame, Message, Pattern, Payload, QueueOptions, Robot, RobotTopic,
    SubscribeOptions, Urgency, Watcher, WhenFull,
};
use rect_core::{
    clock::unix::{ms_since_1970, since_1970},
    codec::{jpeg::Jpeg, Codec},
    video::bitstream,
};
use rect_recording::{picture::Kind, view};
use tokio::{sync::broadcast, task::JoinSet};

use crate::protocol::{self, DataHeader};

/// The number of values that wait for the slowest browser's task.
const CAPACITY: usize = 64;
/// How many values of a topic a browser shows a second at most: more cannot be read, and they would take room on the air.
const SHOWN_HZ: f64 = 30.0;
/// The largest picture that is shown, in bytes.
const MAX_PICTURE: usize = 4 << 20;
/// The quality of the pictures of a video for a browser that does not decode it.
const QUALITY: u8 = 80;
/// The largest value that is shown, in bytes.
const MAX_VALUE: usize = 256 << 10;

/// A topic, or a stream.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct FeedKey {
    /// `<robot>/<topic>`.
    pub topic: String,
    /// Whether to receive it as a stream.
    pub stream: bool,
    /// Whether the page decodes its video.
    pub video: bool,
}

/// The topics that are received at the moment.
pub struct Feeds {
    robot: Robot,
    open: Mutex<HashMap<FeedKey, Weak<Feed>>>,
}

/// A topic that is received until the last user drops it.
pub struct Feed {
    values: broadcast::Sender<Arc<Value>>,
    last: Mutex<Option<Arc<Value>>>,
    stream: OnceLock<Arc<Watcher>>,
    /// The task that receives it.
    receiving: Mutex<JoinSet<()>>,
}

/// A value of a topic, in the form for the page.
pub struct Value {
    form: &'static str,
    at: Duration,
    sent_ms: Option<u64>,
    age_ms: Option<u64>,
    number: Option<u32>,
    key: bool,
    bytes: usize,
    encoding: String,
    missed: u32,
    urgent: bool,
    replayed: bool,
    ended: bool,
    method: Option<String>,
    problem: Option<String>,
    shown: Bytes,
}

impl Feeds {
    /// Creates the feeds of a robot's program.
    pub fn new(robot: Robot) -> Self {
        Self {
            robot,
            open: Mutex::default(),
        }
    }

    /// Returns a feed, which begins to receive if it does not yet.
    ///
    /// # Errors
    /// Fails if the topic is invalid or the session is closed.
    pub async fn open(&self, key: FeedKey) -> Result<Arc<Feed>, String> {
        if let Some(feed) = self.lock().get(&key).and_then(Weak::upgrade) {
            return Ok(feed);
        }
        let feed = Arc::new(Feed {
            values: broadcast::Sender::new(CAPACITY),
            last: Mutex::default(),
            stream: OnceLock::new(),
            receiving: Mutex::default(),
        });
        let topic = RobotTopic::new(&key.topic).map_err(|error| error.to_string())?;
        let started = feed.start(&self.robot, &topic, &key).await;
        started.map_err(|error| error.to_string())?;
        let mut open = self.lock();
        // Another browser may have opened it meanwhile.
        if let Some(feed) = open.get(&key).and_then(Weak::upgrade) {
            return Ok(feed);
        }
        open.retain(|_, feed| feed.strong_count() > 0);
        open.insert(key, Arc::downgrade(&feed));
        Ok(feed)
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<FeedKey, Weak<Feed>>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Feed {
    /// Returns the last value, and the ones that follow.
    pub fn subscribe(&self) -> (Option<Arc<Value>>, broadcast::Receiver<Arc<Value>>) {
        // Locked, so that no value is in both.
        let last = self.last();
        (last.clone(), self.values.subscribe())
    }

    async fn start(
        self: &Arc<Self>,
        robot: &Robot,
        topic: &RobotTopic,
        key: &FeedKey,
    ) -> Result<(), rect::Error> {
        let feed = Arc::downgrade(self);
        let mut receiving = JoinSet::new();
        let queue = QueueOptions {
            capacity: CAPACITY,
            when_full: WhenFull::DropOldest,
        };
        if key.stream {
            let watch = match key.video {
                true => robot.watch_with(topic, queue).await?.undecoded(),
                false => robot.watch(topic).await?,
            };
            let watch = Arc::new(watch);
            // Set once, here.
            let _ = self.stream.set(watch.clone());
            receiving.spawn(async move {
                while let Some(frame) = watch.next().await {
                    let Some(feed) = feed.upgrade() else { return };
                    feed.deliver(Value::of_frame(frame));
                }
            });
        } else {
            let pattern = Pattern::of(Some(topic.robot.clone()), topic.topic.as_str())?;
            let options = SubscribeOptions {
                queue,
                max_hz: Some(SHOWN_HZ),
                ..SubscribeOptions::default()
            };
            let subscriber = robot.subscribe_with::<Payload>(pattern, options).await?;
            receiving.spawn(async move {
                while let Some(message) = subscriber.next().await {
                    let Some(feed) = feed.upgrade() else { return };
                    feed.deliver(Value::of_message(message));
                }
            });
        }
        *self
            .receiving
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = receiving;
        Ok(())
    }

    /// Asks the sender of a stream for a key frame.
    pub fn ask_for_key(&self) {
        if let Some(watch) = self.stream.get() {
            watch.ask_for_key_frame();
        }
    }

    fn deliver(&self, value: Value) {
        let value = Arc::new(value);
        let mut last = self.last();
        *last = Some(value.clone());
        // Nobody may be subscribed at the moment.
        let _ = self.values.send(value);
    }

    fn last(&self) -> MutexGuard<'_, Option<Arc<Value>>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Value {
    fn of_message(message: Message) -> Self {
        let problem = message.problem().map(ToString::to_string);
        let value = Self::of(message.payload);
        Self {
            sent_ms: message.sent_at.map(ms_since_1970),
            missed: message.missed,
            urgent: message.urgency == Urgency::Urgent,
            replayed: message.replayed,
            ended: message.retained.is_some_and(|retained| retained.has_ended),
            method: message.method,
            problem: problem.or(value.problem),
            ..value
        }
    }

    fn of_frame(frame: Frame) -> Self {
        let age_ms = frame.age.map(|age| age.as_millis());
        let is_video = bitstream::is_video(&frame.payload);
        let key = is_video && bitstream::is_key_frame(&frame.payload.bytes);
        Self {
            age_ms: age_ms.and_then(|age| u64::try_from(age).ok()),
            missed: frame.skipped,
            number: is_video.then_some(frame.number),
            key,
            bytes: frame.sent_bytes,
            ..Self::of(for_page(frame.payload))
        }
    }

    fn of(payload: Payload) -> Self {
        let (bytes, encoding) = (payload.bytes.len(), payload.encoding.to_string());
        let kind = Kind::of(&payload.encoding);
        let (form, limit) = match kind {
            Some(Kind::Image) => ("picture", MAX_PICTURE),
            Some(Kind::Video) => ("video", MAX_PICTURE),
            None => ("json", MAX_VALUE),
        };
        let shown = match bytes <= limit {
            true if kind.is_some() => payload.bytes,
            true => view::value(&payload).to_string().into(),
            false => Bytes::new(),
        };
        let problem = || format!("{bytes} bytes are too many to show: at most {limit} are");
        let (form, shown, problem) = match shown.is_empty() || shown.len() > limit {
            true => ("json", Bytes::from_static(b"null"), Some(problem())),
            false => (form, shown, None),
        };
        Self {
            form,
            at: since_1970(SystemTime::now()),
            sent_ms: None,
            age_ms: None,
            number: None,
            key: false,
            bytes,
            encoding,
            missed: 0,
            urgent: false,
            replayed: false,
            ended: false,
            method: None,
            problem,
            shown,
        }
    }

    /// Returns the message for the `Watch` of that number.
    pub fn message(&self, id: u32) -> Bytes {
        let header = DataHeader {
            id,
            form: self.form,
            at_ms: self.at.as_secs_f64() * 1000.0,
            sent_ms: self.sent_ms,
            age_ms: self.age_ms,
            number: self.number,
            key: self.key,
            bytes: self.bytes,
            encoding: &self.encoding,
            missed: self.missed,
            urgent: self.urgent,
            replayed: self.replayed,
            ended: self.ended,
            method: self.method.as_deref(),
            problem: self.problem.as_deref(),
        };
        protocol::data(&header, &self.shown)
    }
}

/// Returns a raw picture, as a decoded video has it, in a form that browsers show. Everything else stays as it is.
fn for_page(payload: Payload) -> Payload {
    if payload.encoding.kind() != EncodingKind::Raw {
        return payload;
    }
    Jpeg::new(QUALITY).encode(&payload).unwrap_or(payload)
}

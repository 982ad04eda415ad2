//! Logs what a program reports through the crate `tracing`.
use std::{collections::BTreeMap, fmt, time::SystemTime};

use rect_core::{
    clock::unix::ms_since_1970,
    log::{level::Level, line::Line},
};
use serde_json::Value;
use tracing::field::{Field, Visit};
use tracing_subscriber::{layer::Context, Layer};

use super::super::robot::Robot;

/// The targets of RECT and Zenoh themselves. Their lines are not part of the program's log, and could cause further ones.
const SKIPPED: [&str; 5] = ["rect", "zenoh", "link_lanes", "tokio", "bluer"];
/// The name under which `tracing` gives the text of an event.
const TEXT: &str = "message";

/// A layer of [`tracing_subscriber`] that [logs](Robot::log_line) each event of the program, with its target, fields and place in the source.
/// Events of RECT and Zenoh are skipped.
///
/// ```no_run
/// # async fn log() -> Result<(), rect::Error> {
/// use tracing_subscriber::prelude::*;
/// let robot = rect::connect("wombat-1").await?;
/// tracing_subscriber::registry().with(rect::LogLayer::new(&robot)).init();
/// tracing::warn!(angle = 12.5, "the gripper is slow");
/// # Ok(()) }
/// ```
#[derive(Clone, Debug)]
pub struct LogLayer(Robot);

impl LogLayer {
    /// Creates a layer that logs as a program of `robot`.
    pub fn new(robot: &Robot) -> Self {
        Self(robot.clone())
    }
}

impl<S: tracing::Subscriber> Layer<S> for LogLayer {
    fn on_event(&self, event: &tracing::Event<'_>, _context: Context<'_, S>) {
        let metadata = event.metadata();
        let target = metadata.target();
        let is_part = |own: &str| {
            let rest = target.strip_prefix(own);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with(['_', ':']))
        };
        if SKIPPED.into_iter().any(is_part) {
            return;
        }
        let level = match *metadata.level() {
            tracing::Level::ERROR => Level::Error,
            tracing::Level::WARN => Level::Warn,
            tracing::Level::INFO => Level::Info,
            _ => Level::Debug,
        };
        let mut fields = Fields::default();
        event.record(&mut fields);
        let place = (metadata.file(), metadata.line());
        let source = match place {
            (Some(file), Some(line)) => format!("{file}:{line}"),
            _ => String::new(),
        };
        let now_ms = ms_since_1970(SystemTime::now());
        self.0.log_line(Line {
            logger: target.to_owned(),
            fields: fields.values,
            source,
            ..Line::new(now_ms, level, fields.text)
        });
    }
}

#[derive(Default)]
struct Fields {
    text: String,
    values: BTreeMap<String, Value>,
}

impl Fields {
    fn add(&mut self, field: &Field, value: impl Into<Value>) {
        self.values.insert(field.name().to_owned(), value.into());
    }
}

impl Visit for Fields {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        let text = format!("{value:?}");
        match field.name() {
            TEXT => self.text = text,
            _ => self.add(field, text),
        }
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            TEXT => value.clone_into(&mut self.text),
            _ => self.add(field, value),
        }
    }

    fn record_f64(&mut self, field: &Field, value: f64) {
        self.add(field, value);
    }

    fn record_i64(&mut self, field: &Field, value: i64) {
        self.add(field, value);
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        self.add(field, value);
    }

    fn record_bool(&mut self, field: &Field, value: bool) {
        self.add(field, value);
    }
}

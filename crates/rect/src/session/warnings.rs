//! Warns the program: of values that do not fit their type, and of names that nobody has.
use std::{
    fmt::Display,
    io::Write,
    sync::{Arc, Mutex},
    time::Instant,
};

use rect_core::{
    message::{counters::AtomicCounters, problems::Problems},
    name::{key::KeySpace, topic::Topic, Name},
    session::name_check::{NameCheck, Used, UsedNames},
};

use super::shared::{lock, Sink};

/// The warnings of one program, and the state that prevents their repetition.
pub(super) struct Warnings {
    counting: Arc<AtomicCounters>,
    problems: Mutex<Problems>,
    names: Mutex<UsedNames>,
    /// The last problem of the router with a retained value.
    state: Mutex<Option<String>>,
}

impl Warnings {
    pub(super) fn new(counting: Arc<AtomicCounters>) -> Arc<Self> {
        Arc::new(Self {
            counting,
            problems: Mutex::default(),
            names: Mutex::default(),
            state: Mutex::default(),
        })
    }

    /// Counts a message without a value, and warns of the first one of each sender and topic.
    pub(super) fn on_problem(&self, sender: &Name, topic: &Topic, problem: &dyn Display) {
        self.counting.on_problem();
        let warning = lock(&self.problems).on_problem(sender, topic, problem);
        if let Some(warning) = warning {
            warn(&warning);
        }
    }

    /// Returns the check of a name that the program uses, if there is to be one.
    pub(super) fn name_check(&self, place: &KeySpace, used: Used) -> Option<NameCheck> {
        lock(&self.names).check(place, used, Instant::now())
    }

    /// Warns of a problem that the router has with a retained value.
    pub(super) fn on_retention_problem(&self, text: &str) {
        if lock(&self.state).replace(text.to_owned()).as_deref() != Some(text) {
            warn(text);
        }
    }

    /// Warns of a topic or pattern that is probably misspelled.
    pub(super) fn on_topic(&self, topic: &str) {
        let warning = lock(&self.names).on_topic(topic);
        if let Some(warning) = warning {
            warn(&warning);
        }
    }
}

/// Passes the warnings of a driver to the program.
pub(super) struct WarningSink;

impl Sink<String> for WarningSink {
    fn deliver(&self, warning: String) {
        warn(&warning);
    }
}

/// Warns the program through `tracing`, or on standard error if it has no subscriber of `tracing`.
pub(super) fn warn(text: &str) {
    if tracing::dispatcher::has_been_set() {
        tracing::warn!(target: "rect", "{text}");
    } else {
        // Unlike `eprintln!`, without a panic if it is closed.
        let _ = writeln!(std::io::stderr(), "rect: {text}");
    }
}

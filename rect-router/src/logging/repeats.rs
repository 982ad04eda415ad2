//! Sums up warnings and errors that repeat: after some lines from the same place of the program, further ones are counted, and
//! the log states how many there were.

use std::{
    collections::HashMap,
    fmt,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use tracing::{
    callsite::Identifier,
    field::{Field, Visit},
    Event, Level, Subscriber,
};
use tracing_subscriber::layer::{Context, Layer};

/// The time over which lines are counted.
const PERIOD: Duration = Duration::from_secs(10);
/// Number of lines from one place that are logged within [`PERIOD`].
const MAX_LINES: u64 = 10;

/// The lines from one place of the program.
#[derive(Debug)]
struct Repeated {
    since: Instant,
    lines: u64,
    /// The last line that was not logged.
    text: String,
}

/// Counts the lines of each place.
#[derive(Debug, Default)]
struct Repeats {
    places: HashMap<Identifier, Repeated>,
}

impl Repeats {
    /// Returns whether a line is logged. `text` is called if it is not.
    fn on_line(&mut self, place: Identifier, text: impl FnOnce() -> String, now: Instant) -> bool {
        let fresh = || Repeated {
            since: now,
            lines: 0,
            text: String::new(),
        };
        let repeated = self.places.entry(place).or_insert_with(fresh);
        repeated.lines += 1;
        if repeated.lines <= MAX_LINES {
            return true;
        }
        repeated.text = text();
        false
    }

    /// Returns the summaries of the periods that have passed.
    fn summaries(&mut self, now: Instant) -> Vec<String> {
        let mut summaries = Vec::new();
        self.places.retain(|_, repeated| {
            let has_passed = now >= repeated.since + PERIOD;
            let more = repeated.lines.saturating_sub(MAX_LINES);
            if has_passed && more > 0 {
                summaries.push(format!("and {more} more: {}", repeated.text));
            }
            !has_passed
        });
        summaries
    }
}

/// The part of the log that drops repeated lines, and passes summaries on.
pub struct SummedUp {
    repeats: &'static Mutex<Repeats>,
    write: fn(String),
}

/// Writes the summaries that are due, even if nothing is logged.
#[derive(Clone, Copy)]
pub struct Summaries {
    repeats: &'static Mutex<Repeats>,
    write: fn(String),
}

/// Creates both. Each summary is passed to `write`.
pub fn sum_up(write: fn(String)) -> (SummedUp, Summaries) {
    let repeats: &'static Mutex<Repeats> = Box::leak(Box::default());
    (SummedUp { repeats, write }, Summaries { repeats, write })
}

impl Summaries {
    /// Writes what is due.
    pub fn write(&self) {
        let summaries = self.repeats.lock().summaries(Instant::now());
        summaries.into_iter().for_each(self.write);
    }
}

impl<S: Subscriber> Layer<S> for SummedUp {
    fn event_enabled(&self, event: &Event<'_>, _: Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if *metadata.level() > Level::WARN {
            return true;
        }
        let text = || {
            let mut text = Text::default();
            event.record(&mut text);
            format!("{}:{}{}", metadata.target(), text.message, text.fields)
        };
        let now = Instant::now();
        let (summaries, is_logged) = {
            let mut repeats = self.repeats.lock();
            let summaries = repeats.summaries(now);
            (summaries, repeats.on_line(metadata.callsite(), text, now))
        };
        summaries.into_iter().for_each(self.write);
        is_logged
    }
}

/// The message of an event, and its fields.
#[derive(Default)]
struct Text {
    message: String,
    fields: String,
}

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        match field.name() {
            "message" => self.message.push_str(&format!(" {value:?}")),
            name => self.fields.push_str(&format!(" {name}={value:?}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex as StdMutex;

    use tracing_subscriber::prelude::*;

    use super::*;

    static WRITTEN: StdMutex<Vec<String>> = StdMutex::new(Vec::new());
    static LOGGED: StdMutex<u64> = StdMutex::new(0);

    /// Counts the events that are logged.
    struct Counted;

    impl<S: Subscriber> Layer<S> for Counted {
        fn on_event(&self, _: &Event<'_>, _: Context<'_, S>) {
            *LOGGED.lock().expect("unpoisoned") += 1;
        }
    }

    #[test]
    fn repeated_warnings_are_summed_up_and_others_are_not() {
        let write = |text| WRITTEN.lock().expect("unpoisoned").push(text);
        let (summed_up, summaries) = sum_up(write);
        let log = tracing_subscriber::registry().with(Counted).with(summed_up);
        tracing::subscriber::with_default(log, || {
            for scope in 0..422 {
                tracing::error!(scope, "unknown scope");
                tracing::info!("normal");
            }
            tracing::error!("from another place");
        });
        let logged = *LOGGED.lock().expect("unpoisoned");
        assert_eq!(logged, MAX_LINES + 422 + 1);
        summaries.write();
        assert!(WRITTEN.lock().expect("unpoisoned").is_empty());
        let due = (summaries.repeats.lock()).summaries(Instant::now() + PERIOD);
        let target = module_path!();
        assert_eq!(
            due,
            [format!("and 412 more: {target}: unknown scope scope=421")]
        );
        assert!(summaries.repeats.lock().places.is_empty());
    }
}

//! Warns of names that nobody has, and of values that do not fit.
use std::fmt::Display;

use rect_core::{
    name::{topic::Topic, Name},
    session::name_check::Used,
};

use super::{executor::Executor, robot::Robot, warnings::WarningSink};

impl Robot {
    /// Counts a value that does not fit in [`Counters::problems`](crate::Counters) and warns of the first one of each sender and
    /// topic, for a program that converts payloads itself.
    pub fn on_problem(&self, sender: &Name, topic: &Topic, problem: &dyn Display) {
        self.inner.warnings.on_problem(sender, topic, problem);
    }

    /// Warns if nobody has a name that the program uses, within 3 s.
    pub(super) fn check_name(&self, used: Used) {
        let inner = &self.inner;
        if let Some(check) = inner.warnings.name_check(&inner.place, used) {
            let executor = Executor::new(&inner.session, check, WarningSink);
            inner.runtime.spawn(async move {
                // Fails if the session is closed.
                let _ = executor.run().await;
            });
        }
    }
}

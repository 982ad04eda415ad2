//! Decides when a question that nobody has answered is asked again.
//!
//! A question may reach a router before the declaration of the program that would answer: over Bluetooth, declarations and
//! messages travel on lanes of their own, and on a busy computer one can be processed long before the other.
use std::time::{Duration, Instant};

/// The pauses before a question is asked again while nobody has answered.
const PAUSES: [Duration; 2] = [Duration::from_millis(50), Duration::from_millis(200)];

/// A question, and how often it was asked.
#[derive(Debug)]
pub struct Question {
    next: Next,
    /// How often it is asked in any case.
    least: usize,
    ended: usize,
}

/// The next step of a driver with a question.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Ask now.
    Ask,
    /// Ask at this time.
    At(Instant),
    /// Wait for the answers.
    Wait,
    /// Nothing: it is not asked any more.
    Finish,
}

impl Question {
    /// Creates a question that is asked at least that often.
    pub fn new(least: usize) -> Self {
        Self {
            next: Next::Ask,
            least,
            ended: 0,
        }
    }

    /// Handles that no more answers follow. `is_answered`: there was one.
    pub fn on_ended(&mut self, now: Instant, is_answered: bool) {
        self.ended += 1;
        self.next = match self.ended.checked_sub(self.least) {
            None => Next::Ask,
            Some(repeated) if !is_answered && repeated < PAUSES.len() => {
                Next::At(now + PAUSES[repeated])
            }
            Some(_) => Next::Finish,
        };
    }

    /// Ends the question.
    pub fn finish(&mut self) {
        self.next = Next::Finish;
    }

    /// Returns what to do now.
    pub fn next(&mut self, now: Instant) -> Next {
        match self.next {
            Next::At(at) if now < at => self.next,
            Next::Ask | Next::At(_) => {
                self.next = Next::Wait;
                Next::Ask
            }
            Next::Wait | Next::Finish => self.next,
        }
    }
}

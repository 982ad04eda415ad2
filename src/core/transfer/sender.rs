//! Owns the sending side of one transfer: when to offer it (again), what a request gets, and when it is over.
//!
//! It offers until the receiver says how it ended: links come and go, the receiver's program may not run yet, and either
//! may be restarted. While the receiver asks for ranges it need not be asked how it goes.
use std::{
    ops::Range,
    time::{Duration, Instant},
};

use super::{
    answer::{Answer, Fault, Refusal},
    progress::Progress,
    request::Request,
};

/// Between the first two offers where nobody answers; twice as long each time.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// The longest pause between two offers.
const LAST_PAUSE: Duration = Duration::from_secs(5);
/// How long a receiver that works on it may say nothing before it is asked again.
const QUIET: Duration = Duration::from_secs(3);
/// How long an offer is waited for, whatever the layer below says.
const ANSWER: Duration = Duration::from_secs(10);

/// A transfer that is being sent. Given the time and what came; says what to do.
#[derive(Debug)]
pub struct Sender {
    size_bytes: u64,
    patience: Option<Duration>,
    state: State,
    pause: Duration,
    jitter: u64,
    heard: Instant,
    /// How often nobody answered since something was heard.
    unanswered: u32,
    held_bytes: u64,
    /// How many times it was offered.
    offers: u64,
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    /// An offer is out. `again`: something happened since; offer again as soon as this one is answered.
    Offering {
        until: Instant,
        again: bool,
    },
    Waiting {
        until: Instant,
    },
    Over(Outcome),
}

/// How a transfer ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// All is there, with the right checksum.
    Done,
    /// It is not taken.
    Refused(Refusal),
    /// It was taken, and can't be finished.
    Failed(Fault),
    /// Nothing was heard of the receiver for as long as the program wanted to wait.
    Unanswered(Duration),
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Offer it, wait at most so long, and tell what was answered ([`Sender::on_answers`]).
    Offer(Duration),
    /// Nothing before then, unless something comes.
    Wait(Instant),
    /// It is over.
    Over(Outcome),
}

/// The response to a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Response {
    /// These bytes of the source.
    Piece(Range<u64>),
    /// The encoded offer: this robot does offer the transfer.
    Offer,
    /// Nothing yet. The query stays open until the answers to the offer of this number have come (the first has number 1), so
    /// that the receiver knows when the sender has learned how the transfer ended.
    AfterOffer(u64),
}

impl Sender {
    /// Of so many bytes. `patience`: how long nothing may be heard of the receiver; `None`: until the program ends it.
    /// `seed`: any number; pauses vary by it, so that many robots do not offer at once.
    pub fn new(now: Instant, size_bytes: u64, patience: Option<Duration>, seed: u64) -> Self {
        Self {
            size_bytes,
            patience,
            state: State::Waiting { until: now },
            pause: FIRST_PAUSE,
            jitter: seed | 1,
            heard: now,
            unanswered: 0,
            held_bytes: 0,
            offers: 0,
        }
    }

    /// What to do now.
    pub fn poll(&mut self, now: Instant) -> Step {
        match self.state.clone() {
            State::Offering { until, .. } if until <= now => {
                self.on_answers(now, &[]);
                self.poll(now)
            }
            State::Waiting { until } if until <= now => {
                self.state = State::Offering {
                    until: now + ANSWER,
                    again: false,
                };
                self.offers += 1;
                Step::Offer(ANSWER / 2)
            }
            State::Offering { until, .. } | State::Waiting { until } => Step::Wait(until),
            State::Over(outcome) => Step::Over(outcome),
        }
    }

    /// What the receiver's programs answered to an offer; none if nobody did.
    pub fn on_answers(&mut self, now: Instant, answers: &[Answer]) {
        let State::Offering { again, .. } = self.state else {
            return;
        };
        if !answers.is_empty() {
            (self.heard, self.unanswered) = (now, 0);
        }
        for answer in answers {
            if let Answer::Running { held_bytes } = answer {
                self.on_held(*held_bytes);
            }
        }
        if let Some(outcome) = settled(answers) {
            if outcome == Outcome::Done {
                self.held_bytes = self.size_bytes;
            }
            self.state = State::Over(outcome);
            return;
        }
        let pause = if answers.is_empty() {
            self.unanswered += 1;
            let silent = now.saturating_duration_since(self.heard);
            if self.unanswered > 3 && self.patience.is_some_and(|patience| silent > patience) {
                self.state = State::Over(Outcome::Unanswered(silent));
                return;
            }
            let pause = self.pause;
            self.pause = (pause * 2).min(LAST_PAUSE);
            pause + pause.mul_f64(self.random() / 4.0)
        } else {
            self.pause = FIRST_PAUSE;
            QUIET
        };
        let pause = if again { Duration::ZERO } else { pause };
        self.state = State::Waiting { until: now + pause };
    }

    /// 0 to 1. Xorshift: it only has to differ.
    fn random(&mut self) -> f64 {
        self.jitter ^= self.jitter << 13;
        self.jitter ^= self.jitter >> 7;
        self.jitter ^= self.jitter << 17;
        (self.jitter >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Handles a request and returns what it is answered with.
    ///
    /// # Errors
    /// [`Fault::Protocol`]: there are no such bytes. [`Fault::Stopped`]: the transfer is over, so it is not confirmed any
    /// more. The request is answered with this error.
    pub fn on_request(&mut self, now: Instant, request: &Request) -> Result<Response, Fault> {
        (self.heard, self.unanswered) = (now, 0);
        match *request {
            Request::Range {
                offset,
                length,
                held_bytes,
            } => {
                let range = Request::range(offset, length, self.size_bytes)?;
                self.on_held(held_bytes);
                self.quiet_until(now + QUIET);
                Ok(Response::Piece(range))
            }
            Request::Confirm => {
                if matches!(self.state, State::Over(_)) {
                    return Err(Fault::Stopped);
                }
                self.quiet_until(now + QUIET);
                Ok(Response::Offer)
            }
            Request::Ended => {
                match &mut self.state {
                    State::Waiting { until } => *until = now,
                    State::Offering { again, .. } => *again = true,
                    State::Over(_) => {}
                }
                Ok(Response::AfterOffer(self.offers + 1))
            }
        }
    }

    /// The receiver works on it: it is not offered again before then.
    fn quiet_until(&mut self, until: Instant) {
        if let State::Waiting { .. } = self.state {
            self.state = State::Waiting { until };
        }
    }

    fn on_held(&mut self, held_bytes: u64) {
        self.held_bytes = held_bytes.min(self.size_bytes);
    }

    /// The source can't be read any more, or is another one.
    pub fn on_fault(&mut self, fault: Fault) {
        if !matches!(self.state, State::Over(_)) {
            self.state = State::Over(Outcome::Failed(fault));
        }
    }

    /// How much the receiver holds, as far as it told.
    pub fn progress(&self) -> Progress {
        Progress {
            held_bytes: self.held_bytes,
            size_bytes: self.size_bytes,
        }
    }
}

/// What several programs of a robot say to one offer: whoever works on it counts most, then whoever has it, then whoever
/// failed; and only if none wants it, it is refused.
fn settled(answers: &[Answer]) -> Option<Outcome> {
    let rank = |answer: &Answer| match answer {
        Answer::Running { .. } | Answer::Busy => 0,
        Answer::Done => 1,
        Answer::Failed(_) => 2,
        Answer::Refused(Refusal::NotWanted) => 4,
        Answer::Refused(_) => 3,
    };
    match answers.iter().min_by_key(|answer| rank(answer))? {
        Answer::Running { .. } | Answer::Busy => None,
        Answer::Done => Some(Outcome::Done),
        Answer::Failed(fault) => Some(Outcome::Failed(fault.clone())),
        Answer::Refused(refusal) => Some(Outcome::Refused(refusal.clone())),
    }
}

#[cfg(test)]
mod tests;

//! Implements the sender of one transfer: decides when to repeat the offer, how to reply to requests, and when the
//! transfer has finished.
//!
//! The offer is repeated until the receiver reports the end: links may fail, the receiver's program may not be running
//! yet, and either side may be restarted. While the receiver requests pieces, there is no need to repeat the offer.
use std::{
    ops::Range,
    time::{Duration, Instant},
};

use super::{
    answer::{Answer, Fault, Refusal},
    progress::Progress,
    request::Request,
};

/// The pause after the first unanswered offer. It doubles each time.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// The maximum pause between two offers.
const LAST_PAUSE: Duration = Duration::from_secs(5);
/// How long an active receiver may be silent before the offer is repeated.
const QUIET: Duration = Duration::from_secs(3);
/// The timeout of an offer, whatever the layer below reports.
const ANSWER: Duration = Duration::from_secs(10);

/// A transfer that is being sent. It is given the time and the events, and returns what to do.
#[derive(Debug)]
pub struct Sender {
    size_bytes: u64,
    timeout: Option<Duration>,
    state: State,
    pause: Duration,
    jitter: u64,
    /// When the receiver last made a request, or answered that it receives or will receive the transfer.
    last_contact: Instant,
    /// Number of offers since then.
    unanswered: u32,
    received_bytes: u64,
    /// Number of offers made.
    offers: u64,
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    /// An offer is in flight. `again`: the receiver has since reported the end of the transfer; the offer is repeated
    /// as soon as this one is answered.
    Offering {
        until: Instant,
        again: bool,
    },
    Waiting {
        until: Instant,
    },
    Finished(Outcome),
}

/// The outcome of a transfer, as seen by its sender.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The receiver has everything, and the checksum is correct.
    Done,
    /// The receiver refused the offer.
    Refused(Refusal),
    /// The transfer began, but failed.
    Failed(Fault),
    /// The receiver did not answer for this long, which exceeds the timeout.
    NoAnswer(Duration),
    /// The receiving program did not take the transfers that have arrived for this long, which exceeds the timeout.
    NotTaken(Duration),
}

/// The next action.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Send the offer, wait for answers for at most this long, and report them with [`Sender::on_answers`].
    Offer(Duration),
    /// Wait until this time, unless an event occurs.
    Wait(Instant),
    /// The transfer has finished.
    Finished(Outcome),
}

/// The reply to a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Response {
    /// These bytes of the source.
    Piece(Range<u64>),
    /// The encoded offer, which confirms it.
    Offer,
    /// No reply yet. Keep the query open until the answers to the offer with this number (the first has number 1) have
    /// arrived. The receiver learns from the end of the query that the sender knows the outcome.
    AfterOffer(u64),
}

impl Sender {
    /// Creates the sender of a transfer of `size_bytes`. `timeout` is how long the receiver may be silent, and how long its program
    /// may take none of the transfers that have arrived; `None` for no limit. `seed` is any number, by which the pauses vary so that several robots do not send offers
    /// simultaneously.
    pub fn new(now: Instant, size_bytes: u64, timeout: Option<Duration>, seed: u64) -> Self {
        Self {
            size_bytes,
            timeout,
            state: State::Waiting { until: now },
            pause: FIRST_PAUSE,
            jitter: seed | 1,
            last_contact: now,
            unanswered: 0,
            received_bytes: 0,
            offers: 0,
        }
    }

    /// Returns what to do now.
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
            State::Finished(outcome) => Step::Finished(outcome),
        }
    }

    /// Handles the answers of the receiver's programs to an offer; empty if there were none.
    pub fn on_answers(&mut self, now: Instant, answers: &[Answer]) {
        let State::Offering { again, .. } = self.state else {
            return;
        };
        for answer in answers {
            if let Answer::Running { received_bytes } = answer {
                self.on_received_bytes(*received_bytes);
            }
        }
        let pause = match combined(answers) {
            Some(Answer::Running { .. } | Answer::Busy) => {
                (self.last_contact, self.unanswered) = (now, 0);
                self.pause = FIRST_PAUSE;
                QUIET
            }
            stalled @ (None | Some(Answer::NotTaken)) => {
                self.unanswered += 1;
                let silent = now.saturating_duration_since(self.last_contact);
                if self.unanswered > 3 && self.timeout.is_some_and(|timeout| silent > timeout) {
                    self.state = State::Finished(match stalled {
                        None => Outcome::NoAnswer(silent),
                        Some(_) => Outcome::NotTaken(silent),
                    });
                    return;
                }
                let pause = self.pause;
                self.pause = (pause * 2).min(LAST_PAUSE);
                pause + pause.mul_f64(self.random() / 4.0)
            }
            Some(Answer::Done) => {
                self.received_bytes = self.size_bytes;
                self.state = State::Finished(Outcome::Done);
                return;
            }
            Some(Answer::Failed(fault)) => {
                self.state = State::Finished(Outcome::Failed(fault.clone()));
                return;
            }
            Some(Answer::Refused(refusal)) => {
                self.state = State::Finished(Outcome::Refused(refusal.clone()));
                return;
            }
        };
        let pause = if again { Duration::ZERO } else { pause };
        self.state = State::Waiting { until: now + pause };
    }

    /// Returns a number from 0 to 1 (xorshift; the quality does not matter).
    fn random(&mut self) -> f64 {
        self.jitter ^= self.jitter << 13;
        self.jitter ^= self.jitter >> 7;
        self.jitter ^= self.jitter << 17;
        (self.jitter >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Handles a request, and returns the reply to it.
    ///
    /// # Errors
    /// Returns [`Fault::Protocol`] if the source has no such bytes, and [`Fault::Stopped`] if the transfer has finished
    /// and therefore is not confirmed any more. The error is the reply to the request.
    pub fn on_request(&mut self, now: Instant, request: &Request) -> Result<Response, Fault> {
        (self.last_contact, self.unanswered) = (now, 0);
        match *request {
            Request::Range {
                offset,
                length,
                received_bytes,
            } => {
                let range = Request::range(offset, length, self.size_bytes)?;
                self.on_received_bytes(received_bytes);
                self.quiet_until(now + QUIET);
                Ok(Response::Piece(range))
            }
            Request::Confirm => {
                if matches!(self.state, State::Finished(_)) {
                    return Err(Fault::Stopped);
                }
                self.quiet_until(now + QUIET);
                Ok(Response::Offer)
            }
            Request::Ended => {
                match &mut self.state {
                    State::Waiting { until } => *until = now,
                    State::Offering { again, .. } => *again = true,
                    State::Finished(_) => {}
                }
                Ok(Response::AfterOffer(self.offers + 1))
            }
        }
    }

    /// Suspends the offers until this time, because the receiver is active.
    fn quiet_until(&mut self, until: Instant) {
        if let State::Waiting { .. } = self.state {
            self.state = State::Waiting { until };
        }
    }

    fn on_received_bytes(&mut self, received_bytes: u64) {
        self.received_bytes = received_bytes.min(self.size_bytes);
    }

    /// Handles a fault of the source: it cannot be read any more, or it has changed.
    pub fn on_fault(&mut self, fault: Fault) {
        if !matches!(self.state, State::Finished(_)) {
            self.state = State::Finished(Outcome::Failed(fault));
        }
    }

    /// Returns the progress that the receiver has reported.
    pub fn progress(&self) -> Progress {
        Progress {
            received_bytes: self.received_bytes,
            size_bytes: self.size_bytes,
        }
    }
}

/// Returns the answer that counts of those of several programs of a robot to one offer. A program that is receiving the transfer
/// takes precedence, then one that has received it, one that may still take it, and one that failed. The offer is refused only if all
/// programs refuse it.
fn combined(answers: &[Answer]) -> Option<&Answer> {
    let rank = |answer: &Answer| match answer {
        Answer::Running { .. } | Answer::Busy => 0,
        Answer::Done => 1,
        Answer::NotTaken => 2,
        Answer::Failed(_) => 3,
        Answer::Refused(Refusal::NotAccepted) => 5,
        Answer::Refused(_) => 4,
    };
    answers.iter().min_by_key(|answer| rank(answer))
}

#[cfg(test)]
mod tests;

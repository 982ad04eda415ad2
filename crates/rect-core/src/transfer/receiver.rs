//! Implements the receiver of one transfer: decides which pieces to request and when, and when the transfer has
//! finished.
use std::{
    collections::BTreeMap,
    ops::Range,
    time::{Duration, Instant},
};

use super::{answer::Fault, progress::Progress, ranges::Ranges, request::Request, window::Window};

/// The pause after the first unanswered attempt. It doubles each time.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// The maximum pause between attempts.
const LAST_PAUSE: Duration = Duration::from_secs(2);
/// The minimum number of failed attempts before the timeout applies, so that a jump of the clock does not end a
/// transfer.
const MIN_ATTEMPTS: u32 = 5;

/// A transfer that is being received. It is given the time and the events, and returns what to do.
#[derive(Debug)]
pub struct Receiver {
    size_bytes: u64,
    timeout: Duration,
    state: State,
    held: Ranges,
    /// Bytes that were received or are in flight.
    requested: Ranges,
    in_flight: BTreeMap<u64, InFlight>,
    in_flight_bytes: u64,
    next_id: u64,
    window: Window,
    last_reply: Instant,
    /// Whether some data is from before a restart; it may be the cause of a wrong checksum.
    resumed: bool,
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    /// Requests pieces as the window permits.
    Requesting,
    /// One request failed while others are in flight. Their outcome will show whether the sender is unreachable.
    Suspecting,
    /// The sender does not answer. The next attempt is made at `until`.
    Pausing {
        until: Instant,
        pause: Duration,
        attempts: u32,
    },
    /// A single request is in flight, to check whether the sender answers.
    Probing {
        pause: Duration,
        attempts: u32,
    },
    /// Everything was received, and is being verified.
    Checking,
    Finished(Result<(), Fault>),
}

/// A request that is in flight.
#[derive(Clone, Debug)]
struct InFlight {
    range: Range<u64>,
    requested_at: Instant,
    due: Instant,
}

/// The next action.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Send this request.
    Request(PieceRequest),
    /// Wait until this time, unless an event occurs.
    Wait(Instant),
    /// Everything was received. Compute the checksum, and report it with [`Receiver::on_checked`].
    Check,
    /// The transfer has finished.
    Finished(Result<(), Fault>),
}

/// A request for a piece.
#[derive(Clone, Debug, PartialEq)]
pub struct PieceRequest {
    /// Number that identifies the request in later calls.
    pub id: u64,
    /// Requested bytes.
    pub range: Range<u64>,
    /// Request to send.
    pub request: Request,
    /// Time after which the request counts as lost and is repeated. A later reply is used nevertheless.
    pub timeout: Duration,
}

impl Receiver {
    /// Creates the receiver of a transfer of `size_bytes`. `held` is what was received before a restart. `timeout` is
    /// how long nothing may arrive before the transfer fails.
    pub fn new(now: Instant, size_bytes: u64, held: Ranges, timeout: Duration) -> Self {
        Self {
            size_bytes,
            timeout,
            state: State::Requesting,
            resumed: held.bytes() > 0,
            requested: held.clone(),
            held,
            in_flight: BTreeMap::new(),
            in_flight_bytes: 0,
            next_id: 0,
            window: Window::default(),
            last_reply: now,
        }
    }

    /// Returns what to do now. Call it repeatedly until it returns something other than a request.
    pub fn poll(&mut self, now: Instant) -> Step {
        let late = self
            .in_flight
            .iter()
            .filter(|(_, in_flight)| in_flight.due <= now);
        let late: Vec<u64> = late.map(|(&id, _)| id).collect();
        late.into_iter().for_each(|id| self.on_no_reply(now, id));
        if let State::Finished(result) = &self.state {
            return Step::Finished(result.clone());
        }
        if self.state != State::Checking && self.held.contains(&(0..self.size_bytes)) {
            self.state = State::Checking;
            return Step::Check;
        }
        match self.state.clone() {
            State::Requesting => match self.next_request(now) {
                Some(request) => Step::Request(request),
                None => self.wait(now),
            },
            State::Pausing {
                until,
                pause,
                attempts,
            } if until <= now => {
                let silent = now.saturating_duration_since(self.last_reply);
                if silent > self.timeout && attempts >= MIN_ATTEMPTS {
                    return self.finish(Err(Fault::TimedOut(silent.as_secs())));
                }
                self.state = State::Probing { pause, attempts };
                match self.next_request(now) {
                    Some(request) => Step::Request(request),
                    None => self.wait(now),
                }
            }
            State::Pausing { until, .. } => Step::Wait(until),
            _ => self.wait(now),
        }
    }

    fn wait(&self, now: Instant) -> Step {
        let due = self.in_flight.values().map(|in_flight| in_flight.due).min();
        Step::Wait(due.unwrap_or(now + LAST_PAUSE))
    }

    fn finish(&mut self, result: Result<(), Fault>) -> Step {
        self.state = State::Finished(result.clone());
        Step::Finished(result)
    }

    fn next_request(&mut self, now: Instant) -> Option<PieceRequest> {
        let gap = self.requested.first_gap(self.size_bytes)?;
        let limit = u64::from(self.window.room(now, self.in_flight_bytes)?);
        let range = gap.start..gap.end.min(gap.start + limit);
        let (id, timeout) = (self.next_id, self.window.timeout());
        self.next_id += 1;
        self.requested.insert(range.clone());
        self.in_flight_bytes += range.end - range.start;
        let in_flight = InFlight {
            range: range.clone(),
            requested_at: now,
            due: now + timeout,
        };
        self.in_flight.insert(id, in_flight);
        let length = u32::try_from(range.end - range.start).unwrap_or(u32::MAX);
        let request = Request::Range {
            offset: range.start,
            length,
            received_bytes: self.held.bytes(),
        };
        Some(PieceRequest {
            id,
            range,
            request,
            timeout,
        })
    }

    /// Removes a request from those in flight.
    fn take(&mut self, id: u64) -> Option<InFlight> {
        let in_flight = self.in_flight.remove(&id)?;
        self.in_flight_bytes -= in_flight.range.end - in_flight.range.start;
        Some(in_flight)
    }

    /// Handles a reply of `bytes` bytes. Returns whether to store them and then call [`Self::on_written`]; otherwise
    /// they are present already, or the transfer has finished. A reply of another length than requested ends the
    /// transfer with [`Fault::Protocol`].
    pub fn on_reply(&mut self, now: Instant, request: &PieceRequest, bytes: u64) -> bool {
        if matches!(self.state, State::Finished(_)) {
            return false;
        }
        let expected = request.range.end - request.range.start;
        if bytes != expected {
            let text = format!("{bytes} bytes were received where {expected} were requested");
            self.finish(Err(Fault::Protocol(text)));
            return false;
        }
        self.last_reply = now;
        let in_flight = self.take(request.id);
        match self.state {
            State::Suspecting => {
                self.window.on_lost();
                self.state = State::Requesting;
            }
            // A reply to a request that had timed out: the sender is reachable.
            State::Probing { .. } | State::Pausing { .. } => self.state = State::Requesting,
            _ => {}
        }
        if let Some(in_flight) = in_flight {
            let bytes = u32::try_from(expected).unwrap_or(u32::MAX);
            self.window.on_piece(now, in_flight.requested_at, bytes);
        }
        self.state != State::Checking && !self.held.contains(&request.range)
    }

    /// Handles bytes that were stored.
    pub fn on_written(&mut self, range: Range<u64>) {
        self.requested.insert(range.clone());
        self.held.insert(range);
    }

    /// Handles bytes that could not be stored.
    pub fn on_write_failed(&mut self, reason: String) {
        self.end(Fault::NotStored(reason));
    }

    /// Handles a request that ended without a reply: the sender is unreachable or not running.
    pub fn on_no_reply(&mut self, now: Instant, id: u64) {
        let Some(in_flight) = self.take(id) else {
            return;
        };
        self.requested.remove(in_flight.range.clone());
        // A late reply may have delivered a part of it.
        let present: Vec<_> = self
            .held
            .iter()
            .filter(|held| held.start < in_flight.range.end)
            .collect();
        present
            .into_iter()
            .for_each(|held| self.requested.insert(held));
        let paused = |pause: Duration, attempts| State::Pausing {
            until: now + pause,
            pause,
            attempts,
        };
        match self.state {
            State::Requesting | State::Suspecting if self.in_flight.is_empty() => {
                self.window.on_interruption();
                self.state = paused(FIRST_PAUSE, 0);
            }
            State::Requesting => self.state = State::Suspecting,
            State::Probing { pause, attempts } => {
                self.state = paused((pause * 2).min(LAST_PAUSE), attempts + 1);
            }
            _ => {}
        }
    }

    /// Handles a fault that the sender reported.
    pub fn on_fault(&mut self, id: u64, fault: Fault) {
        if self.take(id).is_some() {
            self.end(fault);
        }
    }

    /// Handles a repeated offer: the sender is reachable, so the pause ends.
    pub fn on_offered(&mut self, now: Instant) {
        if let State::Pausing {
            pause, attempts, ..
        } = self.state
        {
            self.state = State::Pausing {
                until: now,
                pause: pause.min(FIRST_PAUSE),
                attempts,
            };
        }
    }

    /// Handles the verification of the checksum.
    pub fn on_checked(&mut self, is_correct: bool) {
        if self.state != State::Checking {
            return;
        }
        if is_correct {
            self.finish(Ok(()));
        } else if std::mem::take(&mut self.resumed) {
            // Data from before a restart may have been damaged when the computer lost power. Request everything again,
            // once.
            (self.held, self.requested) = (Ranges::default(), Ranges::default());
            self.in_flight.clear();
            self.in_flight_bytes = 0;
            self.state = State::Requesting;
        } else {
            self.end(Fault::Checksum);
        }
    }

    /// Ends the transfer with a fault, for example because the program stops it.
    pub fn end(&mut self, fault: Fault) {
        if !matches!(self.state, State::Finished(_)) {
            self.finish(Err(fault));
        }
    }

    /// Returns the received ranges.
    pub fn held(&self) -> &Ranges {
        &self.held
    }

    /// Returns the progress.
    pub fn progress(&self) -> Progress {
        Progress {
            received_bytes: self.held.bytes(),
            size_bytes: self.size_bytes,
        }
    }

    /// Returns the number of bytes that were requested and have neither arrived nor timed out.
    pub fn in_flight_bytes(&self) -> u64 {
        self.in_flight_bytes
    }

    /// Returns the window.
    pub fn window(&self) -> &Window {
        &self.window
    }
}

#[cfg(test)]
mod tests;

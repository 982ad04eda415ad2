//! Owns the receiving side of one transfer: what to ask for and when, and when it is over.
use std::{
    collections::BTreeMap,
    ops::Range,
    time::{Duration, Instant},
};

use super::{answer::Fault, progress::Progress, ranges::Ranges, request::Request, window::Window};

/// Between the first two tries where nobody answers; twice as long each time.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// The longest pause between tries.
const LAST_PAUSE: Duration = Duration::from_secs(2);
/// How many tries come to nothing before patience counts: a clock that jumps ends nothing.
const MIN_TRIES: u32 = 5;

/// A transfer that is being received. Given the time and what came; says what to do.
#[derive(Debug)]
pub struct Receiver {
    size_bytes: u64,
    patience: Duration,
    state: State,
    held: Ranges,
    /// What is held or on its way.
    asked: Ranges,
    out: BTreeMap<u64, Out>,
    out_bytes: u64,
    next_ticket: u64,
    window: Window,
    heard: Instant,
    /// Something is from before a restart: a wrong checksum may be its fault.
    resumed: bool,
}

#[derive(Clone, Debug, PartialEq)]
enum State {
    /// Asks as the window lets it.
    Pulling,
    /// A request came to nothing while others are out: they will tell whether the way is cut.
    Doubting,
    /// Nobody answers. Tried again then.
    Pausing {
        until: Instant,
        pause: Duration,
        tries: u32,
    },
    /// One request is out, to see.
    Trying {
        pause: Duration,
        tries: u32,
    },
    /// All is there, and is being checked.
    Checking,
    Over(Result<(), Fault>),
}

/// A request that is out.
#[derive(Clone, Debug)]
struct Out {
    range: Range<u64>,
    asked_at: Instant,
    due: Instant,
}

/// What to do next.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Ask the sender for this.
    Ask(Ask),
    /// Nothing before then, unless something comes.
    Wait(Instant),
    /// All is there: compute the checksum and say [`Receiver::on_checked`].
    Check,
    /// It is over.
    Over(Result<(), Fault>),
}

/// A request to the sender.
#[derive(Clone, Debug, PartialEq)]
pub struct Ask {
    /// Its number, by which what comes of it is told.
    pub ticket: u64,
    /// Which bytes.
    pub range: Range<u64>,
    /// What to send.
    pub request: Request,
    /// After this it counts as lost, and is asked for again. What comes later is of use all the same.
    pub timeout: Duration,
}

impl Receiver {
    /// Of so many bytes, some of which may be there from before a restart. `patience`: how long nothing may come before it
    /// is given up.
    pub fn new(now: Instant, size_bytes: u64, held: Ranges, patience: Duration) -> Self {
        Self {
            size_bytes,
            patience,
            state: State::Pulling,
            resumed: held.bytes() > 0,
            asked: held.clone(),
            held,
            out: BTreeMap::new(),
            out_bytes: 0,
            next_ticket: 0,
            window: Window::default(),
            heard: now,
        }
    }

    /// What to do now. Ask until it says something else.
    pub fn poll(&mut self, now: Instant) -> Step {
        let late = self.out.iter().filter(|(_, out)| out.due <= now);
        let late: Vec<u64> = late.map(|(&ticket, _)| ticket).collect();
        late.into_iter()
            .for_each(|ticket| self.on_silence(now, ticket));
        if let State::Over(how) = &self.state {
            return Step::Over(how.clone());
        }
        if self.state != State::Checking && self.held.contains(&(0..self.size_bytes)) {
            self.state = State::Checking;
            return Step::Check;
        }
        match self.state.clone() {
            State::Pulling => match self.ask(now) {
                Some(ask) => Step::Ask(ask),
                None => self.wait(now),
            },
            State::Pausing {
                until,
                pause,
                tries,
            } if until <= now => {
                let silent = now.saturating_duration_since(self.heard);
                if silent > self.patience && tries >= MIN_TRIES {
                    return self.over(Err(Fault::Silence(silent.as_secs())));
                }
                self.state = State::Trying { pause, tries };
                match self.ask(now) {
                    Some(ask) => Step::Ask(ask),
                    None => self.wait(now),
                }
            }
            State::Pausing { until, .. } => Step::Wait(until),
            _ => self.wait(now),
        }
    }

    fn wait(&self, now: Instant) -> Step {
        let due = self.out.values().map(|out| out.due).min();
        Step::Wait(due.unwrap_or(now + LAST_PAUSE))
    }

    fn over(&mut self, how: Result<(), Fault>) -> Step {
        self.state = State::Over(how.clone());
        Step::Over(how)
    }

    fn ask(&mut self, now: Instant) -> Option<Ask> {
        let gap = self.asked.first_gap(self.size_bytes)?;
        let most = u64::from(self.window.room(now, self.out_bytes)?);
        let range = gap.start..gap.end.min(gap.start + most);
        let (ticket, timeout) = (self.next_ticket, self.window.timeout());
        self.next_ticket += 1;
        self.asked.insert(range.clone());
        self.out_bytes += range.end - range.start;
        let out = Out {
            range: range.clone(),
            asked_at: now,
            due: now + timeout,
        };
        self.out.insert(ticket, out);
        let length = u32::try_from(range.end - range.start).unwrap_or(u32::MAX);
        let request = Request::Range {
            offset: range.start,
            length,
            held_bytes: self.held.bytes(),
        };
        Some(Ask {
            ticket,
            range,
            request,
            timeout,
        })
    }

    fn take(&mut self, ticket: u64) -> Option<Out> {
        let out = self.out.remove(&ticket)?;
        self.out_bytes -= out.range.end - out.range.start;
        Some(out)
    }

    /// A reply with so many bytes. `true`: they are to be kept, and then to be told as [`Self::on_kept`]; `false`: they are
    /// there already, or it is over.
    pub fn on_reply(&mut self, now: Instant, ask: &Ask, bytes: u64) -> bool {
        if matches!(self.state, State::Over(_)) {
            return false;
        }
        let wanted = ask.range.end - ask.range.start;
        if bytes != wanted {
            let text = format!("{bytes} bytes came where {wanted} were asked for");
            self.over(Err(Fault::Protocol(text)));
            return false;
        }
        self.heard = now;
        let out = self.take(ask.ticket);
        match self.state {
            State::Doubting => {
                self.window.on_lost();
                self.state = State::Pulling;
            }
            // One that was given up came all the same: the way is there.
            State::Trying { .. } | State::Pausing { .. } => self.state = State::Pulling,
            _ => {}
        }
        if let Some(out) = out {
            let bytes = u32::try_from(wanted).unwrap_or(u32::MAX);
            self.window.on_piece(now, out.asked_at, bytes);
        }
        self.state != State::Checking && !self.held.contains(&ask.range)
    }

    /// These bytes are where they belong.
    pub fn on_kept(&mut self, range: Range<u64>) {
        self.asked.insert(range.clone());
        self.held.insert(range);
    }

    /// They can't be kept.
    pub fn on_not_kept(&mut self, reason: String) {
        self.end(Fault::NotKept(reason));
    }

    /// A request ended without a reply: the way was cut, or nobody is there.
    pub fn on_silence(&mut self, now: Instant, ticket: u64) {
        let Some(out) = self.take(ticket) else {
            return;
        };
        self.asked.remove(out.range.clone());
        // A late reply may have brought a part of it.
        let there: Vec<_> = self
            .held
            .iter()
            .filter(|held| held.start < out.range.end)
            .collect();
        there.into_iter().for_each(|held| self.asked.insert(held));
        let paused = |pause: Duration, tries| State::Pausing {
            until: now + pause,
            pause,
            tries,
        };
        match self.state {
            State::Pulling | State::Doubting if self.out.is_empty() => {
                self.window.on_cut();
                self.state = paused(FIRST_PAUSE, 0);
            }
            State::Pulling => self.state = State::Doubting,
            State::Trying { pause, tries } => {
                self.state = paused((pause * 2).min(LAST_PAUSE), tries + 1);
            }
            _ => {}
        }
    }

    /// The sender says that it can't.
    pub fn on_fault(&mut self, ticket: u64, fault: Fault) {
        if self.take(ticket).is_some() {
            self.end(fault);
        }
    }

    /// The sender offers it again: it is there, so that no pause is to be waited for.
    pub fn on_offered(&mut self, now: Instant) {
        if let State::Pausing { pause, tries, .. } = self.state {
            self.state = State::Pausing {
                until: now,
                pause: pause.min(FIRST_PAUSE),
                tries,
            };
        }
    }

    /// What the checksum of all came to: as offered, or not.
    pub fn on_checked(&mut self, right: bool) {
        if self.state != State::Checking {
            return;
        }
        if right {
            self.over(Ok(()));
        } else if std::mem::take(&mut self.resumed) {
            // What was there from before may have been damaged when the machine lost its power: all of it again, once.
            (self.held, self.asked) = (Ranges::default(), Ranges::default());
            self.out.clear();
            self.out_bytes = 0;
            self.state = State::Pulling;
        } else {
            self.end(Fault::Checksum);
        }
    }

    /// The program wants it no more, or something outside ends it.
    pub fn end(&mut self, fault: Fault) {
        if !matches!(self.state, State::Over(_)) {
            self.over(Err(fault));
        }
    }

    /// What is there.
    pub fn held(&self) -> &Ranges {
        &self.held
    }

    /// How much is there.
    pub fn progress(&self) -> Progress {
        Progress {
            held_bytes: self.held.bytes(),
            size_bytes: self.size_bytes,
        }
    }

    /// How many bytes are asked for and not there yet, nor given up.
    pub fn on_the_way_bytes(&self) -> u64 {
        self.out_bytes
    }

    /// How much is asked for at once.
    pub fn window(&self) -> &Window {
        &self.window
    }
}

#[cfg(test)]
mod tests;

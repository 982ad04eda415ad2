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
mod tests {
    use super::*;

    const SIZE: u64 = 10_000;
    const PATIENCE: Duration = Duration::from_secs(60);

    struct Bench {
        receiver: Receiver,
        now: Instant,
    }

    impl Bench {
        fn new(size: u64) -> Self {
            let now = Instant::now();
            let receiver = Receiver::new(now, size, Ranges::default(), PATIENCE);
            Self { receiver, now }
        }

        fn asks(&mut self) -> Vec<Ask> {
            let mut asks = Vec::new();
            while let Step::Ask(ask) = self.receiver.poll(self.now) {
                asks.push(ask);
            }
            asks
        }

        fn comes(&mut self, ask: &Ask) -> bool {
            let kept = self
                .receiver
                .on_reply(self.now, ask, ask.range.end - ask.range.start);
            if kept {
                self.receiver.on_kept(ask.range.clone());
            }
            kept
        }

        fn pass(&mut self, time: Duration) {
            self.now += time;
        }

        fn finish(&mut self) -> Step {
            loop {
                match self.receiver.poll(self.now) {
                    Step::Ask(ask) => drop(self.comes(&ask)),
                    Step::Wait(until) => self.now = until,
                    step => return step,
                }
            }
        }
    }

    fn state(name: &str) -> Bench {
        let mut bench = Bench::new(SIZE);
        let asks = match name {
            "checking" | "over" => Vec::new(),
            _ => bench.asks(),
        };
        match name {
            "pulling" => {}
            "doubting" => bench.receiver.on_silence(bench.now, asks[0].ticket),
            "pausing" | "trying" => {
                for ask in &asks {
                    bench.receiver.on_silence(bench.now, ask.ticket);
                }
                if name == "trying" {
                    bench.pass(FIRST_PAUSE);
                    assert_eq!(bench.asks().len(), 1, "one, to see");
                }
            }
            "checking" => assert_eq!(bench.finish(), Step::Check),
            "over" => bench.receiver.end(Fault::Stopped),
            _ => unreachable!("{name}"),
        }
        bench
    }

    fn name(state: &State) -> &'static str {
        match state {
            State::Pulling => "pulling",
            State::Doubting => "doubting",
            State::Pausing { .. } => "pausing",
            State::Trying { .. } => "trying",
            State::Checking => "checking",
            State::Over(Ok(())) => "done",
            State::Over(Err(_)) => "over",
        }
    }

    #[test]
    fn every_state_knows_every_event() {
        type Event = fn(&mut Bench);
        let events: [(&str, Event); 8] = [
            ("reply", |b| {
                let ticket = b.receiver.out.keys().last().copied().unwrap_or(0);
                let range = b
                    .receiver
                    .out
                    .get(&ticket)
                    .map_or(0..2048, |out| out.range.clone());
                let (request, timeout) = (Request::Ended, PATIENCE);
                b.comes(&Ask {
                    ticket,
                    range,
                    request,
                    timeout,
                });
            }),
            ("silence", |b| {
                let ticket = b.receiver.out.keys().last().copied().unwrap_or(0);
                b.receiver.on_silence(b.now, ticket);
            }),
            ("fault", |b| {
                let ticket = b.receiver.out.keys().last().copied().unwrap_or(0);
                b.receiver
                    .on_fault(ticket, Fault::Unreadable(String::new()));
            }),
            ("offered", |b| {
                b.receiver.on_offered(b.now);
                b.receiver.poll(b.now);
            }),
            ("right", |b| b.receiver.on_checked(true)),
            ("wrong", |b| b.receiver.on_checked(false)),
            ("not kept", |b| b.receiver.on_not_kept("full".into())),
            ("time", |b| {
                b.pass(Duration::from_secs(5));
                b.receiver.poll(b.now);
            }),
        ];
        let table = [
            (
                "pulling",
                [
                    "pulling", "doubting", "over", "pulling", "pulling", "pulling", "over",
                    "pausing",
                ],
            ),
            (
                "doubting",
                [
                    "pulling", "pausing", "over", "doubting", "doubting", "doubting", "over",
                    "pausing",
                ],
            ),
            (
                "pausing",
                [
                    "pulling", "pausing", "pausing", "trying", "pausing", "pausing", "over",
                    "trying",
                ],
            ),
            (
                "trying",
                [
                    "pulling", "pausing", "over", "trying", "trying", "trying", "over", "pausing",
                ],
            ),
            (
                "checking",
                [
                    "checking", "checking", "checking", "checking", "done", "over", "over",
                    "checking",
                ],
            ),
            ("over", ["over"; 8]),
        ];
        for (from, expected) in table {
            for ((event, happens), to) in events.iter().zip(expected) {
                let mut bench = state(from);
                assert_eq!(name(&bench.receiver.state), from);
                happens(&mut bench);
                assert_eq!(name(&bench.receiver.state), to, "{from}, {event}");
            }
        }
    }

    #[test]
    fn of_nothing_there_is_nothing_to_ask() {
        let mut bench = Bench::new(0);
        assert_eq!(bench.receiver.poll(bench.now), Step::Check);
        bench.receiver.on_checked(true);
        assert_eq!(bench.receiver.poll(bench.now), Step::Over(Ok(())));
    }

    #[test]
    fn all_of_it_is_asked_for_once_and_in_order() {
        let mut bench = Bench::new(SIZE);
        let mut next = 0;
        while bench.receiver.progress().fraction() < 1.0 {
            for ask in bench.asks() {
                assert_eq!(ask.range.start, next);
                next = ask.range.end;
                assert!(bench.comes(&ask));
                assert!(!bench.comes(&ask), "the same again is not kept");
            }
        }
        assert_eq!((next, bench.finish()), (SIZE, Step::Check));
    }

    #[test]
    fn a_reply_of_another_length_ends_it() {
        for bytes in [0, 1, 2047, 2049, u64::MAX] {
            let mut bench = Bench::new(SIZE);
            let ask = bench.asks().remove(0);
            assert!(!bench.receiver.on_reply(bench.now, &ask, bytes));
            let over = bench.receiver.poll(bench.now);
            assert!(
                matches!(over, Step::Over(Err(Fault::Protocol(_)))),
                "{over:?}"
            );
        }
    }

    #[test]
    fn a_late_reply_is_of_use() {
        let mut bench = Bench::new(SIZE);
        let asks = bench.asks();
        bench.pass(asks[0].timeout);
        assert!(bench.asks().is_empty(), "given up, and a pause");
        assert!(bench.comes(&asks[0]), "kept");
        assert_eq!(
            bench.asks()[0].range.start,
            asks[0].range.end,
            "and not asked for again"
        );
    }

    #[test]
    fn a_wrong_checksum_begins_anew_only_where_something_was_there_before() {
        let mut bench = Bench::new(SIZE);
        assert_eq!(bench.finish(), Step::Check);
        bench.receiver.on_checked(false);
        assert_eq!(bench.finish(), Step::Over(Err(Fault::Checksum)));

        let mut held = Ranges::default();
        held.insert(0..5000);
        let now = Instant::now();
        let receiver = Receiver::new(now, SIZE, held, PATIENCE);
        let mut bench = Bench { receiver, now };
        assert_eq!(bench.finish(), Step::Check);
        bench.receiver.on_checked(false);
        assert_eq!(bench.receiver.progress().held_bytes, 0, "all of it again");
        assert_eq!(bench.finish(), Step::Check);
        bench.receiver.on_checked(false);
        assert_eq!(bench.finish(), Step::Over(Err(Fault::Checksum)), "once");
    }

    #[test]
    fn nothing_for_too_long_ends_it_and_a_jump_of_the_clock_does_not() {
        let mut bench = Bench::new(SIZE);
        for ask in bench.asks() {
            bench.receiver.on_silence(bench.now, ask.ticket);
        }
        bench.pass(PATIENCE * 100);
        let ask = bench.asks().remove(0);
        bench.receiver.on_silence(bench.now, ask.ticket);
        assert!(!matches!(bench.receiver.poll(bench.now), Step::Over(_)));
        let end = loop {
            match bench.receiver.poll(bench.now) {
                Step::Ask(ask) => bench.receiver.on_silence(bench.now, ask.ticket),
                Step::Wait(until) => bench.now = until,
                step => break step,
            }
        };
        assert!(matches!(end, Step::Over(Err(Fault::Silence(_)))), "{end:?}");
    }

    #[test]
    fn an_offer_ends_the_pause() {
        let mut bench = state("pausing");
        assert!(bench.asks().is_empty());
        bench.receiver.on_offered(bench.now);
        assert_eq!(bench.asks().len(), 1);
    }

    #[test]
    fn a_clock_that_goes_back_costs_nothing() {
        let mut bench = Bench::new(100_000);
        bench.now += Duration::from_secs(100);
        let asks = bench.asks();
        bench.now -= Duration::from_secs(50);
        asks.iter().for_each(|ask| assert!(bench.comes(ask)));
        assert_eq!(bench.finish(), Step::Check);
    }
}

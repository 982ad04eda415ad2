//! Tests of the receiver.
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
                "pulling", "doubting", "over", "pulling", "pulling", "pulling", "over", "pausing",
            ],
        ),
        (
            "doubting",
            [
                "pulling", "pausing", "over", "doubting", "doubting", "doubting", "over", "pausing",
            ],
        ),
        (
            "pausing",
            [
                "pulling", "pausing", "pausing", "trying", "pausing", "pausing", "over", "trying",
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
                "checking", "checking", "checking", "checking", "done", "over", "over", "checking",
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

//! Tests of the receiver.
use super::*;

const SIZE: u64 = 10_000;
const TIMEOUT: Duration = Duration::from_secs(60);

struct Bench {
    receiver: Receiver,
    now: Instant,
}

impl Bench {
    fn new(size: u64) -> Self {
        let now = Instant::now();
        let receiver = Receiver::new(now, size, Ranges::default(), TIMEOUT);
        Self { receiver, now }
    }

    fn requests(&mut self) -> Vec<PieceRequest> {
        let mut requests = Vec::new();
        while let Step::Request(request) = self.receiver.poll(self.now) {
            requests.push(request);
        }
        requests
    }

    fn reply(&mut self, request: &PieceRequest) -> bool {
        let kept =
            self.receiver
                .on_reply(self.now, request, request.range.end - request.range.start);
        if kept {
            self.receiver.on_written(request.range.clone());
        }
        kept
    }

    fn pass(&mut self, time: Duration) {
        self.now += time;
    }

    fn finish(&mut self) -> Step {
        loop {
            match self.receiver.poll(self.now) {
                Step::Request(request) => drop(self.reply(&request)),
                Step::Wait(until) => self.now = until,
                step => return step,
            }
        }
    }
}

fn state(name: &str) -> Bench {
    let mut bench = Bench::new(SIZE);
    let requests = match name {
        "checking" | "failed" => Vec::new(),
        _ => bench.requests(),
    };
    match name {
        "requesting" => {}
        "suspecting" => bench.receiver.on_no_reply(bench.now, requests[0].id),
        "pausing" | "probing" => {
            for request in &requests {
                bench.receiver.on_no_reply(bench.now, request.id);
            }
            if name == "probing" {
                bench.pass(FIRST_PAUSE);
                assert_eq!(bench.requests().len(), 1, "a single one");
            }
        }
        "checking" => assert_eq!(bench.finish(), Step::Check),
        "failed" => bench.receiver.end(Fault::Stopped),
        _ => unreachable!("{name}"),
    }
    bench
}

fn name(state: &State) -> &'static str {
    match state {
        State::Requesting => "requesting",
        State::Suspecting => "suspecting",
        State::Pausing { .. } => "pausing",
        State::Probing { .. } => "probing",
        State::Checking => "checking",
        State::Finished(Ok(())) => "done",
        State::Finished(Err(_)) => "failed",
    }
}

#[test]
fn every_state_handles_every_event() {
    type Event = fn(&mut Bench);
    let events: [(&str, Event); 8] = [
        ("reply", |b| {
            let id = b.receiver.in_flight.keys().last().copied().unwrap_or(0);
            let range = b
                .receiver
                .in_flight
                .get(&id)
                .map_or(0..2048, |in_flight| in_flight.range.clone());
            let (request, timeout) = (Request::Ended, TIMEOUT);
            b.reply(&PieceRequest {
                id,
                range,
                request,
                timeout,
            });
        }),
        ("no reply", |b| {
            let id = b.receiver.in_flight.keys().last().copied().unwrap_or(0);
            b.receiver.on_no_reply(b.now, id);
        }),
        ("fault", |b| {
            let id = b.receiver.in_flight.keys().last().copied().unwrap_or(0);
            b.receiver.on_fault(id, Fault::Unreadable(String::new()));
        }),
        ("offered", |b| {
            b.receiver.on_offered(b.now);
            b.receiver.poll(b.now);
        }),
        ("checksum correct", |b| b.receiver.on_checked(true)),
        ("checksum wrong", |b| b.receiver.on_checked(false)),
        ("not stored", |b| b.receiver.on_write_failed("full".into())),
        ("time", |b| {
            b.pass(Duration::from_secs(5));
            b.receiver.poll(b.now);
        }),
    ];
    let table = [
        (
            "requesting",
            [
                "requesting",
                "suspecting",
                "failed",
                "requesting",
                "requesting",
                "requesting",
                "failed",
                "pausing",
            ],
        ),
        (
            "suspecting",
            [
                "requesting",
                "pausing",
                "failed",
                "suspecting",
                "suspecting",
                "suspecting",
                "failed",
                "pausing",
            ],
        ),
        (
            "pausing",
            [
                "requesting",
                "pausing",
                "pausing",
                "probing",
                "pausing",
                "pausing",
                "failed",
                "probing",
            ],
        ),
        (
            "probing",
            [
                "requesting",
                "pausing",
                "failed",
                "probing",
                "probing",
                "probing",
                "failed",
                "pausing",
            ],
        ),
        (
            "checking",
            [
                "checking", "checking", "checking", "checking", "done", "failed", "failed",
                "checking",
            ],
        ),
        ("failed", ["failed"; 8]),
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
fn an_empty_transfer_needs_no_requests() {
    let mut bench = Bench::new(0);
    assert_eq!(bench.receiver.poll(bench.now), Step::Check);
    bench.receiver.on_checked(true);
    assert_eq!(bench.receiver.poll(bench.now), Step::Finished(Ok(())));
}

#[test]
fn requests_everything_once_and_in_order() {
    let mut bench = Bench::new(SIZE);
    let mut next = 0;
    while bench.receiver.progress().fraction() < 1.0 {
        for request in bench.requests() {
            assert_eq!(request.range.start, next);
            next = request.range.end;
            assert!(bench.reply(&request));
            assert!(!bench.reply(&request), "duplicates are not stored");
        }
    }
    assert_eq!((next, bench.finish()), (SIZE, Step::Check));
}

#[test]
fn a_reply_of_another_length_is_a_fault() {
    for bytes in [0, 1, 2047, 2049, u64::MAX] {
        let mut bench = Bench::new(SIZE);
        let request = bench.requests().remove(0);
        assert!(!bench.receiver.on_reply(bench.now, &request, bytes));
        let step = bench.receiver.poll(bench.now);
        assert!(
            matches!(step, Step::Finished(Err(Fault::Protocol(_)))),
            "{step:?}"
        );
    }
}

#[test]
fn uses_late_replies() {
    let mut bench = Bench::new(SIZE);
    let requests = bench.requests();
    bench.pass(requests[0].timeout);
    assert!(bench.requests().is_empty(), "timed out, so it pauses");
    assert!(bench.reply(&requests[0]), "stored");
    assert_eq!(
        bench.requests()[0].range.start,
        requests[0].range.end,
        "not requested again"
    );
}

#[test]
fn a_wrong_checksum_restarts_only_resumed_transfers() {
    let mut bench = Bench::new(SIZE);
    assert_eq!(bench.finish(), Step::Check);
    bench.receiver.on_checked(false);
    assert_eq!(bench.finish(), Step::Finished(Err(Fault::Checksum)));

    let mut held = Ranges::default();
    held.insert(0..5000);
    let now = Instant::now();
    let receiver = Receiver::new(now, SIZE, held, TIMEOUT);
    let mut bench = Bench { receiver, now };
    assert_eq!(bench.finish(), Step::Check);
    bench.receiver.on_checked(false);
    assert_eq!(
        bench.receiver.progress().received_bytes,
        0,
        "everything is requested again"
    );
    assert_eq!(bench.finish(), Step::Check);
    bench.receiver.on_checked(false);
    assert_eq!(
        bench.finish(),
        Step::Finished(Err(Fault::Checksum)),
        "only once"
    );
}

#[test]
fn times_out_but_not_because_of_a_jump_of_the_clock() {
    let mut bench = Bench::new(SIZE);
    for request in bench.requests() {
        bench.receiver.on_no_reply(bench.now, request.id);
    }
    bench.pass(TIMEOUT * 100);
    let request = bench.requests().remove(0);
    bench.receiver.on_no_reply(bench.now, request.id);
    assert!(!matches!(bench.receiver.poll(bench.now), Step::Finished(_)));
    let end = loop {
        match bench.receiver.poll(bench.now) {
            Step::Request(request) => bench.receiver.on_no_reply(bench.now, request.id),
            Step::Wait(until) => bench.now = until,
            step => break step,
        }
    };
    assert!(
        matches!(end, Step::Finished(Err(Fault::TimedOut(_)))),
        "{end:?}"
    );
}

#[test]
fn an_offer_ends_the_pause() {
    let mut bench = state("pausing");
    assert!(bench.requests().is_empty());
    bench.receiver.on_offered(bench.now);
    assert_eq!(bench.requests().len(), 1);
}

#[test]
fn tolerates_a_clock_that_goes_back() {
    let mut bench = Bench::new(100_000);
    bench.now += Duration::from_secs(100);
    let requests = bench.requests();
    bench.now -= Duration::from_secs(50);
    requests
        .iter()
        .for_each(|request| assert!(bench.reply(request)));
    assert_eq!(bench.finish(), Step::Check);
}

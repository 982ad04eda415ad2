//! Tests programs, a router and readers together, in virtual time.
use std::time::{Duration, Instant};

use proptest::prelude::*;

use super::{
    batch::Batch,
    keeper::LogKeeper,
    level::Level,
    line::Line,
    outbox::Outbox,
    page::{Kept, Page, Question},
    reader::{Item, LogReader, Reading},
    MAX_BYTES, MAX_LINES,
};
use crate::{
    driver::{Action, Answer, Declaration, Driver, Event, Id, QueryId, Sample, Step},
    message::{encoding::Encoding, payload::Payload},
    name::{key::KeySpace, Name},
};

const TOGETHER: Duration = Duration::from_millis(20);

fn name(text: &str) -> Name {
    Name::new(text).expect("a name")
}

fn place(robot: &str) -> KeySpace {
    KeySpace {
        fleet: name("rect"),
        robot: name(robot),
    }
}

fn sample(key: &str, payload: Payload) -> Sample {
    Sample {
        key: key.to_owned(),
        payload,
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    }
}

/// The router of a robot, and one reader that may be out of reach.
struct World {
    now: Instant,
    keeper: LogKeeper,
    reader: LogReader,
    /// The publisher of the keeper that the reader follows.
    followed: Vec<(Id, String)>,
    follows: bool,
    is_linked: bool,
    queries: u64,
    /// The size of all publications, in bytes.
    published: usize,
    items: Vec<Item>,
    is_finished: bool,
}

impl World {
    fn new(reading: Reading) -> Self {
        Self {
            now: Instant::now(),
            keeper: LogKeeper::new(place("wombat-1"), 7),
            follows: reading.follow,
            reader: LogReader::new(place("laptop"), reading),
            followed: Vec::new(),
            is_linked: true,
            queries: 0,
            published: 0,
            items: Vec::new(),
            is_finished: false,
        }
    }

    /// Performs the actions of an outbox, and loses its messages if `is_lost`.
    fn send(&mut self, outbox: &mut Outbox, is_lost: bool) {
        self.now += TOGETHER;
        while let Step::Act(action) = outbox.poll(self.now) {
            match action {
                Action::Put { payload, .. } if !is_lost => {
                    let key = "rect/wombat-1/@rect/@set/log/arm";
                    let sample = sample(key, payload);
                    let _ = self
                        .keeper
                        .on_event(self.now, Event::Sample { id: Id(0), sample });
                    if self.follows {
                        self.run();
                    }
                }
                _ => {}
            }
        }
    }

    /// Performs the actions of the router and the reader until both wait.
    fn run(&mut self) {
        loop {
            match self.keeper.poll(self.now) {
                Step::Act(Action::PutOnce { key, payload, .. }) if self.is_linked => {
                    self.published += payload.bytes.len();
                    let sample = sample(&key, payload);
                    self.deliver(Event::Sample { id: Id(0), sample });
                }
                Step::Act(Action::Declare { id, declaration }) => {
                    if let Declaration::Publisher { key, .. } = declaration {
                        self.followed.push((id, key));
                    }
                }
                Step::Act(_) => {}
                _ => match self.reader.poll(self.now) {
                    Step::Act(Action::Get { id, get }) => self.ask(id, get.payload),
                    Step::Act(Action::Declare { declaration, .. }) => {
                        let Declaration::Subscriber { key } = declaration else {
                            continue;
                        };
                        let key = key
                            .replace("/*/@rect", "/wombat-1/@rect")
                            .replace("/arm", "/*");
                        let (id, _) = self
                            .followed
                            .iter()
                            .find(|(_, one)| *one == key)
                            .expect("one");
                        let id = *id;
                        let _ = self
                            .keeper
                            .on_event(self.now, Event::Matching { id, matching: true });
                    }
                    Step::Deliver(item) => self.items.push(item),
                    Step::Finished(()) => {
                        self.is_finished = true;
                        return;
                    }
                    _ => return,
                },
            }
        }
    }

    fn ask(&mut self, id: Id, payload: Option<Payload>) {
        if self.is_linked {
            let query = QueryId(self.queries);
            self.queries += 1;
            let event = Event::Query {
                id: Id(1),
                query,
                key: String::new(),
                payload: payload.expect("a question"),
                attachment: None,
            };
            let _ = self.keeper.on_event(self.now, event);
            while let Step::Act(action) = self.keeper.poll(self.now) {
                if let Action::Answer {
                    answer: Answer::Reply { key, payload },
                    ..
                } = action
                {
                    let reply = Ok(sample(&key, payload));
                    self.deliver(Event::Reply { id, reply });
                }
            }
        }
        self.deliver(Event::Ended { id });
    }

    fn deliver(&mut self, event: Event) {
        let reaction = self.reader.on_event(self.now, event);
        self.items.extend(reaction.items);
    }

    /// Returns the texts in the order in which a person reads them.
    fn texts(&self) -> Vec<String> {
        let mut all: Vec<&Kept> = Vec::new();
        for item in &self.items {
            if let Item::Lines { lines, is_new, .. } = item {
                match is_new {
                    true => all.extend(lines),
                    false => {
                        all.splice(0..0, lines);
                    }
                }
            }
        }
        let texts = all.into_iter().map(|kept| kept.line.text.clone());
        texts.collect()
    }
}

fn outbox() -> Outbox {
    let mut outbox = Outbox::new(&place("wombat-1"), Some(&name("arm")), 3);
    set_received(&mut outbox, true);
    outbox
}

fn set_received(outbox: &mut Outbox, matching: bool) {
    let id = Id(0);
    let _ = outbox.on_event(Instant::now(), Event::Matching { id, matching });
}

fn log(outbox: &mut Outbox, world: &World, text: &str) {
    outbox.log(Line::new(0, Level::Info, text), false, world.now);
}

fn follow() -> Reading {
    Reading {
        follow: true,
        last: 5,
        ..Reading::default()
    }
}

#[test]
fn a_reader_gets_the_last_lines_newest_first_and_the_router_keeps_a_thousand() {
    let mut world = World::new(Reading {
        last: 900,
        ..Reading::default()
    });
    let mut outbox = outbox();
    for number in 0..1500 {
        log(&mut outbox, &world, &format!("{number} {}", "-".repeat(90)));
    }
    world.send(&mut outbox, false);
    world.run();
    assert!(world.is_finished);
    let texts = world.texts();
    assert_eq!(texts.len(), 900);
    assert!(texts[0].starts_with("600 ") && texts[899].starts_with("1499 "));
    let first = world.items.first().expect("an item");
    let Item::Lines { lines, .. } = first else {
        panic!("{first:?}");
    };
    assert!(lines.last().expect("a line").line.text.starts_with("1499 "));
    assert!(world.queries > 1, "there are several pages");
}

#[test]
fn limits_hold_for_lines_bytes_and_programs() {
    let mut keeper = LogKeeper::new(place("wombat-1"), 7);
    for program in 0..60 {
        let line = Line::new(0, Level::Info, "x".repeat(4000));
        let batch = Batch {
            run: program,
            first: 0,
            private: false,
            lines: vec![line; 30],
        };
        let key = format!("rect/wombat-1/@rect/@set/log/p{program}");
        let sample = sample(&key, batch.write());
        let _ = keeper.on_event(Instant::now(), Event::Sample { id: Id(0), sample });
    }
    let kept = keeper.everything();
    let bytes: usize = kept.iter().map(|kept| kept.line.size()).sum();
    assert!(bytes <= MAX_BYTES, "{bytes}");
    assert!(bytes > MAX_BYTES - 10_000, "{bytes}");
    let mut of_one = outbox();
    let mut world = World::new(Reading::default());
    for number in 0..MAX_LINES + 10 {
        log(&mut of_one, &world, &number.to_string());
    }
    world.send(&mut of_one, false);
    assert_eq!(world.keeper.everything().len(), MAX_LINES);
}

#[test]
fn a_loud_program_does_not_displace_the_lines_of_a_quiet_one() {
    let mut keeper = LogKeeper::new(place("wombat-1"), 7);
    let mut give = |program: &str, first: u64, lines: Vec<Line>| {
        let batch = Batch {
            run: 1,
            first,
            private: false,
            lines,
        };
        let key = format!("rect/wombat-1/@rect/@set/log/{program}");
        let sample = sample(&key, batch.write());
        let _ = keeper.on_event(Instant::now(), Event::Sample { id: Id(0), sample });
    };
    give("crash", 0, vec![Line::new(0, Level::Error, "Traceback")]);
    for first in 0..2000 {
        give(
            "loud",
            first,
            vec![Line::new(0, Level::Info, "x".repeat(8000))],
        );
    }
    let kept = keeper.everything();
    assert!(kept.iter().any(|kept| kept.line.text == "Traceback"));
}

#[test]
fn lost_lines_are_counted_by_the_router() {
    let mut world = World::new(Reading::default());
    let mut outbox = outbox();
    log(&mut outbox, &world, "first");
    world.send(&mut outbox, false);
    for _ in 0..3 {
        log(&mut outbox, &world, "lost");
    }
    world.send(&mut outbox, true);
    log(&mut outbox, &world, "last");
    world.send(&mut outbox, false);
    world.run();
    let texts = world.texts();
    assert_eq!(texts.len(), 3, "{texts:?}");
    assert!(texts[1].starts_with("3 lines were lost"), "{texts:?}");
}

#[test]
fn lines_wait_for_a_router_that_has_just_started() {
    let mut world = World::new(Reading::default());
    let mut outbox = outbox();
    set_received(&mut outbox, false);
    log(&mut outbox, &world, "early");
    world.send(&mut outbox, false);
    assert!(!outbox.is_empty() && world.keeper.everything().is_empty());
    set_received(&mut outbox, true);
    world.send(&mut outbox, false);
    assert_eq!(world.keeper.everything().len(), 1);
}

#[test]
fn a_program_that_logs_too_fast_loses_the_oldest_lines() {
    let mut world = World::new(Reading::default());
    let mut outbox = outbox();
    for number in 0..100_000 {
        log(&mut outbox, &world, &number.to_string());
    }
    assert!(outbox.lost() > 0);
    world.send(&mut outbox, false);
    assert!(outbox.is_empty());
    world.run();
    let texts = world.texts();
    assert_eq!(texts.last().map(String::as_str), Some("99999"));
}

#[test]
fn levels_and_programs_are_selected_by_the_router() {
    let mut world = World::new(Reading {
        level: Level::Warn,
        program: Some(name("arm")),
        follow: true,
        ..Reading::default()
    });
    world.run();
    let mut outbox = outbox();
    for level in Level::ALL {
        outbox.log(Line::new(0, level, level.as_str()), false, world.now);
    }
    world.send(&mut outbox, false);
    assert_eq!(world.texts(), ["warn", "error"]);
}

#[test]
fn private_lines_are_not_read_from_another_robot() {
    let mut world = World::new(follow());
    world.run();
    let mut outbox = outbox();
    outbox.log(Line::new(0, Level::Info, "open"), false, world.now);
    outbox.log(Line::new(0, Level::Info, "private"), true, world.now);
    outbox.log(Line::new(0, Level::Info, "open again"), false, world.now);
    world.send(&mut outbox, false);
    assert_eq!(world.texts(), ["open", "open again"]);
    assert_eq!(world.keeper.everything().len(), 3);
}

#[test]
fn lines_that_were_published_during_a_cut_are_asked_for() {
    let mut world = World::new(follow());
    world.run();
    let mut outbox = outbox();
    for text in ["one", "two", "three", "four"] {
        world.is_linked = !matches!(text, "two" | "three");
        log(&mut outbox, &world, text);
        world.send(&mut outbox, false);
    }
    assert_eq!(world.texts(), ["one", "two", "three", "four"]);
}

#[test]
fn lines_of_a_cut_are_asked_for_when_the_robot_returns() {
    let mut world = World::new(follow());
    world.run();
    let mut outbox = outbox();
    let token = |is_deleted| Event::Sample {
        id: Id(1),
        sample: Sample {
            is_deleted,
            ..sample(
                "rect/wombat-1/@rect/alive/1",
                Payload::new("", Encoding::BYTES),
            )
        },
    };
    world.deliver(token(false));
    log(&mut outbox, &world, "one");
    world.send(&mut outbox, false);
    world.is_linked = false;
    world.deliver(token(true));
    log(&mut outbox, &world, "two");
    world.send(&mut outbox, false);
    world.is_linked = true;
    world.deliver(token(false));
    world.run();
    assert_eq!(world.texts(), ["one", "two"]);
}

#[test]
fn a_robot_that_comes_later_is_asked_for_its_last_lines() {
    let mut world = World::new(follow());
    world.is_linked = false;
    world.run();
    let mut outbox = outbox();
    log(&mut outbox, &world, "one");
    world.send(&mut outbox, false);
    assert!(world.texts().is_empty());
    world.is_linked = true;
    let appeared = sample(
        "rect/wombat-1/@rect/alive/1",
        Payload::new("", Encoding::BYTES),
    );
    world.deliver(Event::Sample {
        id: Id(1),
        sample: appeared,
    });
    world.run();
    assert_eq!(world.texts(), ["one"]);
}

#[test]
fn a_flood_is_followed_at_a_limited_rate_up_to_its_last_line() {
    let mut world = World::new(follow());
    world.run();
    let mut outbox = outbox();
    // 10 s with 5,000 lines a second.
    for number in 0..500 {
        for line in 0..100_u64 {
            let noise = (number * 100 + line).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            log(&mut outbox, &world, &format!("{number} {noise:x}"));
        }
        world.send(&mut outbox, false);
    }
    log(&mut outbox, &world, "last");
    world.send(&mut outbox, false);
    world.now += Duration::from_secs(2);
    world.run();
    assert!(world.published < 120_000, "{}", world.published);
    assert!(world.items.contains(&Item::Missed(name("wombat-1"))));
    assert_eq!(world.texts().last().map(String::as_str), Some("last"));
}

#[test]
fn a_router_that_restarts_begins_anew() {
    let mut world = World::new(follow());
    world.run();
    let mut outbox = outbox();
    log(&mut outbox, &world, "one");
    world.send(&mut outbox, false);
    world.keeper = LogKeeper::new(place("wombat-1"), 8);
    world.followed.clear();
    world.run();
    for (id, _) in world.followed.clone() {
        let matching = true;
        let _ = world
            .keeper
            .on_event(world.now, Event::Matching { id, matching });
    }
    log(&mut outbox, &world, "two");
    world.send(&mut outbox, false);
    assert_eq!(world.texts(), ["one", "two"]);
}

#[test]
fn hostile_pages_and_batches_are_bounded() {
    assert!(Batch::read(&vec![b' '; 2 << 20]).is_err());
    assert!(Question::read(b"{\"last\": -1}").is_err());
    assert!(Question::read(b"{\"lst\": 1}").is_err());
    // A gigabyte of spaces.
    let bomb = zstd::bulk::compress(&vec![b' '; 64 << 20], 3).expect("compressed");
    assert!(Page::read(&bomb).is_err());
    let mut reader = LogReader::new(place("laptop"), Reading::default());
    let now = Instant::now();
    let Step::Act(Action::Get { mut id, .. }) = reader.poll(now) else {
        panic!("it asks");
    };
    // A router that always has the same line, and always more.
    let kept = Kept {
        number: 5,
        program: "../../x".to_owned(),
        line: Line::new(0, Level::Info, "\x1b[2J endless"),
    };
    let page = Page {
        run: 1,
        at: 5,
        more: true,
        lines: vec![kept],
    };
    let mut delivered = Vec::new();
    for _ in 0..10 {
        let reply = Ok(sample("rect/wombat-1/@rect/@log", page.write()));
        delivered.extend(reader.on_event(now, Event::Reply { id, reply }).items);
        let _ = reader.on_event(now, Event::Ended { id });
        match reader.poll(now) {
            Step::Act(Action::Get { id: next, .. }) => id = next,
            step => {
                assert_eq!(step, Step::Deliver(Item::Complete));
                assert_eq!(reader.poll(now), Step::Finished(()));
                break;
            }
        }
    }
    let [Item::Lines { lines, .. }] = &delivered[..] else {
        panic!("{delivered:?}");
    };
    assert_eq!(lines[0].line.text, " endless");
    assert_eq!(lines[0].program, "unnamed");
}

proptest! {
    /// Whatever arrives, and whenever the link is cut: each line is delivered at most once, in order, and the last ones are complete
    /// as soon as the link carries another line.
    #[test]
    fn a_reader_gets_each_line_once_and_in_order(steps in prop::collection::vec((0..4u8, any::<bool>()), 1..60)) {
        let mut world = World::new(follow());
        world.run();
        let mut outbox = outbox();
        let mut number = 0;
        for (lines, is_linked) in steps {
            world.is_linked = is_linked;
            for _ in 0..lines {
                number += 1;
                log(&mut outbox, &world, &number.to_string());
            }
            world.send(&mut outbox, false);
        }
        // A question that was lost in a cut is repeated by the next gap.
        world.is_linked = true;
        for _ in 0..2 {
            number += 1;
            log(&mut outbox, &world, &number.to_string());
            world.send(&mut outbox, false);
        }
        let texts: Vec<u64> = world.texts().iter().map(|text| text.parse().expect("a number")).collect();
        prop_assert!(texts.is_sorted_by(|a, b| a < b), "{texts:?}");
        prop_assert_eq!(texts.last().copied(), Some(number));
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = Batch::read(&bytes);
        let _ = Question::read(&bytes);
        let _ = Page::read(&bytes);
        let text = String::from_utf8_lossy(&bytes);
        let line = Line::new(0, Level::Info, text).clean();
        prop_assert!(!line.text.chars().any(|c| c.is_control() && c != '\n' && c != '\t'));
        let _ = Payload::new(bytes, Encoding::JSON);
    }
}

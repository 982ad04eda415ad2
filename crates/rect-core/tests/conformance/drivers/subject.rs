//! The driver of a scenario, and the calls of its steps.
use std::time::{Duration, Instant};

use rect_core::{
    catalogue::Instance,
    codec::CodecError,
    driver::{Driver, Event, Id, QueryId, Sample},
    message::{encoding::Encoding, urgency::Urgency},
    name::{key::KeySpace, topic::Pattern, Name},
    registry::{
        observer::{Observer, RouterObserver},
        RegistryQuery,
    },
    session::{
        decoder::Decoder,
        peers::{DirectPresence, EstablishedWait, PeerWait, PeersQuery},
        recipients::{Reachability, Recipients},
    },
    state::{keeper::StateKeeper, latest::Latest},
    storage::{Files, Source, Store},
    stream::{
        options::{PartialOptions, Preset},
        publish::StreamPublish,
        watch::StreamWatch,
    },
    transfer::{
        admission::AdmissionRules, files::UsesFiles, offer::FileName, pull::TransferPull,
        push::TransferPush, reception::TransferReception, Checksum, Offer,
    },
};
use serde_json::{json, Value};

use super::{
    arguments::{self, name, number, run, text, topic},
    content,
    describe::{self, Describe},
    nothing,
    program::{self, Program},
};

/// The robot whose program each scenario is about.
const ME: &str = "wombat-1";

/// The driver under test, and the time that it sees.
pub struct Subject {
    driver: Box<dyn Described>,
    start: Instant,
    now: Instant,
}

/// A driver of any type.
trait Described {
    fn on_event(&mut self, now: Instant, event: Event) -> Value;
    fn poll(&mut self, now: Instant) -> Value;
    /// Performs a call that only this driver has.
    fn call(&mut self, now: Instant, name: &str, arguments: &[Value]) -> Value;
}

/// A driver with the calls that only it has.
struct With<D, F>(D, F);

impl<D, F> Described for With<D, F>
where
    D: Driver,
    D::Item: Describe,
    D::Output: Describe,
    F: FnMut(&mut D, Instant, &str, &[Value]) -> Value,
{
    fn on_event(&mut self, now: Instant, event: Event) -> Value {
        describe::reaction(self.0.on_event(now, event))
    }

    fn poll(&mut self, now: Instant) -> Value {
        describe::step(self.0.poll(now), now)
    }

    fn call(&mut self, now: Instant, name: &str, arguments: &[Value]) -> Value {
        (self.1)(&mut self.0, now, name, arguments)
    }
}

fn plain<D>(driver: D) -> Box<dyn Described>
where
    D: Driver + 'static,
    D::Item: Describe,
    D::Output: Describe,
{
    Box::new(With(
        driver,
        |_: &mut D, _: Instant, name: &str, _: &[Value]| panic!("no call {name}"),
    ))
}

impl Subject {
    pub fn new(driver: &Value) -> Self {
        let start = Instant::now();
        Self {
            driver: make(driver, start),
            start,
            now: start,
        }
    }

    pub fn call(&mut self, call: &[Value]) -> Value {
        let (name, arguments) = call.split_first().expect("a name");
        let (name, now) = (name.as_str().expect("a name"), self.now);
        let event = |event| event;
        let event = match (name, arguments) {
            ("set_time", [seconds]) => {
                self.now = self.start + Duration::from_secs_f64(seconds.as_f64().expect("seconds"));
                return nothing();
            }
            ("poll", []) => return self.driver.poll(now),
            ("poll_all", []) => {
                let mut steps = Vec::new();
                loop {
                    let step = self.driver.poll(now);
                    let is_last = step[0] == "wait" || step[0] == "finished";
                    steps.push(step);
                    assert!(steps.len() < 100, "{steps:?}");
                    if is_last {
                        return json!(steps);
                    }
                }
            }
            ("on_sample", [id, key, payload, encoding, rest @ ..]) => event(Event::Sample {
                id: Id(number(id)),
                sample: Sample {
                    attachment: rest
                        .first()
                        .filter(|one| !one.is_null())
                        .map(content::parse),
                    is_deleted: rest.get(1).is_some_and(|one| one == true),
                    ..sample(key, payload, encoding)
                },
            }),
            ("on_reply", [id, key, payload, encoding]) => Event::Reply {
                id: Id(number(id)),
                reply: Ok(sample(key, payload, encoding)),
            },
            ("on_error", [id, payload, encoding]) => Event::Reply {
                id: Id(number(id)),
                reply: Err(arguments::payload(payload, encoding)),
            },
            ("on_ended", [id]) => Event::Ended { id: Id(number(id)) },
            ("on_query", [id, query, payload, encoding, rest @ ..]) => Event::Query {
                id: Id(number(id)),
                query: QueryId(number(query)),
                key: rest.first().map(text).unwrap_or_default().to_owned(),
                payload: arguments::payload(payload, encoding),
                attachment: None,
            },
            ("on_matching", [id, matching]) => Event::Matching {
                id: Id(number(id)),
                matching: *matching == true,
            },
            ("on_link", [up, locator]) => {
                let (method, address) = text(locator).split_once('/').expect("a locator");
                Event::Link {
                    up: *up == true,
                    method: method.to_owned(),
                    address: address.to_owned(),
                }
            }
            ("on_closed", []) => Event::Closed,
            _ => return self.driver.call(now, name, arguments),
        };
        self.driver.on_event(now, event)
    }
}

fn make(driver: &Value, now: Instant) -> Box<dyn Described> {
    let of = |key: &str| text(&driver[key]);
    let place = KeySpace {
        fleet: name("rect"),
        robot: name(ME),
    };
    let timeout = Duration::from_secs_f64(driver["timeout_s"].as_f64().unwrap_or_default());
    match of("kind") {
        "peers_query" => plain(PeersQuery::new(place)),
        "recipients" => Box::new(With(
            Recipients::new(place),
            |core: &mut Recipients, now: Instant, call: &str, arguments: &[Value]| {
                assert_eq!(call, "find");
                match core.find(&name(text(&arguments[0])), now) {
                    Reachability::Reachable => json!(["reachable", []]),
                    Reachability::Unreachable(others) => {
                        json!(["unreachable", others.describe()])
                    }
                    Reachability::Unsure => json!(["unsure", []]),
                }
            },
        )),
        "peer_wait" => plain(PeerWait::new(&place, &name(of("robot")), now, timeout)),
        "established_wait" => plain(EstablishedWait::new(&place, now, timeout)),
        "direct_presence" => {
            let unix_ms = number(&driver["unix_ms"]);
            plain(DirectPresence::new(&place, of("id"), unix_ms, now))
        }
        "registry_query" => plain(RegistryQuery::new(
            place,
            name(of("robot")),
            of("question"),
            of("filter"),
        )),
        "registry_change" => plain(RegistryQuery::change(
            place,
            name(of("robot")),
            of("action"),
            of("argument").to_owned(),
        )),
        "observer" => plain(Observer::new(
            place,
            Instance(0),
            driver["is_direct"] == true,
        )),
        "router_observer" => plain(RouterObserver::new(&place)),
        "dictionary_fetch" => {
            let error = CodecError::Dictionary {
                id: number(&driver["id"]) as u32,
            };
            let fetch = Decoder::new(place).fetch(now, &name(of("sender")), &error);
            plain(fetch.expect("not asked before"))
        }
        "stream_watch" => {
            let id = number(&driver["id"]) as u16;
            plain(StreamWatch::new(
                &place,
                name(of("robot")),
                topic(of("topic")),
                id,
                now,
            ))
        }
        "stream_publish" => stream_publish(driver, &place, now),
        "state_keeper" => plain(StateKeeper::of_program(place, run(driver), now)),
        "program_state" => {
            let program = Program::new(place, run(driver), now);
            Box::new(With(program, Program::call))
        }
        "retain" => plain(program::retain(&place, driver, now)),
        "latest" => plain(Latest::new(
            place,
            name(of("robot")),
            topic(of("topic")),
            timeout,
        )),
        "transfer_push" => transfer_push(driver, &place, now),
        "transfer_pull" => transfer_pull(driver, &place, now, timeout),
        "transfer_reception" => {
            let rules = AdmissionRules {
                pattern: Pattern::new(of("pattern")).expect("a pattern"),
                max_bytes: number(&driver["max_bytes"]),
                max_concurrent: 2,
            };
            let driver = TransferReception::new(place, rules);
            Box::new(With(
                driver,
                |driver: &mut TransferReception, _: Instant, name: &str, _: &[Value]| {
                    assert_eq!(name, "stop");
                    driver.stop();
                    nothing()
                },
            ))
        }
        kind => panic!("no driver {kind}"),
    }
}

fn stream_publish(driver: &Value, place: &KeySpace, now: Instant) -> Box<dyn Described> {
    let preset: Preset = text(&driver["mode"]).parse().expect("a mode");
    let options = PartialOptions {
        preset,
        ..PartialOptions::default()
    };
    let publish = StreamPublish::new(
        place,
        &topic(text(&driver["topic"])),
        options.complete().expect("valid options"),
        Urgency::Normal,
        number(&driver["source"]) as u16,
        number(&driver["unix_ms"]),
        now,
    );
    let calls = |driver: &mut StreamPublish, now: Instant, name: &str, arguments: &[Value]| {
        let ("send", [payload, encoding]) = (name, arguments) else {
            panic!("no call {name}");
        };
        let payload = arguments::payload(payload, encoding);
        let jobs = driver.offer(payload.bytes.len(), now);
        let frames = jobs
            .into_iter()
            .map(|job| driver.frame(job, payload.clone(), now));
        json!(frames.map(describe::act).collect::<Vec<_>>())
    };
    Box::new(With(publish, calls))
}

fn transfer_push(driver: &Value, place: &KeySpace, now: Instant) -> Box<dyn Described> {
    let mut source = Source::of_bytes(content::parse(&driver["bytes"]));
    let offer = offer(
        driver,
        &place.robot,
        &source.checksum(),
        source.size_bytes(),
    );
    let timeout = driver["timeout_s"].as_f64().map(Duration::from_secs_f64);
    let push = TransferPush::new(place, name(text(&driver["recipient"])), offer, timeout, now);
    let calls = move |driver: &mut TransferPush, now: Instant, name: &str, _: &[Value]| {
        match name {
            "stop" => driver.stop(),
            "perform_files" => {
                while let Some(action) = driver.poll_file() {
                    let event = source.perform(action);
                    driver.on_file(now, event);
                }
            }
            _ => panic!("no call {name}"),
        }
        nothing()
    };
    Box::new(With(push, calls))
}

fn transfer_pull(
    driver: &Value,
    place: &KeySpace,
    now: Instant,
    timeout: Duration,
) -> Box<dyn Described> {
    let content = content::parse(&driver["bytes"]);
    let sender = name(text(&driver["sender"]));
    let offer = offer(
        driver,
        &sender,
        &Checksum::of(&content),
        content.len() as u64,
    );
    let mut store = Store::in_memory(offer.size_bytes).expect("memory");
    let id = offer.id(&place.robot);
    let pull = TransferPull::new(place, id, &offer, Default::default(), timeout, now);
    let calls = move |driver: &mut TransferPull, now: Instant, name: &str, _: &[Value]| {
        match name {
            "stop" => driver.stop(),
            "on_offered" => driver.on_offered(now),
            "perform_files" => {
                while let Some(action) = driver.poll_file() {
                    let event = store.perform(action);
                    driver.on_file(now, event);
                }
            }
            _ => panic!("no call {name}"),
        }
        nothing()
    };
    Box::new(With(pull, calls))
}

fn offer(driver: &Value, sender: &Name, checksum: &Checksum, size_bytes: u64) -> Offer {
    Offer {
        sender: sender.clone(),
        topic: topic(text(&driver["topic"])),
        name: FileName::new(text(&driver["name"])).expect("a file name"),
        encoding: Encoding::BYTES,
        size_bytes,
        checksum: *checksum,
        call: number(&driver["call"]),
    }
}

fn sample(key: &Value, payload: &Value, encoding: &Value) -> Sample {
    Sample {
        key: text(key).to_owned(),
        payload: arguments::payload(payload, encoding),
        attachment: None,
        is_deleted: false,
        priority: Sample::PRIORITY,
    }
}

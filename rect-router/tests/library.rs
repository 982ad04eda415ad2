//! Programs of the library `rect` at two robots' routers, linked by the simulated air.
//! `cargo test -p rect-router --test library`
mod support;

use std::time::{Duration, Instant};

use rect::{blocking::Robot, ConnectionState, Event, Json, NamedConnection, Options, Urgency};
use serde_json::json;
use support::{ble, file, Air, Wombat, DEADLINE};
use zenoh_link::ble::radio::sim::{control, Control};

/// A program at that robot's router.
fn program(wombat: &Wombat, name: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    Robot::join(options.router(&wombat.endpoint)).expect("joined")
}

fn two(air: &Air, folder: &tempfile::TempDir) -> [Wombat; 2] {
    let nobody = file(&[]);
    let first = Wombat::start(air, folder, 1, &nobody);
    let other = Wombat::start(air, folder, 2, &file(&[ble("radio", "wombat-1")]));
    [first, other]
}

/// One at each.
fn programs([first, other]: &[Wombat; 2]) -> [Robot; 2] {
    [program(first, "wombat-1"), program(other, "wombat-2")]
}

fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + DEADLINE;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn programs_of_two_robots_talk_over_ble_and_are_told_so() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let wombats = two(&air, &folder);
    let [one, two] = programs(&wombats);
    let mut events = two.events().expect("told");
    let link = events.find(|event| matches!(event, Event::LinkUp(link) if link.method == "ble"));
    assert!(link.is_some());
    until("both know of each other", || {
        one.peers().expect("asked") == ["wombat-2"] && two.peers().expect("asked") == ["wombat-1"]
    });
    let mut heard = two.subscribe("wombat-1/arm/*").expect("subscribed");
    let mut over = None;
    until("a message comes by radio", || {
        one.publish("arm/angle", Json(12.5)).expect("said");
        let message = heard.next_within(Duration::from_millis(100));
        over = over.take().or(message.and_then(|message| message.over));
        over.is_some()
    });
    assert_eq!(over.as_deref(), Some("ble"));
    let radio = two.connections().expect("the registry answers");
    let radio = radio
        .iter()
        .find(|one| one.name.as_deref() == Some("radio"));
    assert_eq!(radio.expect("the one of the file").method, "ble");

    let _service = one
        .serve("battery", |_| Ok::<_, String>(json!({"volt": 7.2})))
        .expect("served");
    let mut answer = None;
    until("the service is known", || {
        answer = two.request("wombat-1", "battery", "", DEADLINE).ok();
        answer.is_some()
    });
    let volt: serde_json::Value = answer.expect("one").payload.value().expect("JSON");
    assert_eq!(volt["volt"], 7.2);
}

#[test]
fn a_program_gives_its_router_a_connection_and_takes_it_back() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let nobody = file(&[]);
    let [one, two] = [1, 2].map(|number| Wombat::start(&air, &folder, number, &nobody));
    let program = program(&two, "wombat-2");
    let radio = NamedConnection::new("radio", "ble", "wombat-1");
    program.add_connection(&radio).expect("added");
    program.add_connection(&radio).expect("as it is");
    let is_there = || {
        let all = program.connections().expect("asked");
        let named = all.iter().find(|one| one.name.as_deref() == Some("radio"));
        named.is_some_and(|one| one.state == ConnectionState::Connected)
    };
    until("it is linked", is_there);
    program.remove_connection("radio").expect("removed");
    until("it is not", || !is_there());
    let error = program.remove_connection("radio").expect_err("gone");
    assert!(error.to_string().contains("there are: none"), "{error}");
    let own = NamedConnection::new("me", "ble", "wombat-2");
    let error = program.add_connection(&own).expect_err("itself");
    assert!(error.to_string().contains("this robot itself"), "{error}");
    drop(one);
}

#[test]
fn what_waits_for_a_connection_of_its_own_or_for_room_is_said() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let wombats = two(&air, &folder);
    let [one, two] = programs(&wombats);
    let (urgent, large) = (one.with(Urgency::Urgent), vec![7; 20_000]);
    let mut heard = two.subscribe("wombat-1/*").expect("subscribed");
    let (mut has_stopped, mut is_whole) = (false, false);
    until("both arrive", || {
        urgent.publish("stop", "now").expect("said");
        one.send("wombat-2", "map", &large).expect("said");
        while let Some(message) = heard.next_within(Duration::from_millis(200)) {
            has_stopped |= message.urgency == Urgency::Urgent;
            is_whole |= message.payload.bytes == large;
        }
        has_stopped && is_whole
    });
}

#[test]
fn what_was_said_while_the_radio_was_cut_is_told_as_a_gap() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let wombats = two(&air, &folder);
    let [one, two] = programs(&wombats);
    let mut heard = two.subscribe("wombat-1/n").expect("subscribed");
    let mut number = 0;
    let mut say = || {
        number += 1;
        one.publish("n", Json(number)).expect("said");
    };
    until("linked", || {
        say();
        heard.next_within(Duration::from_millis(50)).is_some()
    });
    let tell = |what| {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let socket = air.socket();
        let told = control(&socket, what);
        runtime
            .expect("a runtime")
            .block_on(told)
            .expect("the air does it");
    };
    tell(Control::Cut);
    until("the link is down", || {
        let state = |one: &rect::Connection| one.state == rect::ConnectionState::Connected;
        let all = one.connections().expect("asked");
        !all.iter().any(|one| one.method == "ble" && state(one))
    });
    while heard.next_within(Duration::from_millis(20)).is_some() {}
    for _ in 0..10 {
        say();
    }
    tell(Control::Restore);
    let mut missed = 0;
    until("a message comes again", || {
        say();
        let message = heard.next_within(Duration::from_millis(50));
        missed = message.as_ref().map_or(0, |message| message.missed);
        message.is_some()
    });
    assert!(missed >= 10, "{missed}");
    assert_eq!(two.counters().missed, u64::from(missed));
}

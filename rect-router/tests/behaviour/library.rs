//! Tests of programs that use the library `rect` on two robots, linked over the simulated air:
//! `cargo test -p rect-router --test behaviour library`
use std::time::{Duration, Instant};

use crate::support::{ble, file, Air, Wombat, DEADLINE};
use rect::{
    blocking::Robot, ConnectionState, Event, Json, NamedConnection, Options, Payload, Urgency,
};
use serde_json::json;
use zenoh_link_ble_air::{control, Control};

/// Connects a program to the router of a robot.
fn program(wombat: &Wombat, name: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    Robot::connect(options.router(&wombat.endpoint)).expect("joined")
}

/// Starts two robots that are linked by Bluetooth.
fn two(air: &Air, folder: &tempfile::TempDir) -> [Wombat; 2] {
    let no_connections = file(&[]);
    let first = Wombat::start(air, folder, 1, &no_connections);
    let other = Wombat::start(air, folder, 2, &file(&[ble("radio", "wombat-1")]));
    [first, other]
}

/// Connects one program to each router.
fn programs([first, other]: &[Wombat; 2]) -> [Robot; 2] {
    [program(first, "wombat-1"), program(other, "wombat-2")]
}

/// Waits until a condition holds, which `what` describes.
fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let deadline = Instant::now() + DEADLINE;
    while !condition() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn programs_of_two_robots_communicate_over_ble_and_are_notified_of_the_link() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let wombats = two(&air, &folder);
    let [one, two] = programs(&wombats);
    let mut events = two.events().expect("events");
    let link = events.find(|event| matches!(event, Event::LinkUp(link) if link.method == "ble"));
    assert!(link.is_some());
    until("both know of each other", || {
        one.peers().expect("asked") == ["wombat-2"] && two.peers().expect("asked") == ["wombat-1"]
    });
    let mut messages = two
        .subscribe::<Payload>("wombat-1/arm/*")
        .expect("subscribed");
    let mut method = None;
    until("a message arrives by Bluetooth", || {
        one.publish("arm/angle", Json(12.5)).expect("published");
        let message = messages.next_timeout(Duration::from_millis(100));
        method = method.take().or(message.and_then(|message| message.method));
        method.is_some()
    });
    assert_eq!(method.as_deref(), Some("ble"));
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
        answer = two.request::<Payload>("wombat-1", "battery", "").ok();
        answer.is_some()
    });
    let volt: serde_json::Value = answer.expect("one").payload.value().expect("JSON");
    assert_eq!(volt["volt"], 7.2);
}

#[test]
fn a_program_adds_and_removes_a_named_connection() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let no_connections = file(&[]);
    let [one, two] = [1, 2].map(|number| Wombat::start(&air, &folder, number, &no_connections));
    let program = program(&two, "wombat-2");
    let radio = NamedConnection::new("radio", "ble", "wombat-1");
    program.add_connection(&radio).expect("added");
    program.add_connection(&radio).expect("unchanged");
    let is_connected = || {
        let all = program.connections().expect("asked");
        let named = all.iter().find(|one| one.name.as_deref() == Some("radio"));
        named.is_some_and(|one| one.state == ConnectionState::Connected)
    };
    until("the robots are linked", is_connected);
    program.remove_connection("radio").expect("removed");
    until("the robots are no longer linked", || !is_connected());
    let error = program
        .remove_connection("radio")
        .expect_err("no such connection");
    assert!(error.to_string().contains("there are: none"), "{error}");
    let own = NamedConnection::new("me", "ble", "wombat-2");
    let error = program
        .add_connection(&own)
        .expect_err("a connection to itself");
    assert!(error.to_string().contains("this robot itself"), "{error}");
    drop(one);
}

#[test]
fn urgent_and_large_messages_arrive() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let wombats = two(&air, &folder);
    let [one, two] = programs(&wombats);
    let (urgent, large) = (one.with_urgency(Urgency::Urgent), vec![7; 20_000]);
    let mut messages = two.subscribe::<Payload>("wombat-1/*").expect("subscribed");
    let linked = one.wait_for_peer("wombat-2", DEADLINE);
    linked.expect("the robots are linked");
    let (mut has_stopped, mut is_whole) = (false, false);
    until("both arrive", || {
        urgent.publish("stop", "now").expect("published");
        one.send("wombat-2", "map", &large).expect("published");
        while let Some(message) = messages.next_timeout(Duration::from_millis(200)) {
            has_stopped |= message.urgency == Urgency::Urgent;
            is_whole |= message.payload.bytes == large;
        }
        has_stopped && is_whole
    });
}

#[test]
fn messages_lost_while_the_radio_is_cut_are_counted_as_missed() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let wombats = two(&air, &folder);
    let [one, two] = programs(&wombats);
    let mut messages = two.subscribe::<Payload>("wombat-1/n").expect("subscribed");
    let mut number = 0;
    let mut publish = || {
        number += 1;
        one.publish("n", Json(number)).expect("published");
    };
    until("linked", || {
        publish();
        messages.next_timeout(Duration::from_millis(50)).is_some()
    });
    let control_air = |action| {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        let socket = air.socket();
        let done = control(&socket, action);
        runtime
            .expect("a runtime")
            .block_on(done)
            .expect("the air accepts it");
    };
    control_air(Control::Cut);
    until("the link is down", || {
        let state = |one: &rect::Connection| one.state == rect::ConnectionState::Connected;
        let all = one.connections().expect("asked");
        !all.iter().any(|one| one.method == "ble" && state(one))
    });
    while messages.next_timeout(Duration::from_millis(20)).is_some() {}
    for _ in 0..10 {
        publish();
    }
    control_air(Control::Restore);
    let mut missed = 0;
    until("a message arrives again", || {
        publish();
        let message = messages.next_timeout(Duration::from_millis(50));
        missed = message.as_ref().map_or(0, |message| message.missed);
        message.is_some()
    });
    assert!(missed >= 10, "{missed}");
    assert_eq!(two.counters().missed, u64::from(missed));
}

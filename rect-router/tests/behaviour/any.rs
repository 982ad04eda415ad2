//! Tests links over Bluetooth and Wi-Fi at once (`any/`), with both simulated: `cargo test -p rect-router --test behaviour any`
use std::{
    fs,
    io::Write,
    net::TcpStream,
    path::{Path, PathBuf},
    sync::mpsc,
    time::{Duration, Instant},
};

use crate::support::{
    answers, arrives, client, file, free_socket, joined, repository, Air, Router, DEADLINE,
};
use serde_json::{json, Value};
use zenoh::{
    handlers::FifoChannelHandler, pubsub::Subscriber, qos::CongestionControl, sample::Sample,
    Session, Wait,
};
use zenoh_link_any::wifi::{self, Wifi, WifiOptions, WifiState};

/// A robot with a listener for links over several paths.
struct Robot {
    _router: Router,
    session: Session,
    endpoint: String,
}

struct World {
    air: Air,
    folder: tempfile::TempDir,
    wifi: PathBuf,
    runtime: tokio::runtime::Runtime,
}

impl World {
    fn new() -> Self {
        let air = Air::new();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .expect("a runtime");
        let wifi = wifi::socket_beside(&air.socket());
        let served = {
            let _runtime = runtime.enter();
            Wifi::bind(&wifi, WifiOptions::default()).expect("a Wi-Fi")
        };
        runtime.spawn(async move { served.serve().await });
        Self {
            air,
            folder: tempfile::tempdir().expect("a folder"),
            wifi,
            runtime,
        }
    }

    fn set_wifi(&self, state: WifiState) {
        let set = self.runtime.block_on(wifi::control(&self.wifi, state));
        set.expect("a Wi-Fi");
    }

    /// Starts a robot that listens with `method`, and has a connection with the method `any` to each of `to`: a robot, or the
    /// address of wombat-1.
    fn robot(&self, number: u32, method: &str, secret: Option<&Path>, to: &[&str]) -> Robot {
        let options = secret.map_or_else(String::new, |file| format!(";secret={}", file.display()));
        self.robot_with(number, method, &options, to)
    }

    /// Starts a robot with these options of its listener.
    fn robot_with(&self, number: u32, method: &str, options: &str, to: &[&str]) -> Robot {
        let listener = format!("{method}/sim-wombat-{number}#name=wombat-{number}{options}");
        let listed: Vec<_> = to.iter().map(|to| any_to(to)).collect();
        self.start(number, &listener, &listed)
    }

    /// Starts a robot with that listener and these connections.
    fn start(&self, number: u32, listener: &str, listed: &[Value]) -> Robot {
        self.start_with(number, listener, listed, &[])
    }

    /// Starts a robot whose router has further arguments.
    fn start_with(
        &self,
        number: u32,
        listener: &str,
        listed: &[Value],
        arguments: &[&str],
    ) -> Robot {
        let connections = self.folder.path().join(format!("{number}.json"));
        fs::write(&connections, file(listed).to_string()).expect("written");
        let settings = json!({ "robot": format!("wombat-{number}"), "connections": connections });
        let config = repository().join("config/simulation.json5");
        let (config, settings) = (
            config.display().to_string(),
            format!("plugins/rect:{settings}"),
        );
        let own = ["-c", &config, "-l", "tcp/127.0.0.1:0", "-l", listener];
        let mut router = Router::start_on(
            &self.air,
            &[&own, &["--cfg", settings.as_str()][..], arguments].concat(),
        );
        let endpoint = router.listener();
        router.up();
        Robot {
            session: client(&endpoint),
            endpoint,
            _router: router,
        }
    }

    /// Starts a robot of the team that accepts links on the port of an address.
    fn robot_at(&self, number: u32, address: &str, to: &[&str]) -> Robot {
        let (secret, port) = (self.secret("team"), port_of(address));
        let options = format!(";secret={};port={port}", secret.display());
        self.robot_with(number, "any", &options, to)
    }

    fn secret(&self, name: &str) -> PathBuf {
        let path = self.folder.path().join(name);
        fs::write(&path, format!("fleet:the secret of {name}\n")).expect("written");
        path
    }
}

/// Returns the entry of a connection to a robot, or to wombat-1 at an address.
fn any_to(robot: &str) -> Value {
    match robot.rsplit_once(':') {
        Some((host, port)) => {
            let port: u16 = port.parse().expect("a port");
            json!({ "name": "wombat-1", "method": "any", "address": host, "port": port })
        }
        None => json!({ "name": robot, "method": "any", "address": robot }),
    }
}

fn port_of(address: &str) -> &str {
    address.rsplit(':').next().expect("a port")
}

/// Waits until the connection of wombat-2 with wombat-1 is as expected, and returns it.
fn connection(robot: &Robot, is_expected: impl Fn(&Value) -> bool) -> Value {
    connection_of(2, robot, is_expected)
}

/// Waits until the connection of the robot with that number with wombat-1 is as expected, and returns it.
fn connection_of(number: u32, robot: &Robot, is_expected: impl Fn(&Value) -> bool) -> Value {
    let selector = format!("rect/wombat-{number}/@rect/connections?name=wombat-1");
    let answer = answers(&robot.session, &selector, |answer| is_expected(&answer[0]));
    answer[0].clone()
}

/// Returns whether the path with that method carries the bulk.
fn is_primary(connection: &Value, method: &str) -> bool {
    let paths = connection["paths"].as_array().into_iter().flatten();
    let mut primary = paths.filter(|path| path["is_primary"] == true);
    primary.any(|path| path["method"] == method)
}

/// Returns whether the connection has live paths with these methods, and no others.
fn has_paths(connection: &Value, methods: &[&str]) -> bool {
    let paths = connection["paths"].as_array().into_iter().flatten();
    let live = paths.filter(|path| path["state"] == "live");
    let mut found: Vec<_> = live.filter_map(|path| path["method"].as_str()).collect();
    found.sort_unstable();
    found == methods
}

/// Publishes numbered messages, and verifies that each arrives once and in order.
struct Counted<'a> {
    publisher: &'a Session,
    subscriber: Subscriber<FifoChannelHandler<Sample>>,
    sent: u32,
}

impl<'a> Counted<'a> {
    const KEY: &'static str = "rect/wombat-2/count";

    fn start(publisher: &'a Session, to: &Session) -> Self {
        // Declared before the other one ends, so that the routers keep the subscription.
        let subscriber = to.declare_subscriber(Self::KEY).wait().expect("declared");
        assert!(arrives(publisher, to, Self::KEY));
        Self {
            publisher,
            subscriber,
            sent: 0,
        }
    }

    /// Publishes for a time.
    fn publish(&mut self, time: Duration) {
        let until = Instant::now() + time;
        while Instant::now() < until {
            let put = self.publisher.put(Self::KEY, self.sent.to_string());
            let put = put.congestion_control(CongestionControl::Block);
            put.wait().expect("published");
            self.sent += 1;
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn verify(self) {
        let next = || {
            let sample = self.subscriber.recv_timeout(DEADLINE).expect("open");
            sample.map(|sample| sample.payload().try_to_string().expect("text").into_owned())
        };
        for number in 0..self.sent {
            // `arrives` has published the others.
            let text = std::iter::from_fn(next).find(|text| text != "hello");
            assert_eq!(text, Some(number.to_string()), "of {}", self.sent);
        }
        let more = self.subscriber.try_recv().expect("open");
        assert!(more.is_none(), "a message arrived twice");
    }
}

#[test]
fn link_over_which_nothing_arrives_is_silent_before_it_ends() {
    let world = World::new();
    let secret = world.secret("team");
    let _one = world.robot(1, "any", Some(&secret), &[]);
    let two = world.robot(2, "any", Some(&secret), &["wombat-1"]);
    let linked = connection(&two, |link| has_paths(link, &["ble", "tcp"]));
    assert!(linked["silent_s"].is_null(), "{linked:#}");
    let reports = (two.session).declare_subscriber("rect/wombat-2/@rect/connections");
    let reports = reports.wait().expect("declared");
    world.set_wifi(WifiState::Silent);
    world.air.air().cut();
    let has_begun = |link: &Value| link["silent_s"].is_number() || link["state"] != "connected";
    let silent = connection(&two, has_begun);
    assert_eq!(silent["state"], "connected", "{silent:#}");
    assert!(silent["silent_s"].as_f64() >= Some(3.5), "{silent:#}");
    // Programs need not ask.
    let deadline = Instant::now() + DEADLINE;
    let mut published = Vec::new();
    let is_silent = |report: &Value| report[0]["silent_s"].is_number();
    while !published.last().is_some_and(is_silent) {
        assert!(Instant::now() < deadline, "{published:#?}");
        let report = reports.recv_timeout(Duration::from_secs(1)).expect("open");
        let report = report.map(|report| report.payload().to_bytes().into_owned());
        published.extend(report.map(|report| serde_json::from_slice(&report).expect("JSON")));
    }
    world.set_wifi(WifiState::On);
    world.air.air().restore();
    connection(&two, |link| {
        link["state"] == "connected" && link["silent_s"].is_null()
    });
}

#[test]
fn link_survives_the_loss_of_either_path() {
    let world = World::new();
    let secret = world.secret("team");
    let one = world.robot(1, "any", Some(&secret), &[]);
    let two = world.robot(2, "any", Some(&secret), &["wombat-1"]);
    let linked = connection(&two, |link| {
        has_paths(link, &["ble", "tcp"]) && is_primary(link, "tcp")
    });
    assert_eq!(linked["encrypted"], true, "{linked:#}");
    assert_eq!(linked["peer"]["robot"], "wombat-1", "{linked:#}");

    let mut counted = Counted::start(&two.session, &one.session);
    counted.publish(Duration::from_millis(300));
    let reports = (two
        .session
        .declare_subscriber("rect/wombat-2/@rect/connections"))
    .wait()
    .expect("declared");
    // Jammed: connections stay open, and nothing arrives.
    world.set_wifi(WifiState::Silent);
    counted.publish(Duration::from_secs(1));
    let silent = connection(&two, |link| is_primary(link, "ble"));
    let switch = &silent["last_switch"];
    assert_eq!(
        [&switch["path"], &switch["reason"]],
        ["ble", "silent"],
        "{silent:#}"
    );
    // On a busy computer, Bluetooth may also be silent for a moment afterwards, which is a switch of its own.
    let published = std::iter::from_fn(|| reports.recv_timeout(DEADLINE).expect("open"));
    let mut switches = published.map(|report| {
        let report: Value = serde_json::from_slice(&report.payload().to_bytes()).expect("JSON");
        let switch = &report[0]["last_switch"];
        [&switch["previous"], &switch["path"], &switch["reason"]].map(Value::clone)
    });
    assert!(
        switches.any(|switch| switch == ["tcp", "ble", "silent"]),
        "the switch is published"
    );
    // Both routers answer, each with the other one as its peer.
    answers(&two.session, "@/*/router/any", |links| {
        links[0]["peer"] == "wombat-1" && links[0]["last_switch"]["path"] == "ble"
    });
    world.set_wifi(WifiState::On);
    counted.publish(Duration::from_millis(300));
    connection(&two, |link| is_primary(link, "tcp"));
    // There is no network for a while.
    world.set_wifi(WifiState::Off);
    counted.publish(Duration::from_millis(500));
    connection(&two, |link| {
        is_primary(link, "ble") && has_paths(link, &["ble"])
    });
    world.set_wifi(WifiState::On);
    connection(&two, |link| is_primary(link, "tcp"));
    // The robots are out of range of Bluetooth.
    world.air.air().cut();
    counted.publish(Duration::from_millis(500));
    connection(&two, |link| has_paths(link, &["tcp"]));
    counted.publish(Duration::from_millis(300));
    world.air.air().restore();
    let restored = connection(&two, |link| has_paths(link, &["ble", "tcp"]));
    counted.publish(Duration::from_millis(100));
    counted.verify();
    assert_eq!(restored["linked"], 1, "one link all the time: {restored:#}");
}

#[test]
fn link_without_a_secret_uses_bluetooth_alone() {
    let world = World::new();
    let one = world.robot(1, "any", None, &[]);
    let two = world.robot(2, "any", None, &["wombat-1"]);
    let linked = connection(&two, |link| link["state"] == "connected");
    assert!(arrives(&one.session, &two.session, "rect/wombat-1/x"));
    assert_eq!(linked["encrypted"], false, "{linked:#}");
    assert!(
        is_primary(&linked, "ble") && has_paths(&linked, &["ble"]),
        "{linked:#}"
    );
}

#[test]
fn robot_that_knows_only_bluetooth_gets_a_bluetooth_link() {
    let world = World::new();
    let secret = world.secret("team");
    let one = world.robot(1, "ble", Some(&secret), &[]);
    let two = world.robot(2, "any", Some(&secret), &["wombat-1"]);
    let linked = connection(&two, |link| link["state"] == "connected");
    assert_eq!(linked["paths"], Value::Null, "{linked:#}");
    assert_eq!(linked["encrypted"], true, "{linked:#}");
    assert!(arrives(&one.session, &two.session, "rect/wombat-1/x"));
}

#[test]
fn robot_of_another_team_gets_no_path() {
    let world = World::new();
    let _one = world.robot(1, "any", Some(&world.secret("team")), &[]);
    let two = world.robot(2, "any", Some(&world.secret("others")), &["wombat-1"]);
    let failed = connection(&two, |link| link["failed"].as_u64() > Some(0));
    let error = failed["last_error"]["what"].as_str().expect("an error");
    assert!(error.contains("the same secret"), "{error}");
    assert_ne!(failed["state"], "connected");
}

/// Where Bluetooth does not reach, a link begins on the network. It gets a Bluetooth path later, and finds the network again.
#[test]
fn link_to_an_address_begins_on_the_network() {
    let world = World::new();
    world.air.air().cut();
    let address = free_socket();
    let one = world.robot_at(1, &address, &[]);
    let two = world.robot(2, "any", Some(&world.secret("team")), &[&address]);
    let linked = connection(&two, |link| has_paths(link, &["tcp"]));
    assert_eq!(linked["peer"]["robot"], "wombat-1", "{linked:#}");
    assert_eq!(linked["encrypted"], true, "{linked:#}");
    let mut counted = Counted::start(&two.session, &one.session);
    counted.publish(Duration::from_millis(300));
    world.air.air().restore();
    connection(&two, |link| has_paths(link, &["ble", "tcp"]));
    world.set_wifi(WifiState::Off);
    counted.publish(Duration::from_millis(500));
    connection(&two, |link| has_paths(link, &["ble"]));
    world.set_wifi(WifiState::On);
    let restored = connection(&two, |link| is_primary(link, "tcp"));
    counted.publish(Duration::from_millis(100));
    counted.verify();
    assert_eq!(restored["linked"], 1, "one link all the time: {restored:#}");
}

/// Both have the address of the other.
#[test]
fn two_robots_that_dial_each_other_by_address_have_one_link() {
    let world = World::new();
    world.air.air().cut();
    let addresses = [free_socket(), free_socket()];
    let one = world.robot_at(1, &addresses[0], &[&addresses[1]]);
    let two = world.robot_at(2, &addresses[1], &[&addresses[0]]);
    let linked = connection(&two, |link| has_paths(link, &["tcp"]));
    assert_eq!(linked["peer"]["robot"], "wombat-1", "{linked:#}");
    assert!(arrives(&one.session, &two.session, "rect/wombat-1/x"));
    assert!(arrives(&two.session, &one.session, "rect/wombat-2/x"));
}

#[test]
fn robots_without_bluetooth_are_linked_by_address() {
    let world = World::new();
    let secret = world.secret("team");
    let address = free_socket();
    let listen = |number: u32, address: &str| {
        let port = port_of(address);
        let secret = secret.display();
        format!(
            "any/hci99#name=wombat-{number};wait=true;secret={secret};port={port};interfaces=lo"
        )
    };
    let one = world.start(1, &listen(1, &address), &[]);
    let two = world.start(2, &listen(2, &free_socket()), &[any_to(&address)]);
    let linked = connection(&two, |link| has_paths(link, &["tcp"]));
    assert_eq!(linked["peer"]["robot"], "wombat-1", "{linked:#}");
    assert!(arrives(&one.session, &two.session, "rect/wombat-1/x"));
    let dial = format!("any/{address}");
    let three = world.start_with(3, &listen(3, &free_socket()), &[], &["-e", &dial]);
    assert!(arrives(&three.session, &one.session, "rect/wombat-3/x"));
}

#[test]
fn address_of_another_robot_or_team_is_reported() {
    let world = World::new();
    world.air.air().cut();
    let address = free_socket();
    let _one = world.robot_at(1, &address, &[]);
    let error_of = |secret: &str, entry: Value| {
        let secret = world.secret(secret);
        let listener = format!("any/sim-wombat-2#name=wombat-2;secret={}", secret.display());
        let two = world.start(2, &listener, &[entry]);
        let failed = connection(&two, |link| link["failed"].as_u64() > Some(0));
        assert_ne!(failed["state"], "connected");
        let error = failed["last_error"]["what"].as_str();
        error.expect("an error").to_owned()
    };
    let options = json!({ "address": address, "timeout": 1000 });
    let other =
        json!({ "name": "wombat-1", "method": "any", "address": "wombat-3", "options": options });
    let other = error_of("team", other);
    assert!(
        other.contains("wombat-1 answers there, and not wombat-3"),
        "{other}"
    );
    let other_team = error_of("others", any_to(&address));
    assert!(other_team.contains("the same secret"), "{other_team}");
    let nobody = error_of("team", any_to(&free_socket()));
    assert!(nobody.contains("port="), "{nobody}");
}

/// Unauthenticated peers hold connections to the port for network paths, and send anything.
#[test]
fn unauthenticated_connections_do_not_keep_a_robot_out() {
    let world = World::new();
    let secret = world.secret("team");
    let address = free_socket();
    let one = world.robot_at(1, &address, &[]);
    let unauthenticated: Vec<_> = (0..40_u8)
        .map(|number| {
            let mut stream = TcpStream::connect(&address).expect("accepted");
            // Nothing, part of a first message, or one for a link that does not exist.
            let garbage = [&b"RECTA\x01"[..], &[number; 56]].concat();
            let opening = [&b"RECTM\x01"[..], &[48, 0], &[number; 48]].concat();
            let sent = [
                &garbage[..0],
                &garbage[..20],
                &garbage,
                &opening,
                &opening[..20],
            ];
            let sent = sent[usize::from(number) % 5];
            stream.write_all(sent).expect("sent");
            stream
        })
        .collect();
    let two = world.robot(2, "any", Some(&secret), &["wombat-1"]);
    connection(&two, |link| has_paths(link, &["ble", "tcp"]));
    assert!(arrives(&one.session, &two.session, "rect/wombat-1/x"));
    drop(unauthenticated);
}

/// All paths are lost for three seconds. Afterwards the robot stops, and does not execute the drive commands from before.
#[test]
fn stop_command_survives_a_cut_and_old_drive_commands_do_not() {
    const LIFETIME: Duration = Duration::from_millis(200);
    let world = World::new();
    let secret = world.secret("team");
    let one = world.robot(1, "any", Some(&secret), &[]);
    let two = world.robot(2, "any", Some(&secret), &["wombat-1"]);
    connection(&two, |link| has_paths(link, &["ble", "tcp"]));
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let join = |name, at: &Robot| runtime.block_on(joined(name, &at.endpoint));
    let (robot, base) = (join("wombat-1", &one), join("wombat-2", &two));
    let begun = Instant::now();
    let (sender, drives) = mpsc::channel();
    let driving = robot.on_message::<rect::Payload>("wombat-2/drive", move |message| {
        let sent_ms: u64 = message.payload.value().expect("a number");
        let age = begun
            .elapsed()
            .saturating_sub(Duration::from_millis(sent_ms));
        sender.send(age).expect("counted");
    });
    let _driving = runtime.block_on(driving).expect("subscribed");
    let (sender, stops) = mpsc::channel();
    let stopping = robot
        .on_message::<rect::Payload>("wombat-2/stop", move |_| sender.send(()).expect("counted"));
    let _stopping = runtime.block_on(stopping).expect("subscribed");
    let (urgent, steering) = (base.urgent(), base.urgent().expires_after(LIFETIME));
    let drive = || {
        let sent_ms = begun.elapsed().as_millis() as u64;
        let published = steering.publish("drive", rect::Json(sent_ms));
        runtime.block_on(published).expect("published");
        std::thread::sleep(Duration::from_millis(30));
    };
    while drives.try_recv().is_err() {
        assert!(begun.elapsed() < DEADLINE, "drive commands arrive");
        drive();
    }

    world.air.air().cut();
    world.set_wifi(WifiState::Off);
    for number in 0..100 {
        drive();
        if number == 50 {
            let stop = urgent.publish("stop", "");
            runtime.block_on(stop).expect("published");
        }
    }
    assert!(stops.try_recv().is_err(), "nothing arrives without a path");
    world.set_wifi(WifiState::On);
    world.air.air().restore();
    stops.recv_timeout(DEADLINE).expect("stopped");
    let restored = Instant::now();
    let mut ages: Vec<_> = drives.try_iter().collect();
    while ages.len() < 5 {
        assert!(restored.elapsed() < DEADLINE, "it can drive again");
        drive();
        ages.extend(drives.try_iter());
    }
    let oldest = ages.iter().max().expect("some");
    // The bound is the lifetime and what the fastest message took; the rest is for a busy machine.
    assert!(*oldest < LIFETIME + Duration::from_millis(300), "{ages:?}");
    let counters = robot.counters();
    assert!(counters.missed + counters.expired > 80, "{counters:?}");
}

/// A standby path gives way to a robot that can only be reached over Bluetooth.
#[test]
fn last_place_of_the_adapter_is_for_a_robot_without_another_path() {
    let world = World::new();
    let secret = world.secret("team");
    let options = format!(";secret={};max_links=2", secret.display());
    let one = world.robot_with(1, "any", &options, &[]);
    let linked = [2, 3].map(|number| {
        let robot = world.robot(number, "any", Some(&secret), &["wombat-1"]);
        connection_of(number, &robot, |link| is_primary(link, "tcp"));
        robot
    });
    let four = world.start(
        4,
        &format!("ble/sim-wombat-4#name=wombat-4;secret={}", secret.display()),
        &[json!({ "name": "wombat-1", "method": "ble", "address": "wombat-1" })],
    );
    connection_of(4, &four, |link| link["state"] == "connected");
    assert!(arrives(&four.session, &one.session, "rect/wombat-4/x"));
    for (number, robot) in [2, 3].into_iter().zip(&linked) {
        let link = connection_of(number, robot, |link| has_paths(link, &["tcp"]));
        assert_eq!(link["linked"], 1, "one link all the time: {link:#}");
    }
}

#[test]
fn restarted_robot_is_linked_again() {
    let world = World::new();
    let secret = world.secret("team");
    let one = world.robot(1, "any", Some(&secret), &[]);
    let two = world.robot(2, "any", Some(&secret), &["wombat-1"]);
    connection(&two, |link| has_paths(link, &["ble", "tcp"]));
    drop(one);
    let one = world.robot(1, "any", Some(&secret), &[]);
    let linked = connection(&two, |link| {
        has_paths(link, &["ble", "tcp"])
            && is_primary(link, "tcp")
            && link["linked"].as_u64() > Some(1)
    });
    assert_eq!(linked["peer"]["robot"], "wombat-1", "{linked:#}");
    assert!(arrives(&one.session, &two.session, "rect/wombat-1/x"));
}

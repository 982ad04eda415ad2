//! Tests of named connections and of the registry that reports them: `cargo test -p rect-router --test behaviour connections`

use std::{
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use crate::support::{
    answers, arrives, ask, ble, change, client, connected, file, repository, tcp, Air, Wombat,
    DEADLINE,
};
use nix::{sys::stat::Mode, unistd::mkfifo};
use serde_json::{json, Value};
use zenoh::Wait;

#[test]
fn the_registry_answers_the_six_questions() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let three = Wombat::start(&air, &folder, 3, &file(&[]));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let connections = file(&[
        ble("radio", "wombat-2"),
        tcp("base", three.port()),
        tcp("nobody", 1),
        ble("away", "wombat-9"),
    ]);
    let one = Wombat::start(&air, &folder, 1, &connections);
    let local = client(&one.endpoint);
    let registry = "rect/wombat-1/@rect";
    let by_name = |name: &str| format!("{registry}/connections?name={name}");
    let is_known =
        |answer: &Value| connected(answer) == 1 && answer[0]["peer"]["robot"].is_string();

    // Query all connections, the ones with a name, and the ones of a method.
    let radio = answers(&local, &by_name("radio"), is_known);
    assert_eq!(radio[0]["peer"]["robot"], "wombat-2", "{radio:#}");
    assert_eq!(radio[0]["address"], "wombat-2", "{radio:#}");
    assert!(radio[0]["sent"]["bytes"].as_u64() > Some(0), "{radio:#}");
    let base = answers(&local, &by_name("base"), is_known);
    assert_eq!(base[0]["peer"]["robot"], "wombat-3", "{base:#}");
    assert!(base[0]["received"]["bytes"].as_u64() > Some(0), "{base:#}");
    assert!(base[0]["up_s"].as_f64() > Some(0.0), "{base:#}");
    assert!(base[0]["round_trip_ms"].as_f64() > Some(0.0), "{base:#}");
    let nobody = answers(&local, &by_name("nobody"), |all| {
        all[0]["failed"].as_u64() > Some(0)
    });
    assert_eq!(nobody[0]["state"], "connecting", "{nobody:#}");
    assert!(nobody[0]["last_error"]["what"].is_string(), "{nobody:#}");
    let by_method = format!("{registry}/connections?method=ble;state=connected");
    let by_method = ask(&local, &by_method).expect("an answer");
    assert_eq!(by_method.as_array().map(Vec::len), Some(1), "{by_method:#}");
    assert!(by_method[0]["rssi_dbm"].is_i64(), "{by_method:#}");

    // The scan for wombat-9 discovers wombat-3, which is not linked by Bluetooth.
    let discovered = format!("{registry}/connections?state=discovered");
    let discovered = answers(&local, &discovered, |all| all[0]["address"] == "wombat-3");
    assert_eq!(
        discovered.as_array().map(Vec::len),
        Some(1),
        "{discovered:#}"
    );
    assert!(discovered[0]["rssi_dbm"].is_i64(), "{discovered:#}");

    // Count the connections in total and by method. This test's session is one of them.
    let count = ask(&local, &format!("{registry}/connections/count")).expect("an answer");
    let expected = json!({ "total": 5, "connected": 3, "discovered": 1, "methods": {
        "any": { "total": 0, "connected": 0, "discovered": 0 },
        "ble": { "total": 2, "connected": 1, "discovered": 1 },
        "tcp": { "total": 3, "connected": 2, "discovered": 0 },
        "udp": { "total": 0, "connected": 0, "discovered": 0 },
    } });
    assert_eq!(count, expected);

    // Query all connections of a peer, the peers with a given connection, and the peers with several connections.
    let of_peer = ask(&local, &format!("{registry}/connections?peer=wombat-3")).expect("an answer");
    assert_eq!(of_peer[0]["name"], "base", "{of_peer:#}");
    let with = ask(&local, &format!("{registry}/peers?name=radio")).expect("an answer");
    assert_eq!(with[0]["robot"], "wombat-2", "{with:#}");
    let several = ask(&local, &format!("{registry}/peers?min_connections=2")).expect("an answer");
    assert_eq!(several, json!([]));

    check_docs(|query| ask(&local, &format!("rect/wombat-1/@rect/{query}")).expect("an answer"));

    // The other robots report the same links under their own names.
    let of_two = "rect/wombat-2/@rect/connections?method=ble";
    let remote = answers(&local, of_two, is_known);
    assert_eq!(remote[0]["peer"]["robot"], "wombat-1", "{remote:#}");
    assert_eq!(remote[0]["name"], Value::Null, "{remote:#}");
    drop(two);

    // The robot that accepted a TCP link reports its traffic from the kernel, which counts bytes only.
    let of_three = "rect/wombat-3/@rect/connections?method=tcp;peer=wombat-1";
    let remote = answers(&local, of_three, is_known);
    for way in ["sent", "received"] {
        assert!(remote[0][way]["bytes"].as_u64() > Some(0), "{remote:#}");
        assert_eq!(remote[0][way]["batches"], Value::Null, "{remote:#}");
    }
    assert!(
        remote[0]["round_trip_ms"].as_f64() > Some(0.0),
        "{remote:#}"
    );
}

/// The table in `docs/reference/registry.md`: questions and the queries that answer them.
const QUESTIONS: [(&str, &str); 6] = [
    ("How many by BLE, TCP, UDP?", "connections/count"),
    ("All connections of one client", "connections?peer=wombat-3"),
    ("All clients with a given connection", "peers?name=radio"),
    ("All available connections", "connections"),
    (
        "How many are there now?",
        "connections/count?state=connected",
    ),
    (
        "More than one to the same client?",
        "peers?min_connections=2",
    ),
];

/// Checks that the table in the documentation shows the replies of the registry.
fn check_docs(ask: impl Fn(&str) -> Value) {
    let mut table = String::from("| question | query | answer |\n|---|---|---|\n");
    for (question, query) in QUESTIONS {
        let answer = in_short(&ask(query)).replace("\",\"", "\", \"");
        table += &format!("| {question} | `{query}` | `{answer}` |\n");
    }
    let path = repository().join("docs/reference/registry.md");
    let docs = fs::read_to_string(&path).expect("the docs");
    let (begin, end) = ("<!-- questions -->\n", "<!-- /questions -->");
    let (before, rest) = docs.split_once(begin).expect("a beginning");
    let (shown, after) = rest.split_once(end).expect("an end");
    if std::env::var_os("RECT_UPDATE_DOCS").is_some() {
        fs::write(&path, format!("{before}{begin}{table}{end}{after}")).expect("written");
    } else {
        assert_eq!(shown, table, "set RECT_UPDATE_DOCS=1 to update the table");
    }
}

/// Returns the parts of a reply that are the same in each run.
fn in_short(answer: &Value) -> String {
    let connection = |one: &Value| {
        let robot = &one["peer"]["robot"];
        format!(
            "{{ name: {}, method: {}, state: {}, peer: {robot} }}",
            one["name"], one["method"], one["state"]
        )
    };
    let Some(list) = answer.as_array() else {
        return answer.to_string();
    };
    let mut items: Vec<String> = list
        .iter()
        .map(|one| match one["connections"].as_array() {
            Some(all) => {
                let all: Vec<_> = all.iter().map(connection).collect();
                format!(
                    "{{ robot: {}, connections: [{}] }}",
                    one["robot"],
                    all.join(", ")
                )
            }
            None => connection(one),
        })
        .collect();
    items.sort();
    format!("[{}]", items.join(", ").replace('"', ""))
}

#[test]
fn publishes_a_discovered_robot() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    // The router scans because it dials a robot.
    let one = Wombat::start(&air, &folder, 1, &file(&[ble("away", "wombat-9")]));
    let local = client(&one.endpoint);
    let changes = local.declare_subscriber("rect/wombat-1/@rect/connections");
    let changes = changes.wait().expect("a subscription");
    let _three = Wombat::start(&air, &folder, 3, &file(&[]));
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "the robot is not published");
        let sample = changes.recv_timeout(DEADLINE).expect("no session ends");
        let published = sample.expect("in time").payload().to_bytes().into_owned();
        let all: Vec<Value> = serde_json::from_slice(&published).expect("a list");
        // Until the name is known, the robot is published with its Bluetooth address.
        let is_it = |one: &&Value| one["state"] == "discovered" && one["address"] == "wombat-3";
        let Some(discovered) = all.iter().find(is_it) else {
            continue;
        };
        assert!(discovered["rssi_dbm"].is_i64(), "{discovered:#}");
        return;
    }
}

#[test]
fn applies_a_changed_file_without_touching_other_links() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let three = Wombat::start(&air, &folder, 3, &file(&[]));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let one = Wombat::start(&air, &folder, 1, &file(&[ble("radio", "wombat-2")]));
    let (local, remote) = (client(&one.endpoint), client(&two.endpoint));
    let third = client(&three.endpoint);
    let registry = "rect/wombat-1/@rect/connections";
    let changes = local
        .declare_subscriber(registry)
        .wait()
        .expect("a subscription");
    assert!(arrives(&local, &remote, "rect/wombat-1/kept"));
    let kept = remote
        .declare_subscriber("rect/wombat-1/number")
        .wait()
        .expect("a subscription");
    assert!(arrives(&local, &remote, "rect/wombat-1/number"));
    let mut sent = 0_u32;
    let mut publish_next = || {
        local
            .put("rect/wombat-1/number", sent.to_le_bytes())
            .wait()
            .expect("a put");
        sent += 1;
    };
    let states = |expected: &'static [(&str, &str)]| {
        move |answer: &Value| {
            let all = answer.as_array().expect("a list");
            let named: Vec<_> = all
                .iter()
                .filter_map(|one| Some((one["name"].as_str()?, one["state"].as_str()?)))
                .collect();
            named == expected
        }
    };

    // Add a connection.
    one.write(&file(&[
        ble("radio", "wombat-2"),
        tcp("base", three.port()),
    ]));
    publish_next();
    answers(
        &local,
        registry,
        states(&[("base", "connected"), ("radio", "connected")]),
    );
    assert!(arrives(&local, &third, "rect/wombat-1/added"));
    // Change it to a port without a listener.
    publish_next();
    one.write(&file(&[ble("radio", "wombat-2"), tcp("base", 1)]));
    answers(
        &local,
        registry,
        states(&[("base", "connecting"), ("radio", "connected")]),
    );
    answers(
        &third,
        "rect/wombat-3/@rect/connections/count?peer=wombat-1",
        |count| count["total"] == 0,
    );
    // Write an invalid file.
    publish_next();
    fs::write(&one.file, "{ \"connections\": [\n  { \"name\": ").expect("written");
    let mut one = one;
    let message = one.router.wait_for("connections-1.json:2:");
    assert!(
        message.contains("the connections stay as they were"),
        "{message}"
    );
    answers(
        &local,
        registry,
        states(&[("base", "connecting"), ("radio", "connected")]),
    );
    // Remove the connection.
    publish_next();
    one.write(&file(&[ble("radio", "wombat-2")]));
    answers(&local, registry, states(&[("radio", "connected")]));
    publish_next();

    for number in 0..sent {
        let arrived = loop {
            let sample = kept
                .recv_timeout(crate::support::DEADLINE)
                .expect("no session ends");
            let payload = sample.expect("in time").payload().to_bytes().into_owned();
            // Skip the messages of `arrives`.
            if let Ok(bytes) = payload.try_into() {
                break u32::from_le_bytes(bytes);
            }
        };
        assert_eq!(arrived, number, "an unchanged link lost a message");
    }
    let link = ask(&local, &format!("{registry}?name=radio")).expect("an answer");
    assert_eq!(link[0]["linked"], 1, "{link:#}");
    assert!(
        changes.try_recv().expect("open").is_some(),
        "changes are published"
    );
}

#[test]
fn a_connection_that_replaces_another_carries_messages() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let one = Wombat::start(&air, &folder, 1, &file(&[tcp("base", two.port())]));
    let (local, remote) = (client(&one.endpoint), client(&two.endpoint));
    let key = "rect/wombat-1/kept";
    let kept = remote.declare_subscriber(key).wait();
    let kept = kept.expect("a subscription");
    for n in 0..10 {
        let deadline = Instant::now() + DEADLINE;
        loop {
            local.put(key, [n]).wait().expect("a put");
            let received = kept.recv_timeout(Duration::from_millis(20));
            let received = received
                .expect("the session stays")
                .map(|sample| sample.payload().to_bytes().into_owned());
            if received == Some(vec![n]) {
                break;
            }
            assert!(
                Instant::now() < deadline,
                "connection {n} is connected but carries no message"
            );
        }
        // A connection with another name uses another placeholder, which is dialled at once, while Zenoh still counts the old
        // link.
        one.write(&file(&[tcp(&format!("base-{n}"), two.port())]));
        let registry = format!("rect/wombat-1/@rect/connections?name=base-{n}");
        answers(&local, &registry, |all| connected(all) == 1);
    }
}

#[test]
fn reports_invalid_files_and_queries_and_keeps_running() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let many: Vec<_> = (0..10_000)
        .map(|n| ble(&format!("r{n}"), &format!("r{n}")))
        .collect();
    let mut one = Wombat::start(&air, &folder, 1, &file(&many));
    let local = client(&one.endpoint);
    let log = one.router.drained().join("\n");
    assert!(
        log.contains("too many connections: at most 4 are allowed"),
        "{log}"
    );
    let registry = "rect/wombat-1/@rect/connections";
    for (query, expected) in [
        (format!("{registry}?metod=ble"), "`metod` is unknown"),
        (
            format!("{registry}/count?state=up"),
            "connected, connecting or discovered",
        ),
        (
            "rect/wombat-1/@rect/peers?min_connections=x".to_owned(),
            "min_connections=x",
        ),
    ] {
        let error = ask(&local, &query).expect_err("invalid");
        assert!(error.contains(expected), "{query}: {error}");
    }
    // A connection to the robot's own name is a mistake. One to its own address is never connected.
    one.write(&file(&[ble("b", "wombat-2"), ble("me", "wombat-1")]));
    one.router.wait_for("me leads to this robot itself");
    let own = one.port();
    one.write(&file(&[ble("b", "wombat-2"), tcp("self", own)]));
    let of_itself = answers(&local, &format!("{registry}?name=self"), |all| {
        all[0]["linked"].as_u64().max(all[0]["failed"].as_u64()) > Some(1)
    });
    assert_eq!(of_itself[0]["state"], "connecting", "{of_itself:#}");
    answers(&local, &format!("{registry}?name=b"), |all| {
        all.as_array().map(Vec::len) == Some(1)
    });
}

#[test]
fn robots_connect_automatically_within_their_fleet_only() {
    let air = Air::new();
    let fleets = ["lions", "bears", "lions", "bears"];
    let robots: Vec<_> = (1..)
        .zip(fleets)
        .map(|(number, fleet)| {
            let settings = json!({ "fleet": fleet, "auto_connect": "fleet" });
            Wombat::start_with(&air, number, settings, PathBuf::new())
        })
        .collect();
    for (number, mate) in [(1, 3), (2, 4), (3, 1), (4, 2)] {
        let robot: &Wombat = &robots[number - 1];
        let fleet = fleets[number - 1];
        let asked = format!("{fleet}/wombat-{number}/@rect/connections?method=ble");
        let links = answers(&client(&robot.endpoint), &asked, |links| {
            links[0]["peer"]["robot"].is_string()
        });
        assert_eq!(links.as_array().map(Vec::len), Some(1), "{links:#}");
        assert_eq!(
            links[0]["peer"]["robot"],
            format!("wombat-{mate}"),
            "{links:#}"
        );
    }
}

#[test]
fn files_of_options_neither_block_other_connections_nor_show_which_ones_exist() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let path = |name: &str| folder.path().join(name);
    mkfifo(&path("pipe"), Mode::S_IRWXU).expect("a pipe");
    symlink("/dev/zero", path("zero")).expect("a link");
    let with_file = |name: &str, method: &str, port: u16, path: &Path| {
        let options = json!({ "root_ca_certificate_file": path });
        json!({ "name": name, "method": method, "address": "127.0.0.1", "port": port, "options": options })
    };
    let names = ["pipe", "zero", "missing"];
    let mut listed: Vec<_> = ["tls", "quic", "tls"]
        .iter()
        .zip(names)
        .zip(1..)
        .map(|((method, name), port)| with_file(name, method, port, &path(name)))
        .collect();
    let mut one = Wombat::start(&air, &folder, 1, &file(&[]));
    let local = client(&one.endpoint);
    one.write(&file(&listed));
    one.router
        .wait_for("pipe: the file of the option root_ca_certificate_file cannot be used");
    let registry = "rect/wombat-1/@rect/connections";
    for name in names {
        let failed = answers(&local, &format!("{registry}?name={name}"), |all| {
            all[0]["failed"].as_u64() > Some(0)
        });
        assert_eq!(
            failed[0]["last_error"]["what"],
            "the file of the option root_ca_certificate_file cannot be used; the log of this robot's router has the reason",
            "{failed:#}"
        );
    }
    listed.push(tcp("base", two.port()));
    one.write(&file(&listed));
    let base = format!("{registry}?name=base");
    answers(&local, &base, |all| connected(all) == 1);

    // A file outside of the folders is not even opened.
    let add = "rect/wombat-1/@rect/@config/connections?add";
    let elsewhere = with_file("base", "tls", 4, Path::new("/dev/zero")).to_string();
    let refused = change(&local, add, &elsewhere).expect("an answer");
    assert!(
        refused.is_err_and(|error| error.contains("the file must be given by its absolute path"))
    );
}

//! Named connections from a file, and the registry that tells of them: `cargo test -p rect-router --test connections`

mod support;

use std::{
    fs,
    path::PathBuf,
    thread,
    time::{Duration, Instant},
};

use serde_json::{json, Value};
use support::{answers, arrives, ask, client, repository, Air, Router, DEADLINE};
use zenoh::{Session, Wait};

/// A robot's router on the air, with a file of connections.
struct Wombat {
    router: Router,
    endpoint: String,
    file: PathBuf,
}

impl Wombat {
    fn start(air: &Air, folder: &tempfile::TempDir, number: u32, connections: &Value) -> Self {
        let file = folder.path().join(format!("connections-{number}.json"));
        fs::write(&file, connections.to_string()).expect("written");
        let settings = json!({ "connections": &file, "max_connections": 4 });
        Self::start_with(air, number, settings, file)
    }

    fn start_with(air: &Air, number: u32, mut settings: Value, file: PathBuf) -> Self {
        let config = repository().join("config/simulation.json5");
        settings["robot"] = json!(format!("wombat-{number}"));
        let mut router = Router::start_on(
            air,
            &[
                "-c",
                &config.display().to_string(),
                "-l",
                "tcp/127.0.0.1:0",
                "-l",
                &format!("ble/sim-wombat-{number}#name=wombat-{number}"),
                "--cfg",
                &format!("plugins/rect:{settings}"),
            ],
        );
        let endpoint = router.listener();
        router.up();
        Self {
            router,
            endpoint,
            file,
        }
    }

    fn port(&self) -> u64 {
        let (_, port) = self.endpoint.rsplit_once(':').expect("a port");
        port.parse().expect("a number")
    }

    /// As an editor or a careful program would: a new file in the place of the old one.
    fn write(&self, connections: &Value) {
        let new = self.file.with_extension("new");
        fs::write(&new, connections.to_string()).expect("written");
        fs::rename(&new, &self.file).expect("renamed");
    }
}

fn file(connections: &[Value]) -> Value {
    json!({ "connections": connections })
}

fn tcp(name: &str, port: u64) -> Value {
    json!({ "name": name, "method": "tcp", "address": "127.0.0.1", "port": port })
}

fn ble(name: &str, robot: &str) -> Value {
    json!({ "name": name, "method": "ble", "address": robot })
}

fn connected(answer: &Value) -> usize {
    let all = answer.as_array().expect("a list");
    all.iter().filter(|one| one["state"] == "connected").count()
}

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
    let here = client(&one.endpoint);
    let registry = "rect/wombat-1/@rect";
    let by_name = |name: &str| format!("{registry}/connections?name={name}");
    let is_known =
        |answer: &Value| connected(answer) == 1 && answer[0]["peer"]["robot"].is_string();

    // All available connections, those of one name, those of one method.
    let radio = answers(&here, &by_name("radio"), is_known);
    assert_eq!(radio[0]["peer"]["robot"], "wombat-2", "{radio:#}");
    assert_eq!(radio[0]["address"], "wombat-2", "{radio:#}");
    assert!(radio[0]["sent"]["bytes"].as_u64() > Some(0), "{radio:#}");
    let base = answers(&here, &by_name("base"), is_known);
    assert_eq!(base[0]["peer"]["robot"], "wombat-3", "{base:#}");
    assert!(base[0]["received"]["bytes"].as_u64() > Some(0), "{base:#}");
    assert!(base[0]["up_s"].as_f64() > Some(0.0), "{base:#}");
    let nobody = answers(&here, &by_name("nobody"), |all| {
        all[0]["failed"].as_u64() > Some(0)
    });
    assert_eq!(nobody[0]["state"], "connecting", "{nobody:#}");
    assert!(nobody[0]["last_error"]["what"].is_string(), "{nobody:#}");
    let by_method = format!("{registry}/connections?method=ble;state=connected");
    let by_method = ask(&here, &by_method).expect("an answer");
    assert_eq!(by_method.as_array().map(Vec::len), Some(1), "{by_method:#}");
    assert!(by_method[0]["rssi_dbm"].is_i64(), "{by_method:#}");

    // Heard while wombat-9 is looked for, and not linked by radio.
    let discovered = format!("{registry}/connections?state=discovered");
    let discovered = answers(&here, &discovered, |all| all[0]["address"] == "wombat-3");
    assert_eq!(
        discovered.as_array().map(Vec::len),
        Some(1),
        "{discovered:#}"
    );
    assert!(discovered[0]["rssi_dbm"].is_i64(), "{discovered:#}");

    // How many of each method, and in total: this program is one more.
    let count = ask(&here, &format!("{registry}/connections/count")).expect("an answer");
    let expected = json!({ "total": 5, "connected": 3, "discovered": 1, "methods": {
        "ble": { "total": 2, "connected": 1, "discovered": 1 },
        "tcp": { "total": 3, "connected": 2, "discovered": 0 },
        "udp": { "total": 0, "connected": 0, "discovered": 0 },
    } });
    assert_eq!(count, expected);

    // All connections of one peer, the peers that have a given connection, those with more than one.
    let of_peer = ask(&here, &format!("{registry}/connections?peer=wombat-3")).expect("an answer");
    assert_eq!(of_peer[0]["name"], "base", "{of_peer:#}");
    let with = ask(&here, &format!("{registry}/peers?name=radio")).expect("an answer");
    assert_eq!(with[0]["robot"], "wombat-2", "{with:#}");
    let several = ask(&here, &format!("{registry}/peers?min_connections=2")).expect("an answer");
    assert_eq!(several, json!([]));

    check_docs(|query| ask(&here, &format!("rect/wombat-1/@rect/{query}")).expect("an answer"));

    // The other robots tell of the same links, under their own names.
    let of_two = "rect/wombat-2/@rect/connections?method=ble";
    let there = answers(&here, of_two, is_known);
    assert_eq!(there[0]["peer"]["robot"], "wombat-1", "{there:#}");
    assert_eq!(there[0]["name"], Value::Null, "{there:#}");
    drop(two);
}

/// What `docs/registry.md` shows: each of R9's questions, and its query.
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

/// The table in the docs is what the registry answers.
fn check_docs(ask: impl Fn(&str) -> Value) {
    let mut table = String::from("| question | query | answer |\n|---|---|---|\n");
    for (question, query) in QUESTIONS {
        let answer = in_short(&ask(query)).replace("\",\"", "\", \"");
        table += &format!("| {question} | `{query}` | `{answer}` |\n");
    }
    let path = repository().join("docs/registry.md");
    let docs = fs::read_to_string(&path).expect("the docs");
    let (begin, end) = ("<!-- questions -->\n", "<!-- /questions -->");
    let (before, rest) = docs.split_once(begin).expect("a beginning");
    let (shown, after) = rest.split_once(end).expect("an end");
    if std::env::var_os("RECT_UPDATE_DOCS").is_some() {
        fs::write(&path, format!("{before}{begin}{table}{end}{after}")).expect("written");
    } else {
        assert_eq!(shown, table, "RECT_UPDATE_DOCS=1 writes it anew");
    }
}

/// What does not differ from run to run, in the order of the fields.
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
fn a_robot_that_comes_into_the_air_is_published() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    // It listens to the air as it looks for somebody.
    let one = Wombat::start(&air, &folder, 1, &file(&[ble("away", "wombat-9")]));
    let here = client(&one.endpoint);
    let changes = here.declare_subscriber("rect/wombat-1/@rect/connections");
    let changes = changes.wait().expect("a subscription");
    let _three = Wombat::start(&air, &folder, 3, &file(&[]));
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "it is not told of");
        let sample = changes.recv_timeout(DEADLINE).expect("no session ends");
        let published = sample.expect("in time").payload().to_bytes().into_owned();
        let all: Vec<Value> = serde_json::from_slice(&published).expect("a list");
        // Told by the address until the radio knows its name.
        let is_it = |one: &&Value| one["state"] == "discovered" && one["address"] == "wombat-3";
        let Some(discovered) = all.iter().find(is_it) else {
            continue;
        };
        assert!(discovered["rssi_dbm"].is_i64(), "{discovered:#}");
        return;
    }
}

#[test]
fn a_changed_file_takes_effect_and_leaves_the_other_links_alone() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let three = Wombat::start(&air, &folder, 3, &file(&[]));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let one = Wombat::start(&air, &folder, 1, &file(&[ble("radio", "wombat-2")]));
    let (here, there) = (client(&one.endpoint), client(&two.endpoint));
    let third = client(&three.endpoint);
    let registry = "rect/wombat-1/@rect/connections";
    let changes = here
        .declare_subscriber(registry)
        .wait()
        .expect("a subscription");
    assert!(arrives(&here, &there, "rect/wombat-1/kept"));
    let kept = there
        .declare_subscriber("rect/wombat-1/number")
        .wait()
        .expect("a subscription");
    assert!(arrives(&here, &there, "rect/wombat-1/number"));
    let mut sent = 0_u32;
    let mut goes_on = || {
        here.put("rect/wombat-1/number", sent.to_le_bytes())
            .wait()
            .expect("a put");
        sent += 1;
    };
    let states = |wanted: &'static [(&str, &str)]| {
        move |answer: &Value| {
            let all = answer.as_array().expect("a list");
            let named: Vec<_> = all
                .iter()
                .filter_map(|one| Some((one["name"].as_str()?, one["state"].as_str()?)))
                .collect();
            named == wanted
        }
    };

    // Added,
    one.write(&file(&[
        ble("radio", "wombat-2"),
        tcp("base", three.port()),
    ]));
    goes_on();
    answers(
        &here,
        registry,
        states(&[("base", "connected"), ("radio", "connected")]),
    );
    assert!(arrives(&here, &third, "rect/wombat-1/added"));
    // changed to lead nowhere,
    goes_on();
    one.write(&file(&[ble("radio", "wombat-2"), tcp("base", 1)]));
    answers(
        &here,
        registry,
        states(&[("base", "connecting"), ("radio", "connected")]),
    );
    answers(
        &third,
        "rect/wombat-3/@rect/connections/count?peer=wombat-1",
        |count| count["total"] == 0,
    );
    // wrong,
    goes_on();
    fs::write(&one.file, "{ \"connections\": [\n  { \"name\": ").expect("written");
    let mut one = one;
    let said = one.router.wait_for("connections-1.json:2:");
    assert!(said.contains("the connections stay as they were"), "{said}");
    answers(
        &here,
        registry,
        states(&[("base", "connecting"), ("radio", "connected")]),
    );
    // and removed.
    goes_on();
    one.write(&file(&[ble("radio", "wombat-2")]));
    answers(&here, registry, states(&[("radio", "connected")]));
    goes_on();

    for number in 0..sent {
        let arrived = loop {
            let sample = kept
                .recv_timeout(support::DEADLINE)
                .expect("no session ends");
            let payload = sample.expect("in time").payload().to_bytes().into_owned();
            // Not one of `arrives`.
            if let Ok(bytes) = payload.try_into() {
                break u32::from_le_bytes(bytes);
            }
        };
        assert_eq!(arrived, number, "a link that nobody changed lost a message");
    }
    let link = ask(&here, &format!("{registry}?name=radio")).expect("an answer");
    assert_eq!(link[0]["linked"], 1, "{link:#}");
    assert!(
        changes.try_recv().expect("open").is_some(),
        "changes are published"
    );
}

#[test]
fn a_wrong_file_or_question_is_told_and_the_router_runs_on() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let many: Vec<_> = (0..10_000)
        .map(|n| ble(&format!("r{n}"), &format!("r{n}")))
        .collect();
    let mut one = Wombat::start(&air, &folder, 1, &file(&many));
    let here = client(&one.endpoint);
    let log = one.router.drained().join("\n");
    assert!(
        log.contains("one connection too many: there may be 4"),
        "{log}"
    );
    let registry = "rect/wombat-1/@rect/connections";
    for (question, named) in [
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
        let error = ask(&here, &question).expect_err("wrong");
        assert!(error.contains(named), "{question}: {error}");
    }
    // A robot's connection with itself is a mistake where its name says so, and made by nobody elsewhere.
    one.write(&file(&[ble("b", "wombat-2"), ble("me", "wombat-1")]));
    one.router.wait_for("me leads to this robot itself");
    let own = one.port();
    one.write(&file(&[ble("b", "wombat-2"), tcp("self", own)]));
    let of_itself = answers(&here, &format!("{registry}?name=self"), |all| {
        all[0]["linked"].as_u64().max(all[0]["failed"].as_u64()) > Some(1)
    });
    assert_eq!(of_itself[0]["state"], "connecting", "{of_itself:#}");
    answers(&here, &format!("{registry}?name=b"), |all| {
        all.as_array().map(Vec::len) == Some(1)
    });
}

/// Asks with a payload, as a change is asked for.
fn change(session: &Session, selector: &str, text: &str) -> Result<Value, String> {
    let replies = session.get(selector).payload(text).wait().expect("a query");
    let reply = replies.into_iter().next().expect("an answer");
    match reply.into_result() {
        Ok(sample) => Ok(serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")),
        Err(error) => Err(String::from_utf8_lossy(&error.payload().to_bytes()).into_owned()),
    }
}

#[test]
fn connections_are_read_and_changed_by_a_query_from_another_robot() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let mut one = Wombat::start(&air, &folder, 1, &file(&[ble("radio", "wombat-2")]));
    let there = client(&two.endpoint);
    let key = "rect/wombat-1/@rect/@config/connections";
    let before = ask(&there, key).expect("an answer");
    assert!(
        before["text"]
            .as_str()
            .is_some_and(|text| text.contains("radio")),
        "{before:#}"
    );
    let revision = before["revision"].as_str().expect("a revision");

    let wanted = format!(
        "// by query\n{}",
        file(&[ble("radio", "wombat-2"), tcp("base", 1)])
    );
    let changed = change(
        &there,
        &format!("{key}?expect={revision};by=wombat-2"),
        &wanted,
    );
    let changed = changed.expect("changed");
    assert_eq!(changed["added"], json!(["base"]), "{changed:#}");
    one.router
        .wait_for("the connections are changed by wombat-2: added base");
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), wanted);
    let registry = "rect/wombat-1/@rect/connections?name=base";
    answers(&there, registry, |all| all[0]["state"] == "connecting");

    // What it does by itself, too.
    let here = client(&one.endpoint);
    let rule = "{\"auto_connect\": \"fleet\", \"auto_links\": 1, \"connections\": []}";
    let changed_rule = change(&here, key, rule).expect("changed");
    assert_eq!(changed_rule["rule_changed"], true, "{changed_rule:#}");
    let status = answers(&here, "rect/wombat-1/@rect/status", |status| {
        status["auto_connect"] == "fleet"
    });
    assert_eq!(status["auto_links"], 1, "{status:#}");
    // It had a link with wombat-2 by name, and has one with it as one of the fleet now.
    let linked = "rect/wombat-1/@rect/connections?method=ble;peer=wombat-2";
    let linked = answers(&here, linked, |all| {
        all[0]["name"].is_null() && connected(all) == 1
    });
    assert_eq!(linked.as_array().map(Vec::len), Some(1), "{linked:#}");
    let back = change(&here, key, &wanted).expect("changed");
    assert_eq!(back["added"], json!(["radio", "base"]), "{back:#}");
    // By its name again, whoever dialled.
    let radio = "rect/wombat-1/@rect/connections?name=radio";
    let radio = answers(&here, radio, |all| all[0]["peer"]["robot"] == "wombat-2");
    assert!(radio[0]["sent"]["bytes"].as_u64() > Some(0), "{radio:#}");
    assert!(radio[0]["up_s"].as_f64() > Some(0.0), "{radio:#}");
    ask(&there, key).expect("is asked by radio again");

    // A second one who has read the same, nonsense, and what is too much: nothing changes.
    let outdated = change(
        &there,
        &format!("{key}?expect={revision}"),
        "{\"connections\": []}",
    );
    assert!(outdated.is_err_and(|e| e.contains(changed["revision"].as_str().expect("text"))));
    let wrong = change(&there, key, "{\"connections\": [\n  {\"name\": \"a\"}]}");
    assert!(wrong.is_err_and(|e| e.contains("2:3: method is missing")));
    let blanks = " ".repeat(2 << 20);
    let too_much = change(&client(&one.endpoint), key, &blanks);
    assert!(too_much.is_err_and(|e| e.contains("more than 1048576 bytes")));
    let unknown = change(&there, &format!("{key}?expects=1"), "{\"connections\": []}");
    assert!(unknown.is_err_and(|e| e.contains("`expects` is unknown")));
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), wanted);
}

#[test]
fn who_removes_or_changes_the_connection_he_comes_over_is_answered_first() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let one = Wombat::start(&air, &folder, 1, &file(&[]));
    let (here, there) = (client(&one.endpoint), client(&two.endpoint));
    let key = "rect/wombat-1/@rect/@config/connections";
    let is_then = |state: Option<&str>| {
        let asked = "rect/wombat-1/@rect/connections?name=way";
        answers(&here, asked, |all| all[0]["state"].as_str() == state);
    };
    for way in [ble("way", "wombat-2"), tcp("way", two.port())] {
        let before = file(std::slice::from_ref(&way)).to_string();
        for (after, told, then) in [
            (file(&[]), "removed", None),
            (file(&[tcp("way", 1)]), "changed", Some("connecting")),
        ] {
            change(&here, key, &before).expect("changed");
            is_then(Some("connected"));
            ask(&there, key).expect("the way is known");
            // The only way there is, and soon there is none.
            let answer = change(&there, key, &after.to_string());
            assert_eq!(answer.expect("changed")[told], json!(["way"]), "{way}");
            is_then(then);
            // This program is left.
            let of_two = "rect/wombat-2/@rect/connections/count";
            answers(&there, of_two, |count| count["connected"] == 1);
        }
    }
}

#[test]
fn robots_of_a_fleet_link_by_themselves_and_with_no_other() {
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
fn a_router_killed_while_its_connections_are_changed_leaves_the_old_file_or_the_new_one() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let key = "rect/wombat-1/@rect/@config/connections";
    // Large enough to be killed in the middle of.
    let text = |name: &str| {
        let comment = format!("// {}\n", name.repeat(100_000));
        comment + &file(&[ble(name, name)]).to_string()
    };
    let texts = [text("a"), text("b")];
    for round in 0..10 {
        let one = Wombat::start(&air, &folder, 1, &file(&[]));
        let (path, here) = (one.file.clone(), client(&one.endpoint));
        let new = texts.clone();
        let changing = thread::spawn(move || {
            // Until nobody answers any more.
            for text in new.iter().cycle() {
                let replies = here.get(key).payload(text.as_str());
                let replies = replies.timeout(Duration::from_secs(1)).wait();
                if !replies.is_ok_and(|replies| replies.recv().is_ok()) {
                    return;
                }
            }
        });
        while !texts.contains(&fs::read_to_string(&path).expect("the file")) {
            thread::yield_now();
        }
        // At another moment of a change each time.
        thread::sleep(Duration::from_millis(3 * round));
        drop(one);
        changing.join().expect("no panic");
        let left = fs::read_to_string(&path).expect("the file");
        assert!(texts.contains(&left), "round {round}: {} bytes", left.len());
    }
}

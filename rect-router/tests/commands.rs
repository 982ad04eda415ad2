//! What rect-router does beside being a router: `cargo test -p rect-router --test commands`

mod support;

use std::{
    fs,
    io::{BufRead, BufReader},
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Child, Command, Stdio},
};

use serde_json::{json, Value};
use support::{answers, client, init, program, rect_router, said, simulated, start, Air};
use zenoh::{Session, Wait};
use zenoh_link::ble::radio::sim::SOCKET_VARIABLE;

#[test]
fn robots_of_one_login_find_each_other_and_another_teams_gets_no_link() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = init(root.path(), "wombat-1", &[]);
    let two = init(
        root.path(),
        "wombat-2",
        &["--users", &format!("{one}/users")],
    );
    let stranger = init(root.path(), "wombat-9", &[]);
    let dial =
        json!({ "connections": [{ "name": "first", "method": "ble", "address": "wombat-1" }] });
    for folder in [&two, &stranger] {
        fs::write(format!("{folder}/connections.json"), dial.to_string()).expect("written");
    }
    let (_one, here) = start(&air, &one, "wombat-1", "fleet");
    let (_two, there) = start(&air, &two, "wombat-2", "fleet");
    let (_stranger, elsewhere) = start(&air, &stranger, "wombat-9", "fleet");

    let state = |session: &Session, robot: &str, wanted: &str| {
        let asked = format!("rect/{robot}/@rect/connections?name=first");
        answers(session, &asked, |answer| answer[0]["state"] == wanted)
    };
    state(&program(&two, &there), "wombat-2", "connected");
    // The stranger's gets no further than its proof, again and again.
    let asked = "rect/wombat-9/@rect/connections?name=first";
    let refused = answers(&program(&stranger, &elsewhere), asked, |answer| {
        answer[0]["failed"].as_u64() > Some(1)
    });
    assert_eq!(refused[0]["linked"], 0, "{refused:#}");
    let why = refused[0]["last_error"]["what"].as_str();
    assert!(
        why.is_some_and(|why| why.contains("did not prove that it has the same secret")),
        "{refused:#}"
    );
    let of_one = "rect/wombat-1/@rect/peers";
    let peers = answers(&program(&one, &here), of_one, |answer| !answer[0].is_null());
    let robots: Vec<_> = peers
        .as_array()
        .into_iter()
        .flatten()
        .map(|peer| &peer["robot"])
        .collect();
    assert!(
        robots.contains(&&json!("wombat-2")) && !robots.contains(&&json!("wombat-9")),
        "{peers:#}"
    );

    // Access control lets the fleet ask about topics.
    let topics = "rect/wombat-1/@rect/topics?measure";
    answers(&program(&two, &there), topics, |answer| {
        answer["topics"].is_array()
    });

    // Who is in the air at all, and of whose team.
    let mut scan = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    scan.args(["scan", "--adapter", "sim-scan", "--seconds", "2", "--json"]);
    let scan = scan.env(SOCKET_VARIABLE, air.socket()).output();
    let scan = scan.expect("it starts");
    let heard: Value = serde_json::from_slice(&scan.stdout).unwrap_or_default();
    let heard = heard.as_array().cloned().unwrap_or_default();
    assert_eq!(heard.len(), 3, "{}", said(&scan));
    assert!(
        heard.iter().all(|robot| robot["fleet"] == "rect"),
        "{heard:?}"
    );

    // The same in a terminal.
    let table = rect_router(&[
        "connections",
        "--router",
        &there,
        "--users",
        &format!("{two}/users"),
    ]);
    let shown = said(&table);
    assert!(
        table.status.success() && shown.contains("wombat-2"),
        "{shown}"
    );
    let row = shown
        .lines()
        .find(|line| line.contains("first"))
        .expect("a row");
    assert!(
        row.contains("connected") && row.contains("wombat-1"),
        "{row}"
    );
    let users = format!("{two}/users");
    let ask = ["--router", &there, "--users", &users];
    let status = rect_router(&[&["status"], &ask[..]].concat());
    let shown = said(&status);
    let row = shown.lines().find(|line| line.contains("wombat-2"));
    assert!(row.is_some_and(|row| row.contains("1 ble")), "{shown}");
    let status = rect_router(&[&["status", "--json", "wombat-1"], &ask[..]].concat());
    let status: Value = serde_json::from_slice(&status.stdout).expect("JSON");
    assert_eq!(
        status["wombat-1"]["connections"]["methods"]["ble"]["connected"],
        1
    );
    let nobody = rect_router(&[&["status", "wombat-7"], &ask[..]].concat());
    assert!(said(&nobody).contains("no robot wombat-7 of fleet rect answers"));
    let doctor = rect_router(&[
        "doctor",
        "--json",
        "--router",
        &there,
        "--users",
        &format!("{two}/users"),
    ]);
    let findings: Value = serde_json::from_slice(&doctor.stdout).expect("JSON");
    let router = findings
        .as_array()
        .into_iter()
        .flatten()
        .find(|one| one["about"] == "router");
    assert_eq!(
        router.expect("looked at")["verdict"],
        "good",
        "{findings:#}"
    );
}

#[test]
fn what_is_there_already_is_not_touched_and_secrets_are_private() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = init(root.path(), "wombat-1", &["--fleet", "lions"]);
    let users = format!("{folder}/users");
    let mode = fs::metadata(&users).expect("there").permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    let before = fs::read_to_string(&users).expect("there");
    assert!(
        before.starts_with("fleet:") && before.trim().lines().all(|line| line.len() > 24),
        "{}",
        before.len()
    );
    let config = fs::read_to_string(format!("{folder}/robot.json5")).expect("there");
    assert!(
        config.contains("\"lions/**\"") && !config.contains("\"rect/"),
        "{config}"
    );
    let loaded = zenoh::Config::from_file(format!("{folder}/robot.json5")).expect("valid");
    assert!(loaded.to_string().contains("lions/*/@rect/**"));

    let again = rect_router(&["init", "wombat-1", "--folder", &folder]);
    assert!(!again.status.success() && said(&again).contains("is there already"));
    assert_eq!(fs::read_to_string(&users).expect("there"), before);
    for (wrong, named) in [
        ("a b", "' '"),
        ("", "1 to 29"),
        ("hci0", "adapter"),
        ("**", "'*'"),
    ] {
        let folder = root.path().join("wrong").display().to_string();
        let output = rect_router(&["init", wrong, "--folder", &folder]);
        assert!(
            !output.status.success() && said(&output).contains(named),
            "{wrong}"
        );
        assert!(!Path::new(&folder).exists(), "{wrong}");
    }
}

#[test]
fn a_configuration_is_checked_without_starting_anything() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = init(root.path(), "wombat-1", &[]);
    let (config, connections) = (
        format!("{folder}/robot.json5"),
        format!("{folder}/connections.json"),
    );
    let right = rect_router(&["check", &config]);
    assert!(right.status.success(), "{}", said(&right));
    let was = fs::read_to_string(&config).expect("there");
    for (wrong, named) in [
        (was.replace("listen: {", "listen: ?{"), "robot.json5"),
        (
            was.replace("login_as: \"fleet\"", "login_as: \"nobody\""),
            "nobody",
        ),
        (
            was.replace("ble/sim-wombat-1#", "ble/sim-wombat-1#psm=x;"),
            "psm",
        ),
    ] {
        assert_ne!(wrong, was, "{named}");
        fs::write(&config, wrong).expect("written");
        let output = rect_router(&["check", &config]);
        assert!(
            !output.status.success() && said(&output).contains(named),
            "{}",
            said(&output)
        );
    }
    fs::write(&config, was).expect("written");
    fs::write(&connections, "{ \"connections\": [ { } ] }").expect("written");
    let output = rect_router(&["check", &config]);
    assert!(
        !output.status.success() && said(&output).contains("connections.json"),
        "{}",
        said(&output)
    );
}

#[test]
fn who_has_no_service_is_not_told_that_it_starts() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = root.path().join("etc").display().to_string();
    let output = rect_router(&["init", "wombat-1", "--folder", &folder, "--start"]);
    assert!(
        !output.status.success() && said(&output).contains("install the package"),
        "{}",
        said(&output)
    );
    assert!(!Path::new(&folder).exists());
}

#[test]
fn there_are_manual_pages_and_completions() {
    let folder = tempfile::tempdir().expect("a folder");
    let written = rect_router(&["man", &folder.path().display().to_string()]);
    assert!(written.status.success(), "{}", said(&written));
    let page = fs::read_to_string(folder.path().join("rect-router-init.1")).expect("a page");
    assert!(
        page.contains("Write a robot") && page.contains("fleet"),
        "{page}"
    );
    let page = fs::read_to_string(folder.path().join("rect-router.1")).expect("a page");
    for told in [&page, &said(&rect_router(&["--help"]))] {
        assert!(
            told.contains("Exit status") && told.contains("143"),
            "{told}"
        );
    }
    let completion = rect_router(&["completion", "bash"]);
    assert!(said(&completion).contains("--login-as"));
    let nowhere = rect_router(&["man", "/nowhere/at/all"]);
    assert!(!nowhere.status.success() && said(&nowhere).contains("/nowhere/at/all"));
}

#[test]
fn the_doctor_looks_at_the_named_router_with_the_named_login() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let folder = init(root.path(), "wombat-1", &[]);
    let (_router, endpoint) = start(&air, &folder, "wombat-1", "fleet");
    let users = format!("{folder}/users");
    let doctor = |more: &[&str], users: &str| {
        let at = ["doctor", "--router", &endpoint, "--users", users];
        rect_router(&[&at, more].concat())
    };
    let well = said(&doctor(&[], &users));
    for line in [
        "good   login: ",
        "good   router: ",
        "publish as wombat-1",
        "good   connections: ",
    ] {
        assert!(well.contains(line), "{line}: {well}");
    }
    let right = said(&doctor(&["--as", "wombat-1"], &users));
    assert!(right.contains("good   robot: "), "{right}");
    let wrong = doctor(&["--as", "wombat-7"], &users);
    let text = said(&wrong);
    assert_eq!(wrong.status.code(), Some(1), "{text}");
    assert!(
        text.contains("WRONG  robot: ") && text.contains("of wombat-1, not of wombat-7"),
        "{text}"
    );

    let other = root.path().join("other");
    fs::write(&other, "fleet:not the password\n").expect("written");
    let refused = doctor(&[], &other.display().to_string());
    let text = said(&refused);
    assert_eq!(refused.status.code(), Some(1), "{text}");
    assert!(text.contains("refuses the login fleet of"), "{text}");
    let table = rect_router(&[
        "status",
        "--router",
        &endpoint,
        "--users",
        &other.display().to_string(),
    ]);
    assert!(
        said(&table).contains("refuses the login fleet of"),
        "{}",
        said(&table)
    );
    let without = said(&doctor(&[], "/nowhere/users"));
    assert!(
        without.contains("refuses programs without a login"),
        "{without}"
    );

    fs::write(
        format!("{folder}/connections.json"),
        "{ \"connections\": [ { } ] }",
    )
    .expect("written");
    let mistaken = doctor(&[], &users);
    let text = said(&mistaken);
    assert_eq!(mistaken.status.code(), Some(1), "{text}");
    assert!(text.contains("rejects its connections file: 1:"), "{text}");
}

#[test]
fn what_a_robot_reports_cannot_control_the_terminal() {
    let air = Air::new();
    let (mut router, endpoint) = simulated(&air, 1, &[]);
    router.up();
    let evil = client(&endpoint);
    let answer = |key: &'static str, json: serde_json::Value| {
        let reply = move |query: zenoh::query::Query| {
            query.reply(key, json.to_string()).wait().expect("answered");
        };
        evil.declare_queryable(key)
            .callback(reply)
            .background()
            .wait()
            .expect("declared");
    };
    let hostile = "v\x1b]0;pwned\x07\x1b[2J\u{202e}\nwombat-9";
    answer(
        "rect/evil/@rect/status",
        json!({ "id": "1", "version": hostile, "connections": {} }),
    );
    let error = json!({ "what": hostile, "ago_s": 1.0 });
    let connection = json!([{ "name": hostile, "method": "tcp", "address": hostile, "state": "connecting", "last_error": error }]);
    answer("rect/evil/@rect/connections", connection);
    for command in ["status", "connections", "doctor"] {
        let shown = said(&rect_router(&[command, "--router", &endpoint]));
        assert!(shown.contains("evil"), "{command}: {shown}");
        assert!(
            !shown.contains(['\x1b', '\x07', '\u{202e}']),
            "{command}: {shown:?}"
        );
        assert!(
            !shown
                .lines()
                .any(|line| line.trim_start().starts_with("wombat-9")),
            "{command}: {shown:?}"
        );
    }
    let json = said(&rect_router(&["status", "--json", "--router", &endpoint]));
    assert!(!json.contains('\u{202e}'), "{json:?}");
    let read: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(read["evil"]["version"], hostile);
}

#[test]
fn a_reader_that_has_gone_ends_a_command_quietly() {
    let full = || fs::File::create("/dev/full").expect("linux");
    for args in [
        &["doctor", "--router", "tcp/127.0.0.1:1"][..],
        &["completion", "bash"],
        &["doctor", "--json"],
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
            .args(args)
            .stdout(full())
            .output();
        let output = output.expect("it starts");
        let text = said(&output);
        assert_eq!(output.status.code(), Some(1), "{args:?}: {text}");
        assert!(
            text.contains("cannot write") && !text.contains("panicked"),
            "{args:?}: {text}"
        );
    }
    let status = Command::new(env!("CARGO_BIN_EXE_rect-router"))
        .args(["status", "--router", "tcp/127.0.0.1:1"])
        .stderr(full())
        .status();
    assert_eq!(status.expect("it starts").code(), Some(1));
}

#[test]
fn simulated_robots_can_be_asked_at_once_and_end_with_their_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut sim = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    sim.args(["sim", "--port", "0", "--condition", "desk"]);
    let sim = sim.env(SOCKET_VARIABLE, folder.path().join("air.sock"));
    let mut sim = Killed(sim.stdout(Stdio::piped()).spawn().expect("it starts"));
    let lines = BufReader::new(sim.0.stdout.take().expect("piped")).lines();
    let shown: Vec<_> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.contains("Ctrl-C"))
        .collect();
    let endpoint = |robot: &str| {
        let row = shown
            .iter()
            .find(|line| line.starts_with(robot))
            .unwrap_or_else(|| panic!("{shown:#?}"));
        row.split_whitespace()
            .last()
            .expect("an endpoint")
            .to_owned()
    };
    let (one, two) = (endpoint("wombat-1"), endpoint("wombat-2"));
    let status = said(&rect_router(&["status", "--router", &one]));
    for robot in ["wombat-1", "wombat-2"] {
        let row = status.lines().find(|line| line.starts_with(robot));
        assert!(row.is_some_and(|row| row.contains("1 ble")), "{status}");
    }
    let session = client(&two);
    let battery = support::ask(&session, "rect/wombat-1/battery").expect("an answer over the air");
    assert_eq!(battery["percent"], 83);

    let id = nix::unistd::Pid::from_raw(i32::try_from(sim.0.id()).expect("an id"));
    nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGINT).expect("it runs");
    assert!(sim.0.wait().expect("our child").success());
    for endpoint in [one, two] {
        let address = endpoint.trim_start_matches("tcp/");
        assert!(
            std::net::TcpStream::connect(address).is_err(),
            "{address} still answers"
        );
    }
    assert!(!folder.path().join("air.sock").exists());
}

/// A command that is ended with its test.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn without_a_router_the_doctor_and_the_table_say_so() {
    let nowhere = ["--router", "tcp/127.0.0.1:1"];
    let doctor = rect_router(&["doctor", nowhere[0], nowhere[1]]);
    assert_eq!(doctor.status.code(), Some(1));
    let text = said(&doctor);
    assert!(
        text.contains("WRONG  router: no router answers at tcp/127.0.0.1:1"),
        "{text}"
    );
    let table = rect_router(&["connections", nowhere[0], nowhere[1]]);
    assert_eq!(table.status.code(), Some(1));
    assert!(
        said(&table).contains("no router answers"),
        "{}",
        said(&table)
    );
}

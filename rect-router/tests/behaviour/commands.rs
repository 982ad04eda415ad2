//! Tests of the commands of rect-router: `cargo test -p rect-router --test behaviour commands`

use std::{
    fs,
    io::{BufRead, BufReader},
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Child, Command, Stdio},
};

use crate::support::{answers, client, init, program, rect_router, simulated, start, text_of, Air};
use serde_json::{json, Value};
use zenoh::{Session, Wait};
use zenoh_link_ble_air::SOCKET_VARIABLE;

#[test]
fn robots_of_one_team_connect_and_a_robot_of_another_team_is_rejected() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = init(root.path(), "wombat-1", &[]);
    let two = init(
        root.path(),
        "wombat-2",
        &["--users", &format!("{one}/users")],
    );
    let foreign = init(root.path(), "wombat-9", &[]);
    let dial =
        json!({ "connections": [{ "name": "first", "method": "ble", "address": "wombat-1" }] });
    for folder in [&two, &foreign] {
        fs::write(format!("{folder}/connections.json"), dial.to_string()).expect("written");
    }
    let (_one, local) = start(&air, &one, "wombat-1", "fleet");
    let (_two, remote) = start(&air, &two, "wombat-2", "fleet");
    let (_foreign, elsewhere) = start(&air, &foreign, "wombat-9", "fleet");

    let state = |session: &Session, robot: &str, expected: &str| {
        let query = format!("rect/{robot}/@rect/connections?name=first");
        answers(session, &query, |answer| answer[0]["state"] == expected)
    };
    state(&program(&two, &remote), "wombat-2", "connected");
    // The robot of the other team is rejected at each attempt, because it cannot prove the secret.
    let query = "rect/wombat-9/@rect/connections?name=first";
    let refused = answers(&program(&foreign, &elsewhere), query, |answer| {
        answer[0]["failed"].as_u64() > Some(1)
    });
    assert_eq!(refused[0]["linked"], 0, "{refused:#}");
    let why = refused[0]["last_error"]["what"].as_str();
    assert!(
        why.is_some_and(|why| why.contains("did not prove that it has the same secret")),
        "{refused:#}"
    );
    // Both sides' doctors name the reason, and what to do about it.
    let doctor = |endpoint: &str, folder: &str| {
        let users = format!("{folder}/users");
        text_of(&rect_router(&[
            "doctor", "--router", endpoint, "--users", &users,
        ]))
    };
    for (endpoint, folder, expected) in [
        (
            &elsewhere,
            &foreign,
            "WRONG  peer: wombat-9 has no connection first",
        ),
        (&local, &one, " has asked for a link "),
    ] {
        let found = doctor(endpoint, folder);
        let found = found.split_whitespace().collect::<Vec<_>>().join(" ");
        let expected = expected.replace("  ", " ");
        assert!(
            found.contains(&expected)
                && found.contains("the same secret")
                && found.contains("give both the same login file"),
            "{found}"
        );
        // Nothing is wrong with the computer: its routers use the simulated air.
        assert!(found.contains("good adapter: "), "{found}");
    }
    let of_one = "rect/wombat-1/@rect/peers";
    let peers = answers(&program(&one, &local), of_one, |answer| {
        !answer[0].is_null()
    });
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

    // Access control lets the robots of the fleet query topics.
    let topics = "rect/wombat-1/@rect/topics";
    answers(&program(&two, &remote), topics, |answer| {
        answer["topics"].is_array()
    });

    // A scan shows all robots in range with their fleet.
    let mut scan = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    scan.args(["scan", "--adapter", "sim-scan", "--seconds", "2", "--json"]);
    let scan = scan.env(SOCKET_VARIABLE, air.socket()).output();
    let scan = scan.expect("it starts");
    let discovered: Value = serde_json::from_slice(&scan.stdout).unwrap_or_default();
    let discovered = discovered.as_array().cloned().unwrap_or_default();
    assert_eq!(discovered.len(), 3, "{}", text_of(&scan));
    assert!(
        discovered.iter().all(|robot| robot["fleet"] == "rect"),
        "{discovered:?}"
    );

    // The commands show the connections as tables.
    let table = rect_router(&[
        "connections",
        "--router",
        &remote,
        "--users",
        &format!("{two}/users"),
    ]);
    let shown = text_of(&table);
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
    let ask = ["--router", &remote, "--users", &users];
    let status = rect_router(&[&["status"], &ask[..]].concat());
    let shown = text_of(&status);
    let row = shown.lines().find(|line| line.contains("wombat-2"));
    assert!(row.is_some_and(|row| row.contains("1 ble")), "{shown}");
    let status = rect_router(&[&["status", "--json", "wombat-1"], &ask[..]].concat());
    let status: Value = serde_json::from_slice(&status.stdout).expect("JSON");
    assert_eq!(
        status["wombat-1"]["connections"]["methods"]["ble"]["connected"],
        1
    );
    let nobody = rect_router(&[&["status", "wombat-7"], &ask[..]].concat());
    assert!(text_of(&nobody).contains("no robot wombat-7 of the fleet rect answers"));
    let doctor = rect_router(&[
        "doctor",
        "--json",
        "--router",
        &remote,
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
        router.expect("a finding")["verdict"],
        "good",
        "{findings:#}"
    );
}

#[test]
fn init_keeps_existing_files_and_writes_private_secrets() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = init(root.path(), "wombat-1", &["--fleet", "lions"]);
    let users = format!("{folder}/users");
    let mode = fs::metadata(&users).expect("exists").permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    let before = fs::read_to_string(&users).expect("exists");
    assert!(
        before.starts_with("fleet:") && before.trim().lines().all(|line| line.len() > 24),
        "{}",
        before.len()
    );
    let config = fs::read_to_string(format!("{folder}/robot.json5")).expect("exists");
    assert!(
        config.contains("\"lions/**\"") && !config.contains("\"rect/"),
        "{config}"
    );
    let loaded = zenoh::Config::from_file(format!("{folder}/robot.json5")).expect("valid");
    assert!(loaded.to_string().contains("lions/*/@rect/**"));

    let again = rect_router(&["init", "wombat-1", "--folder", &folder]);
    assert!(!again.status.success() && text_of(&again).contains("already exists"));
    assert_eq!(fs::read_to_string(&users).expect("exists"), before);
    for (wrong, expected) in [
        ("a b", "' '"),
        ("", "1 to 29"),
        ("hci0", "adapter"),
        ("**", "'*'"),
    ] {
        let folder = root.path().join("wrong").display().to_string();
        let output = rect_router(&["init", wrong, "--folder", &folder]);
        assert!(
            !output.status.success() && text_of(&output).contains(expected),
            "{wrong}"
        );
        assert!(!Path::new(&folder).exists(), "{wrong}");
    }
}

#[test]
fn check_reports_invalid_configurations_without_starting_anything() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = init(root.path(), "wombat-1", &[]);
    let (config, connections) = (
        format!("{folder}/robot.json5"),
        format!("{folder}/connections.json"),
    );
    let right = rect_router(&["check", &config]);
    assert!(right.status.success(), "{}", text_of(&right));
    let was = fs::read_to_string(&config).expect("exists");
    for (wrong, expected) in [
        (was.replace("listen: {", "listen: ?{"), "robot.json5"),
        (
            was.replace("login_as: \"fleet\"", "login_as: \"nobody\""),
            "nobody",
        ),
        (
            was.replace("any/sim-wombat-1#", "any/sim-wombat-1#psm=x;"),
            "psm",
        ),
    ] {
        assert_ne!(wrong, was, "{expected}");
        fs::write(&config, wrong).expect("written");
        let output = rect_router(&["check", &config]);
        assert!(
            !output.status.success() && text_of(&output).contains(expected),
            "{}",
            text_of(&output)
        );
    }
    fs::write(&config, was).expect("written");
    fs::write(&connections, "{ \"connections\": [ { } ] }").expect("written");
    let output = rect_router(&["check", &config]);
    assert!(
        !output.status.success() && text_of(&output).contains("connections.json"),
        "{}",
        text_of(&output)
    );
}

#[test]
fn a_secret_that_is_easy_to_guess_is_rejected_before_the_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let users = folder.path().join("users");
    fs::write(&users, "fleet:1234\n").expect("written");
    let (path, made) = (users.display().to_string(), folder.path().join("made"));
    let made = made.display().to_string();
    let options = ["--adapter", "sim-1", "--folder", &made, "--users", &path];
    let refused = rect_router(&[&["init", "wombat-1"], &options[..]].concat());
    assert_eq!(refused.status.code(), Some(1));
    let text = text_of(&refused);
    assert!(text.contains("has 4 bytes after the user's name"), "{text}");
    assert!(!Path::new(&made).exists());

    fs::write(&users, "fleet:0123456789abcdef\n").expect("written");
    let written = rect_router(&[&["init", "wombat-1"], &options[..]].concat());
    assert!(written.status.success(), "{}", text_of(&written));
    let config = format!("{made}/robot.json5");
    let checked = rect_router(&["check", &config]);
    assert!(checked.status.success(), "{}", text_of(&checked));
    fs::write(format!("{made}/users"), "fleet:1234\n").expect("written");
    for arguments in [&["check", config.as_str()][..], &["-c", &config]] {
        let refused = rect_router(arguments);
        assert_eq!(refused.status.code(), Some(1), "{arguments:?}");
        let text = text_of(&refused);
        assert!(text.contains("has 4 bytes after the user's name"), "{text}");
    }
    // An adapter that is not there is no error, since it can be plugged in later.
    let config = fs::read_to_string(&config)
        .expect("text")
        .replace("any/sim-1", "any/hci77");
    let other = format!("{made}/other.json5");
    fs::write(&other, config).expect("written");
    fs::write(format!("{made}/users"), "fleet:0123456789abcdef\n").expect("written");
    let checked = rect_router(&["check", &other]);
    assert!(checked.status.success(), "{}", text_of(&checked));
    let text = text_of(&checked);
    assert!(
        text.contains("warning: any/hci77: there is no Bluetooth adapter hci77"),
        "{text}"
    );
}

#[test]
fn init_with_start_fails_without_an_installed_service() {
    let root = tempfile::tempdir().expect("a folder");
    let folder = root.path().join("etc").display().to_string();
    let output = rect_router(&["init", "wombat-1", "--folder", &folder, "--start"]);
    assert!(
        !output.status.success() && text_of(&output).contains("install the package"),
        "{}",
        text_of(&output)
    );
    assert!(!Path::new(&folder).exists());
}

#[test]
fn writes_manual_pages_and_completions() {
    let folder = tempfile::tempdir().expect("a folder");
    let written = rect_router(&["man", &folder.path().display().to_string()]);
    assert!(written.status.success(), "{}", text_of(&written));
    let page = fs::read_to_string(folder.path().join("rect-router-init.1")).expect("a page");
    assert!(
        page.contains("Write a robot") && page.contains("fleet"),
        "{page}"
    );
    let page = fs::read_to_string(folder.path().join("rect-router.1")).expect("a page");
    for text in [&page, &text_of(&rect_router(&["--help"]))] {
        assert!(
            text.contains("Exit status") && text.contains("143"),
            "{text}"
        );
    }
    let completion = rect_router(&["completion", "bash"]);
    assert!(text_of(&completion).contains("--login-as"));
    let nowhere = rect_router(&["man", "/dev/null/at/all"]);
    assert!(!nowhere.status.success() && text_of(&nowhere).contains("/dev/null/at/all"));
    // `rect` executes it for the pages of its commands that this program implements. The folder is created.
    let pages = folder.path().join("share/man1");
    let mut rect = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    std::os::unix::process::CommandExt::arg0(&mut rect, "rect");
    let written = rect.arg("man").arg(&pages).output().expect("it starts");
    assert!(written.status.success(), "{}", text_of(&written));
    let page = fs::read_to_string(pages.join("rect-sim.1")).expect("a page");
    assert!(
        page.contains("rect sim") && page.contains("robots") && page.contains("wifi"),
        "{page}"
    );
    let written = fs::read_dir(&pages).expect("a folder");
    assert_eq!(written.count(), 4);
}

#[test]
fn doctor_examines_the_given_router_with_the_given_login() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let folder = init(root.path(), "wombat-1", &[]);
    let (_router, endpoint) = start(&air, &folder, "wombat-1", "fleet");
    let users = format!("{folder}/users");
    let doctor = |more: &[&str], users: &str| {
        let at = ["doctor", "--router", &endpoint, "--users", users];
        rect_router(&[&at, more].concat())
    };
    let well = text_of(&doctor(&[], &users));
    for line in [
        "good   login: ",
        "good   router: ",
        "publish as wombat-1",
        "good   connections: ",
    ] {
        assert!(well.contains(line), "{line}: {well}");
    }
    let right = text_of(&doctor(&["--as", "wombat-1"], &users));
    assert!(right.contains("good   robot: "), "{right}");
    let wrong = doctor(&["--as", "wombat-7"], &users);
    let text = text_of(&wrong);
    assert_eq!(wrong.status.code(), Some(1), "{text}");
    assert!(
        text.contains("WRONG  robot: ") && text.contains("of wombat-1, not of wombat-7"),
        "{text}"
    );

    let other = root.path().join("other");
    fs::write(&other, "fleet:not the password\n").expect("written");
    let refused = doctor(&[], &other.display().to_string());
    let text = text_of(&refused);
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
        text_of(&table).contains("refuses the login fleet of"),
        "{}",
        text_of(&table)
    );
    let without = text_of(&doctor(&[], "/nowhere/users"));
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
    let text = text_of(&mistaken);
    assert_eq!(mistaken.status.code(), Some(1), "{text}");
    assert!(text.contains("rejects its connections file: 1:"), "{text}");
}

#[test]
fn control_characters_of_a_robot_do_not_reach_the_terminal() {
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
        let shown = text_of(&rect_router(&[command, "--router", &endpoint]));
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
    let json = text_of(&rect_router(&["status", "--json", "--router", &endpoint]));
    assert!(!json.contains('\u{202e}'), "{json:?}");
    let read: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(read["evil"]["version"], hostile);
}

#[test]
fn a_failed_write_to_stdout_ends_a_command_without_a_panic() {
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
        let text = text_of(&output);
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
fn simulated_robots_answer_at_once_and_end_with_their_command() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut sim = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    sim.args(["sim", "--port", "0", "--condition", "desk"]);
    let sim = sim.env(SOCKET_VARIABLE, folder.path().join("air.sock"));
    let mut sim = RunningCommand(sim.stdout(Stdio::piped()).spawn().expect("it starts"));
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
    let status = text_of(&rect_router(&["status", "--router", &one]));
    for robot in ["wombat-1", "wombat-2"] {
        let row = status.lines().find(|line| line.starts_with(robot));
        assert!(row.is_some_and(|row| row.contains("1 ble")), "{status}");
    }
    let session = client(&two);
    let battery =
        crate::support::ask(&session, "rect/wombat-1/battery").expect("an answer over the air");
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

#[test]
fn eight_simulated_robots_start_at_the_same_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut sim = Command::new(env!("CARGO_BIN_EXE_rect-router"));
    sim.args(["sim", "--robots", "8", "--port", "0", "--wifi", "--quiet"]);
    let sim = sim.env(SOCKET_VARIABLE, folder.path().join("air.sock"));
    let mut sim = RunningCommand(sim.stdout(Stdio::piped()).spawn().expect("it starts"));
    let lines = BufReader::new(sim.0.stdout.take().expect("piped")).lines();
    let shown: Vec<_> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.contains("Ctrl-C"))
        .collect();
    // It ends its routers; one that is killed would leave them.
    let id = nix::unistd::Pid::from_raw(i32::try_from(sim.0.id()).expect("an id"));
    let _ = nix::sys::signal::kill(id, nix::sys::signal::Signal::SIGINT);
    sim.0.wait().expect("our child");
    let robots = shown.iter().filter(|line| line.starts_with("wombat-"));
    assert_eq!(robots.count(), 8, "{shown:#?}");
}

/// A command that is killed at the end of its test.
struct RunningCommand(Child);

impl Drop for RunningCommand {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn doctor_and_connections_report_a_missing_router() {
    let nowhere = ["--router", "tcp/127.0.0.1:1"];
    let doctor = rect_router(&["doctor", nowhere[0], nowhere[1]]);
    assert_eq!(doctor.status.code(), Some(1));
    let text = text_of(&doctor);
    assert!(
        text.contains("WRONG  router: no router answers at tcp/127.0.0.1:1"),
        "{text}"
    );
    let table = rect_router(&["connections", nowhere[0], nowhere[1]]);
    assert_eq!(table.status.code(), Some(1));
    assert!(
        text_of(&table).contains("no router answers"),
        "{}",
        text_of(&table)
    );
}

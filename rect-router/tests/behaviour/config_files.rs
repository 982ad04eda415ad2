//! Tests of the files in `config/`: they load, and require a login: `cargo test -p rect-router --test behaviour config_files`

use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use crate::support::{
    admin, answers, arrives, client_with, login_file, repository, Air, Router, AS_ROBOTS, DEADLINE,
};
use serde_json::{json, Value};
use zenoh::{Session, Wait};

const WITH_LOGIN: [&str; 2] = ["robot.json5", "base-station.json5"];

fn file(name: &str) -> String {
    repository().join("config").join(name).display().to_string()
}

/// Returns the file as a configuration of Zenoh.
fn loaded(name: &str) -> Value {
    let config =
        zenoh::Config::from_file(file(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    serde_json::to_value(&config).expect("JSON")
}

#[test]
fn all_files_load() {
    let mut names: Vec<String> = fs::read_dir(repository().join("config"))
        .expect("the directory")
        .map(|entry| {
            entry
                .expect("an entry")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .filter(|name| name.ends_with(".json5"))
        .collect();
    names.sort();
    assert_eq!(
        names,
        [
            "base-station.json5",
            "cloud.json5",
            "robot.json5",
            "simulation.json5"
        ]
    );
    for name in names {
        assert_eq!(loaded(&name)["mode"], "router", "{name}");
    }
}

#[test]
fn commented_examples_for_a_slow_link_are_valid() {
    for name in ["robot.json5", "base-station.json5"] {
        let text = fs::read_to_string(file(name)).expect("readable");
        // An example is a comment that is a line of JSON5: it begins or ends with a bracket, or is indented.
        let is_example = |line: &str| {
            let first = line.starts_with(['{', '}', ']']) || line.ends_with(['[', '{']);
            first || line.starts_with("  ")
        };
        let mut examples = 0;
        let lines = text.lines().map(|line| {
            let comment = line.trim_start().strip_prefix("// ");
            match comment.filter(|_| !line.starts_with("//")) {
                Some(example) if is_example(example) => {
                    examples += 1;
                    example
                }
                _ => line,
            }
        });
        let text = lines.collect::<Vec<_>>().join("\n");
        assert!(examples >= 10, "{name}: {examples} lines");
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join(name);
        fs::write(&path, &text).expect("written");
        let config = zenoh::Config::from_file(&path);
        let config = config.unwrap_or_else(|error| panic!("{name}: {error}\n{text}"));
        let config = serde_json::to_value(&config).expect("JSON");
        for (pointer, count) in [
            ("/qos/network", 2),
            ("/downsampling", 1),
            ("/low_pass_filter", 1),
        ] {
            let items = config.pointer(pointer).and_then(Value::as_array);
            assert_eq!(items.map(Vec::len), Some(count), "{name}: {pointer}");
        }
    }
}

#[test]
fn multicast_scouting_is_off_in_all_files() {
    for name in [
        "robot.json5",
        "base-station.json5",
        "cloud.json5",
        "simulation.json5",
    ] {
        assert_eq!(
            loaded(name).pointer("/scouting/multicast/enabled"),
            Some(&json!(false)),
            "{name}"
        );
    }
}

#[test]
fn no_listener_accepts_connections_from_the_network() {
    for (name, at_least) in [
        ("robot.json5", 2),
        ("base-station.json5", 2),
        ("cloud.json5", 1),
        ("simulation.json5", 2),
    ] {
        let config = loaded(name);
        let listeners = config
            .pointer("/listen/endpoints")
            .and_then(Value::as_array)
            .expect("a list");
        assert!(listeners.len() >= at_least, "{name}");
        for listener in listeners.iter().map(|l| l.as_str().expect("text")) {
            // `any/` accepts connections only of peers that have the key of a link over Bluetooth.
            let reach = ["tcp/127.0.0.1:", "unixsock-stream/", "any/", "ble/"];
            assert!(
                reach.iter().any(|r| listener.starts_with(r)),
                "{name}: {listener}"
            );
        }
    }
}

#[test]
fn robots_base_stations_and_shared_routers_require_logins_and_access_control() {
    for name in WITH_LOGIN.into_iter().chain(["cloud.json5"]) {
        let config = loaded(name);
        let at = |pointer| config.pointer(pointer).unwrap_or(&Value::Null);
        assert_eq!(
            at("/transport/auth/usrpwd/dictionary_file"),
            "/etc/rect/users",
            "{name}"
        );
        assert_eq!(
            at("/transport/auth/usrpwd/password"),
            &Value::Null,
            "{name}: a shipped file must not contain a password"
        );
        assert_eq!(at("/access_control/enabled"), true, "{name}");
        assert_eq!(at("/access_control/default_permission"), "deny", "{name}");
    }
}

#[test]
fn a_robot_does_not_start_without_its_login_file() {
    if PathBuf::from("/etc/rect/users").exists() {
        return crate::support::skip("this machine has a login file");
    }
    for name in WITH_LOGIN {
        let mut router = Router::start(&["-c", &file(name)]);
        assert_eq!(router.exit().code(), Some(1), "{name}");
        let log = router.full_log();
        assert!(
            log.contains(
                "rect-router: cannot read the login file /etc/rect/users (create one with a line `user:password`"
            ),
            "{log}"
        );
    }
}

/// Starts routers with a shipped file, but with a login file and a listener of the test.
struct Fleet {
    /// Folder of the login file.
    _dir: tempfile::TempDir,
    login: [String; 2],
}

impl Fleet {
    fn new(logins: &str) -> Self {
        let dir = tempfile::tempdir().expect("a directory");
        let login = login_file(dir.path(), logins);
        Self { _dir: dir, login }
    }

    fn router(&self, name: &str, more: &[&str]) -> (Router, String) {
        let ([flag, login], file) = (&self.login, file(name));
        let mut args = vec!["-c", &file, "-l", "tcp/127.0.0.1:0", flag, login];
        args.extend(more);
        let mut router = Router::start(&args);
        let endpoint = router.listener();
        (router, endpoint)
    }
}

fn logged_in(endpoint: &str, user: &str, password: &str) -> zenoh::Result<Session> {
    let login = format!("{{ user: '{user}', password: '{password}' }}");
    client_with(endpoint, &[("transport/auth/usrpwd", &login)])
}

/// Returns the sessions of the router with identifier `abc`.
fn sessions(session: &Session) -> String {
    admin(session, "@/abc/router").expect("an answer")
}

#[test]
fn programs_need_a_valid_login_and_then_have_full_access() {
    for name in WITH_LOGIN {
        let fleet = Fleet::new("fleet:secret\n");
        let (_router, endpoint) = fleet.router(name, &["-i", "abc"]);

        assert!(
            client_with(&endpoint, &[]).is_err(),
            "{name}: let in without a login"
        );
        assert!(
            logged_in(&endpoint, "fleet", "guess").is_err(),
            "{name}: let in with a wrong password"
        );
        assert!(
            logged_in(&endpoint, "fleet", "").is_err(),
            "{name}: let in with an empty password"
        );
        assert!(
            logged_in(&endpoint, "unknown", "secret").is_err(),
            "{name}: let in as an unknown user"
        );

        let program = |_| logged_in(&endpoint, "fleet", "secret").expect("let in");
        let (one, two) = (program(1), program(2));
        let own = if name == "robot.json5" {
            "rect/wombat-1"
        } else {
            "rect/base-station"
        };
        assert!(arrives(&one, &two, &format!("{own}/arm/angle")));
        assert!(arrives(&one, &two, "local/mark"));
        assert!(arrives(&one, &two, &format!("{own}/@rect/state")));
        assert!(arrives(&one, &two, &format!("{own}/@rect/@config/x")));
        assert!(
            admin(&one, "@/abc/router").is_some(),
            "{name}: the admin space"
        );
    }
}

#[test]
fn robots_get_the_fleets_data_and_no_more() {
    let fleet = Fleet::new("fleet:secret\n");
    let (_router, endpoint) = fleet.router("robot.json5", &["-i", "abc", "--cfg", AS_ROBOTS]);
    let robot = |_| logged_in(&endpoint, "fleet", "secret").expect("let in");
    let (one, two) = (robot(1), robot(2));

    assert!(arrives(&one, &two, "rect/wombat-1/arm/angle"));
    assert!(arrives(&one, &two, "rect/wombat-1/@rect/state"));
    assert!(
        admin(&one, "@/abc/router").is_none(),
        "a robot reads another's admin space"
    );

    let all = two.declare_subscriber("**").wait().expect("a subscription");
    let config = two.declare_subscriber("rect/*/@rect/@config/**");
    let config = config.wait().expect("a subscription");
    let deadline = std::time::Instant::now() + crate::support::DEADLINE;
    loop {
        assert!(
            std::time::Instant::now() < deadline,
            "nothing arrives at `**`"
        );
        one.put("private/key", "not for you").wait().expect("a put");
        one.put("rect/wombat-1/@rect/@config/connections", "not by you")
            .wait()
            .expect("a put");
        one.put("rect/wombat-1/mark", "for you")
            .wait()
            .expect("a put");
        // Messages arrive in order: if the first put had passed, its message would arrive first.
        if let Ok(Some(sample)) = all.recv_timeout(Duration::from_millis(200)) {
            assert_eq!(sample.key_expr().as_str(), "rect/wombat-1/mark");
            assert!(config.try_recv().expect("open").is_none());
            return;
        }
    }
}

#[test]
fn routers_of_one_fleet_link() {
    let fleet = Fleet::new("fleet:secret\n");
    let (_one, endpoint) = fleet.router("base-station.json5", &["-i", "abc"]);
    let (_two, other) = fleet.router(
        "robot.json5",
        &["-e", &endpoint, "--login-as", "fleet", "-i", "def"],
    );
    let local = logged_in(&endpoint, "fleet", "secret").expect("let in");
    let remote = logged_in(&other, "fleet", "secret").expect("let in");
    // The rules treat each TCP link on this computer as the link of a program.
    assert!(arrives(&remote, &local, "local/mark"));
    // The tests below rely on the absence of such an entry.
    assert!(sessions(&local).contains("def"));
}

#[test]
fn a_router_of_another_fleet_is_rejected() {
    let (ours, theirs) = (Fleet::new("fleet:secret\n"), Fleet::new("fleet:other\n"));
    let (mut one, endpoint) = ours.router("base-station.json5", &["-i", "abc"]);
    let (mut two, _) = theirs.router(
        "robot.json5",
        &["-e", &endpoint, "--login-as", "fleet", "-i", "def"],
    );
    two.wait_for("Unable to connect");
    let watcher = logged_in(&endpoint, "fleet", "secret").expect("let in");
    assert!(
        !sessions(&watcher).contains("def"),
        "the routers are linked"
    );
    assert!(!one.drained().iter().any(|line| line.contains("panicked")));
}

#[test]
fn a_robot_does_not_link_to_a_router_without_logins() {
    let mut open = Router::start(&[
        "-l",
        "tcp/127.0.0.1:0",
        "-i",
        "abc",
        "--no-multicast-scouting",
    ]);
    let endpoint = open.listener();
    let fleet = Fleet::new("fleet:secret\n");
    let (mut robot, _) = fleet.router(
        "robot.json5",
        &["-e", &endpoint, "--login-as", "fleet", "-i", "def"],
    );
    robot.wait_for("Unable to connect");
    let watcher = client_with(&endpoint, &[]).expect("open to all");
    // The open router shows each attempt until the robot ends it; a link would stay.
    let deadline = Instant::now() + DEADLINE;
    while sessions(&watcher).contains("def") {
        assert!(Instant::now() < deadline, "the routers are linked");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn an_empty_login_file_prevents_the_start() {
    let dir = tempfile::tempdir().expect("a directory");
    let [flag, login] = login_file(dir.path(), "\n");
    let mut router = Router::start(&["-c", &file("robot.json5"), &flag, &login]);
    assert_eq!(router.exit().code(), Some(1));
    assert!(router
        .full_log()
        .contains("is empty; write a line `user:password` into it"));
}

#[test]
fn all_files_retry_lost_connections_within_a_second() {
    for name in ["robot.json5", "base-station.json5", "simulation.json5"] {
        let config = loaded(name);
        let retry = config.pointer("/connect/retry").expect("set");
        assert!(
            retry["period_init_ms"]
                .as_u64()
                .is_some_and(|ms| ms <= 1000),
            "{name}"
        );
        assert!(
            retry["period_max_ms"].as_u64().is_some_and(|ms| ms <= 1000),
            "{name}"
        );
        assert_eq!(
            config.pointer("/connect/timeout_ms"),
            Some(&json!(-1)),
            "{name}"
        );
    }
}

/// Returns the commands in the comment of a file, each as one line.
fn documented_commands(name: &str) -> Vec<String> {
    let text = fs::read_to_string(file(name)).expect("exists");
    let comment = text
        .lines()
        .map_while(|line| line.strip_prefix("//").map(str::trim));
    let lines = comment.collect::<Vec<_>>().join("\n").replace("\\\n", " ");
    let commands = lines
        .lines()
        .filter(|line| line.starts_with("rect-router "));
    commands.map(str::to_owned).collect()
}

#[test]
fn the_documented_commands_start_two_linked_robots() {
    let air = Air::new();
    let commands = documented_commands("simulation.json5");
    assert_eq!(commands.len(), 2, "{commands:?}");
    let mut robots = Vec::new();
    for command in &commands {
        let program = format!("exec {}", env!("CARGO_BIN_EXE_rect-router"));
        let mut words = command.replacen("rect-router", &program, 1);
        words = words.replace("config/simulation.json5", &file("simulation.json5"));
        for port in ["7447", "7448"] {
            words = words.replace(&format!("tcp/127.0.0.1:{port}"), "tcp/127.0.0.1:0");
        }
        let mut router = Router::start_program_on(&air, Path::new("sh"), &["-c", &words]);
        let endpoint = router.listener_of("tcp/");
        router.up();
        robots.push((router, endpoint));
    }
    let session = client_with(&robots[0].1, &[]).expect("let in");
    for robot in ["wombat-1", "wombat-2"] {
        let asked = format!("rect/{robot}/@rect/connections/count");
        answers(&session, &asked, |count| {
            count["methods"]["ble"]["connected"] == 1
        });
    }
}

//! Tests of the `rect` command with two robots, linked over the simulated air: `cargo test -p rect-router --test behaviour tool`
use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    time::Instant,
};

use crate::support::{built, client, file, init, program, skip, start_with, Air, Wombat, DEADLINE};
use serde_json::Value;
use tempfile::TempDir;
use zenoh::Wait;

/// A command that is killed at the end of its test.
struct RunningCommand(Child);

impl Drop for RunningCommand {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns a `rect` command that connects to the router of a robot.
fn rect(at: &Wombat, arguments: &[&str]) -> Command {
    let mut command = Command::new(built().join("rect"));
    command.args(arguments).stdin(Stdio::null());
    command.env("RECT_ENDPOINT", &at.endpoint);
    command
}

fn run(at: &Wombat, arguments: &[&str]) -> Output {
    rect(at, arguments).output().expect("it runs")
}

fn text_of(output: &Output) -> String {
    let both = [output.stdout.as_slice(), &output.stderr].concat();
    String::from_utf8_lossy(&both).into_owned()
}

/// Repeats a command until its stdout contains `text`, and returns its stdout.
fn wait_for(at: &Wombat, arguments: &[&str], text: &str) -> String {
    let deadline = Instant::now() + DEADLINE;
    loop {
        let output = run(at, arguments);
        let shown = String::from_utf8_lossy(&output.stdout);
        if shown.contains(text) {
            return shown.into_owned();
        }
        assert!(
            Instant::now() < deadline,
            "{arguments:?}: {}",
            text_of(&output)
        );
    }
}

#[test]
fn robots_are_listed_although_another_one_replies_with_an_error() {
    if !built().join("rect").exists() {
        return skip("needs the tool: cargo build --workspace");
    }
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = Wombat::start(&air, &folder, 1, &file(&[]));
    let session = client(&one.endpoint);
    let wrong = ["topics", "status", "connections"].map(|document| {
        let key = format!("rect/wombat-8/@rect/{document}");
        let reply = move |query: zenoh::query::Query| {
            query.reply_err("out of\x1b[2J order").wait().expect("sent");
        };
        let queryable = session.declare_queryable(key).callback(reply);
        queryable.wait().expect("declared")
    });
    let odd = ["topics", "status", "connections"].map(|document| {
        let key = format!("rect/wombat-9/@rect/{document}");
        let reply = {
            let key = key.clone();
            move |query: zenoh::query::Query| query.reply(&key, "7]").wait().expect("sent")
        };
        let queryable = session.declare_queryable(key).callback(reply);
        queryable.wait().expect("declared")
    });
    // Other queryables are known once they reply.
    wait_for(&one, &["status", "wombat-1"], "wombat-1");
    let publish = ["pub", "arm/angle", "12.5", "--every", "100ms"];
    let publish = rect(&one, &publish).stderr(Stdio::null()).spawn();
    let _publishing = RunningCommand(publish.expect("it runs"));
    let longest = ["topic", "list", "--duration", "5s"];
    for (command, text) in [
        (&["topic", "list"][..], "wombat-1/arm/angle"),
        (&longest, "wombat-1/arm/angle"),
        (&["status"], "wombat-1"),
        // This one is `rect-router connections`, which asks all robots.
        (&["connections"], ""),
    ] {
        let output = match command {
            ["connections"] => {
                let mut router = Command::new(env!("CARGO_BIN_EXE_rect-router"));
                router.args(["connections", "--router", &one.endpoint]);
                router.output().expect("it runs")
            }
            _ => run(&one, command),
        };
        let (shown, problems) = (&output.stdout, String::from_utf8_lossy(&output.stderr));
        let shown = String::from_utf8_lossy(shown);
        assert!(output.status.success(), "{command:?}: {}", text_of(&output));
        assert!(shown.contains(text), "{command:?}: {}", text_of(&output));
        assert!(
            problems.contains("out of\u{fffd}[2J order") && problems.contains("wombat-9"),
            "{command:?}: {problems}"
        );
    }
    // Without any other reply, the error is the reason of the failure.
    let output = run(&one, &["status", "wombat-8"]);
    assert_eq!(output.status.code(), Some(1), "{}", text_of(&output));
    assert!(text_of(&output).contains("out of"), "{}", text_of(&output));
    let too_long = run(&one, &["topic", "list", "--duration", "1m"]);
    assert_eq!(too_long.status.code(), Some(2), "{}", text_of(&too_long));
    drop((wrong, odd));
}

#[test]
fn a_login_that_has_all_its_sessions_is_the_reason_of_the_failure() {
    if !built().join("rect").exists() {
        return skip("needs the tool: cargo build --workspace");
    }
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let folder = init(root.path(), "wombat-1", &[]);
    let limit = ["--cfg", "plugins/rect/sessions:{per_user:1}"];
    let (_router, endpoint) = start_with(&air, &folder, "wombat-1", &limit);
    let _first = program(&folder, &endpoint);
    let users = format!("{folder}/users");
    let named = ["pub", "arm/angle", "1", "--as", "wombat-1"];
    for command in [&["status"][..], &["peers"], &named[..3], &named] {
        let mut rect = Command::new(built().join("rect"));
        rect.args(command)
            .args(["--router", &endpoint, "--users", &users]);
        let output = rect.output().expect("it runs");
        let text = text_of(&output);
        // The router closes the session only after it has opened it, so that a command may have been faster.
        assert!(
            output.status.success() || text.contains("all sessions that one login may have"),
            "{command:?}: {text}"
        );
    }
}

#[test]
fn connects_shows_and_measures_robots() {
    if !built().join("rect").exists() {
        return skip("needs the tool: cargo build --workspace");
    }
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let [one, two] = [1, 2].map(|number| Wombat::start(&air, &folder, number, &file(&[])));
    let alone = text_of(&run(&two, &["peers"]));
    assert!(
        alone.contains("no other robot of the fleet rect"),
        "{alone}"
    );

    let connected = run(
        &two,
        &["connect", "radio", "ble", "wombat-1", "--option", "mtu=512"],
    );
    assert!(connected.status.success(), "{}", text_of(&connected));
    let table = wait_for(&two, &["connections"], "connected");
    assert!(
        table.contains("radio") && table.contains("wombat-1"),
        "{table}"
    );
    let peers = text_of(&run(&two, &["peers", "--wait", "wombat-1"]));
    assert!(peers.contains("ble") && peers.contains("dBm"), "{peers}");
    let still = ["peers", "--wait-lost", "wombat-1", "--timeout", "100ms"];
    let still = text_of(&run(&two, &still));
    assert!(
        still.contains("wombat-1 is still reachable after 100 ms"),
        "{still}"
    );
    // The other robot has no name for the connection.
    let other = wait_for(&one, &["connections", "wombat-2", "--json"], "radio");
    let other: Value = serde_json::from_str(&other).expect("JSON");
    assert_eq!(other[0]["method"], "ble", "{other:#}");

    let serving = rect(&one, &["bench", "--serve"])
        .stderr(Stdio::null())
        .spawn();
    let serving = RunningCommand(serving.expect("it runs"));
    let measured = wait_for(
        &two,
        &["bench", "wombat-1", "--duration", "1s", "--json"],
        "goodput_kb_s",
    );
    let measured: Value = serde_json::from_str(&measured).expect("JSON");
    assert_eq!(
        (&measured["method"], &measured["load_lost"]),
        (&"ble".into(), &0.into()),
        "{measured:#}"
    );
    for figure in [
        &measured["goodput_kb_s"],
        &measured["idle"]["p50_ms"],
        &measured["under_load"]["p99_ms"],
    ] {
        assert!(figure.as_f64() > Some(0.0), "{measured:#}");
    }
    // A robot has one server of a topic, and the survey serves the same ones.
    drop(serving);
    surveys(&air, &one, &two, &folder);

    // The round trip has been measured in the meantime.
    wait_for(&two, &["peers"], " ms");

    // Commands of `rect` that rect-router implements.
    let status = wait_for(&two, &["status"], "wombat-1");
    assert!(
        status.contains("wombat-2") && status.contains("1 ble"),
        "{status}"
    );
    let other = run(
        &two,
        &["doctor", "--router", &one.endpoint, "--as", "wombat-2"],
    );
    assert!(
        text_of(&other).contains("of wombat-1, not of wombat-2"),
        "{}",
        text_of(&other)
    );
    let help = text_of(&run(&two, &["init", "--help"]));
    assert!(
        help.contains("rect init") && !help.contains("rect-router init"),
        "{help}"
    );

    // The topics of another robot, measured by its own router.
    let publishing = ["pub", "arm/angle", "12.5", "--every", "100ms"];
    let publishing = rect(&one, &publishing).stderr(Stdio::null()).spawn();
    let _publishing = RunningCommand(publishing.expect("it runs"));
    let topics = wait_for(&two, &["topic", "list", "wombat-1"], "application/json");
    assert!(
        topics.contains("wombat-1/arm/angle") && topics.contains(" Hz"),
        "{topics}"
    );
    let info = run(&two, &["topic", "info", "wombat-1/arm/angle", "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).expect("JSON");
    assert_eq!(
        (&info["topic"], &info["last_bytes"]),
        (&"arm/angle".into(), &4.into()),
        "{info:#}"
    );
    let rate = text_of(&run(
        &two,
        &["topic", "hz", "wombat-1/arm/angle", "--count", "1"],
    ));
    assert!(
        rate.contains(" Hz, ") && rate.contains("ms apart"),
        "{rate}"
    );
    // A retained topic is listed without a program that publishes it.
    let retained = run(&one, &["pub", "mode", "auto", "--retained"]);
    assert!(retained.status.success(), "{}", text_of(&retained));
    let listed = run(&two, &["topic", "list", "wombat-1", "--json"]);
    let listed: Value = serde_json::from_slice(&listed.stdout).expect("JSON");
    let topics = listed["wombat-1"]["topics"].as_array().expect("a list");
    let rows = topics.iter().map(|row| (&row["topic"], &row["retained"]));
    assert_eq!(
        rows.collect::<Vec<_>>(),
        [
            (&"arm/angle".into(), &false.into()),
            (&"mode".into(), &true.into())
        ]
    );
    let info = text_of(&run(&two, &["topic", "info", "wombat-1/mode"]));
    assert!(info.contains("retained: yes"), "{info}");
    let got = text_of(&run(&two, &["topic", "get", "wombat-1/mode"]));
    assert!(got.contains("): auto"), "{got}");

    let nothing = run(&two, &["topic", "info", "wombat-1/nothing"]);
    assert_eq!(nothing.status.code(), Some(1));
    assert!(
        text_of(&nothing).contains("rect topic list wombat-1"),
        "{}",
        text_of(&nothing)
    );

    let gone = run(&two, &["disconnect", "radio"]);
    assert!(gone.status.success(), "{}", text_of(&gone));
    let again = run(&two, &["disconnect", "radio"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(
        text_of(&again).contains("there are: none"),
        "{}",
        text_of(&again)
    );
    let wrong = text_of(&run(&two, &["connect", "x", "tcp", "10.0.0.2"]));
    assert!(wrong.contains("tcp needs a port"), "{wrong}");
}

/// Measures the link of wombat-2 and wombat-1 in the short form of `rect survey`.
fn surveys(air: &Air, one: &Wombat, two: &Wombat, folder: &TempDir) {
    let serving = rect(one, &["survey", "--serve"])
        .stderr(Stdio::piped())
        .spawn();
    let mut serving = RunningCommand(serving.expect("it runs"));
    let stderr = serving.0.stderr.take().expect("it is a pipe");
    let ready = BufReader::new(stderr).lines().next();
    assert!(ready.is_some_and(|line| line.is_ok_and(|line| line.contains("rect survey wombat-1"))));

    let path = folder.path().join("survey.json");
    let measured = rect(
        two,
        &[
            "survey",
            "wombat-1",
            "--here",
            "--duration",
            "500ms",
            "--adapter",
            "sim-survey",
            "--output",
            path.to_str().expect("UTF-8"),
        ],
    )
    .env("RECT_AIR", air.socket())
    .output()
    .expect("it runs");
    let shown = text_of(&measured);
    assert!(measured.status.success(), "{shown}");
    let survey: Value = serde_json::from_str(&read(&path)).expect("JSON");
    follows_schema(&survey);
    let place = &survey["places"][0];
    assert_eq!(
        (&place["path"], &place["error"]),
        (&"ble".into(), &Value::Null),
        "{shown}"
    );
    assert_eq!(
        place["discovery"]["seconds"].as_array().map(Vec::len),
        Some(5),
        "{place:#}"
    );
    for load in [&place["sent"], &place["received"]] {
        assert!(
            load[0]["kb_per_s"].as_f64() > Some(1.0) && load[0]["lost"] == 0,
            "{load:#}"
        );
    }
    let page = read(&path.with_extension("html"));
    assert!(
        page.contains("\"rect-survey\"") && !page.contains("{{"),
        "the page is complete"
    );

    // Without a terminal there is nobody to ask.
    let asking = text_of(&run(two, &["survey", "wombat-1"]));
    assert!(asking.contains("use --by or --here"), "{asking}");
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).expect("it was written")
}

fn follows_schema(survey: &Value) {
    let schema = concat!(env!("CARGO_MANIFEST_DIR"), "/../surveys/survey.schema.json");
    let schema = serde_json::from_str(&read(Path::new(schema))).expect("JSON");
    let schema = jsonschema::validator_for(&schema).expect("a schema");
    let errors: Vec<_> = schema
        .iter_errors(survey)
        .map(|error| error.to_string())
        .collect();
    assert_eq!(errors, Vec::<String>::new());
}

#[test]
fn contributed_surveys_follow_the_schema() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../surveys");
    let files = fs::read_dir(folder)
        .expect("a folder")
        .flatten()
        .map(|file| file.path());
    let is_survey = |path: &PathBuf| {
        let name = path.to_string_lossy();
        name.ends_with(".json") && !name.ends_with(".schema.json")
    };
    let surveys: Vec<_> = files.filter(is_survey).collect();
    assert!(!surveys.is_empty());
    for path in surveys {
        follows_schema(&serde_json::from_str(&read(&path)).expect("JSON"));
    }
}

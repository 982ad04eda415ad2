//! The `rect` command at two robots' routers, linked by the simulated air: `cargo test --workspace --test tool`
mod support;

use std::{
    process::{Child, Command, Output, Stdio},
    time::Instant,
};

use serde_json::Value;
use support::{built_with, file, skip, Air, Wombat, DEADLINE};

/// A command that is ended with its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// `rect` at that robot's router.
fn rect(at: &Wombat, arguments: &[&str]) -> Command {
    let mut command = Command::new(built_with("dev").join("rect"));
    command.args(arguments).stdin(Stdio::null());
    command.env("RECT_ENDPOINT", &at.endpoint);
    command
}

fn ran(at: &Wombat, arguments: &[&str]) -> Output {
    rect(at, arguments).output().expect("it runs")
}

fn said(output: &Output) -> String {
    let both = [output.stdout.as_slice(), &output.stderr].concat();
    String::from_utf8_lossy(&both).into_owned()
}

/// What it says, as soon as that has the text in it.
fn says(at: &Wombat, arguments: &[&str], text: &str) -> String {
    let deadline = Instant::now() + DEADLINE;
    loop {
        let output = ran(at, arguments);
        let shown = String::from_utf8_lossy(&output.stdout);
        if shown.contains(text) {
            return shown.into_owned();
        }
        assert!(
            Instant::now() < deadline,
            "{arguments:?}: {}",
            said(&output)
        );
    }
}

#[test]
fn robots_are_connected_by_name_shown_and_measured() {
    if !built_with("dev").join("rect").exists() {
        return skip("needs the tool: cargo build --workspace");
    }
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let [one, two] = [1, 2].map(|number| Wombat::start(&air, &folder, number, &file(&[])));
    let alone = said(&ran(&two, &["peers"]));
    assert!(
        alone.contains("no other robot of the fleet rect"),
        "{alone}"
    );

    let connected = ran(
        &two,
        &["connect", "radio", "ble", "wombat-1", "--option", "mtu=512"],
    );
    assert!(connected.status.success(), "{}", said(&connected));
    let table = says(&two, &["connections"], "connected");
    assert!(
        table.contains("radio") && table.contains("wombat-1"),
        "{table}"
    );
    let peers = says(&two, &["peers"], "wombat-1");
    assert!(peers.contains("ble") && peers.contains("dBm"), "{peers}");
    // The other has not named it.
    let other = says(&one, &["connections", "wombat-2", "--json"], "radio");
    let other: Value = serde_json::from_str(&other).expect("JSON");
    assert_eq!(other[0]["method"], "ble", "{other:#}");

    let serving = rect(&one, &["bench", "--serve"])
        .stderr(Stdio::null())
        .spawn();
    let _serving = Running(serving.expect("it runs"));
    let measured = says(
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
    // The radio has measured it meanwhile.
    says(&two, &["peers"], " ms");

    // The commands of `rect` that the router's program does.
    let status = says(&two, &["status"], "wombat-1");
    assert!(
        status.contains("wombat-2") && status.contains("1 ble"),
        "{status}"
    );
    let other = ran(
        &two,
        &["doctor", "--router", &one.endpoint, "--as", "wombat-2"],
    );
    assert!(
        said(&other).contains("of wombat-1, not of wombat-2"),
        "{}",
        said(&other)
    );
    let help = said(&ran(&two, &["init", "--help"]));
    assert!(
        help.contains("rect init") && !help.contains("rect-router init"),
        "{help}"
    );

    // Another robot's topics, as its own router measures them.
    let speaking = ["pub", "arm/angle", "12.5", "--every", "100ms"];
    let speaking = rect(&one, &speaking).stderr(Stdio::null()).spawn();
    let _speaking = Running(speaking.expect("it runs"));
    let topics = says(&two, &["topic", "list", "wombat-1"], "application/json");
    assert!(
        topics.contains("wombat-1/arm/angle") && topics.contains(" Hz"),
        "{topics}"
    );
    let info = ran(&two, &["topic", "info", "wombat-1/arm/angle", "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).expect("JSON");
    assert_eq!(
        (&info["publishers"], &info["last_bytes"]),
        (&1.into(), &4.into()),
        "{info:#}"
    );
    let rate = said(&ran(
        &two,
        &["topic", "hz", "wombat-1/arm/angle", "--count", "1"],
    ));
    assert!(
        rate.contains(" Hz, ") && rate.contains("ms apart"),
        "{rate}"
    );
    let nothing = ran(&two, &["topic", "info", "wombat-1/nothing"]);
    assert_eq!(nothing.status.code(), Some(1));
    assert!(
        said(&nothing).contains("rect topic list wombat-1"),
        "{}",
        said(&nothing)
    );

    let gone = ran(&two, &["disconnect", "radio"]);
    assert!(gone.status.success(), "{}", said(&gone));
    let again = ran(&two, &["disconnect", "radio"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(said(&again).contains("there are: none"), "{}", said(&again));
    let wrong = said(&ran(&two, &["connect", "x", "tcp", "10.0.0.2"]));
    assert!(wrong.contains("tcp needs a port"), "{wrong}");
}

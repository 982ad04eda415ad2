//! Tests `rect stop`, connected to a robot in the test's own process: `cargo test -p rect-cli --test command stop`
use std::{
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use rect::{blocking::Robot, Options};

use crate::pair::{free_endpoint, TIMEOUT};

/// Runs `rect stop` successfully, and returns what it prints.
fn printed(endpoint: &str, arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
    command.arg("stop").args(arguments).stdin(Stdio::null());
    let output = command.args(["--as", "a", "--router", endpoint]).output();
    let output = output.expect("started");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

fn until(condition: impl Fn() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < TIMEOUT, "in time");
        sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_stop_holds_until_it_is_released() {
    let endpoint = free_endpoint();
    let options = Options::new("a").expect("a name").login_file("/none");
    let robot = Robot::connect(options.listen(&endpoint)).expect("connected");
    let stop = robot.fleet_stop().expect("takes part");
    let none = "the fleet is not stopped\n";
    assert_eq!(printed(&endpoint, &["--list", "--within", "0.1"]), none);
    let pressed = "stopped by a: the table edge\n";
    assert_eq!(printed(&endpoint, &["the table edge"]), pressed);
    until(|| stop.is_stopped());
    assert_eq!(stop.pressed()[0].reason, "the table edge");
    // Later commands know it. A stop that another program presses is a further one.
    assert_eq!(printed(&endpoint, &["--list"]), pressed);
    assert_eq!(printed(&endpoint, &["smoke"]).lines().count(), 2);
    until(|| stop.pressed().len() == 2);
    assert_eq!(printed(&endpoint, &["--release"]), none);
    until(|| !stop.is_stopped());
}

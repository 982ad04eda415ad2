//! Tests of the library's examples, each run as two programs at one router, after `cargo build -p rect-robot --examples`:
//! `cargo test -p rect-router --test behaviour examples`
use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{self, Receiver},
    thread,
    time::Instant,
};

use crate::support::{built, skip, Router, DEADLINE};
use nix::{
    sys::signal::{kill, Signal},
    unistd::Pid,
};
use rect::{blocking::Robot, Level, LogItem, LogOptions, Options, Payload};

/// A running example, killed at the end of the test.
struct Example {
    child: Child,
    lines: Receiver<String>,
}

impl Example {
    fn start(name: &str, arguments: &[&str], endpoint: &str, folder: &Path) -> Option<Self> {
        let program = built().join("examples").join(name);
        if !program.exists() {
            skip("needs the examples: cargo build -p rect-robot --examples");
            return None;
        }
        let mut child = Command::new(program)
            .args(arguments)
            .current_dir(folder)
            .env("RECT_ENDPOINT", endpoint)
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts");
        let (sender, lines) = mpsc::channel();
        let output = child.stdout.take().expect("piped");
        thread::spawn(move || {
            for line in BufReader::new(output).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Some(Self { child, lines })
    }

    /// Waits until the example prints a line with this text.
    fn wait_for(&self, text: &str) {
        let deadline = Instant::now() + DEADLINE;
        let mut all = Vec::new();
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) if line.contains(text) => return,
                Ok(line) => all.push(line),
                Err(_) => panic!("the example does not print {text:?}: {all:#?}"),
            }
        }
    }
}

impl Drop for Example {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A router, and a working folder for the examples.
struct Stage {
    endpoint: String,
    folder: tempfile::TempDir,
    _router: Router,
}

impl Stage {
    fn new() -> Self {
        let mut router = Router::start(&["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"]);
        Self {
            endpoint: router.listener(),
            folder: tempfile::tempdir().expect("a folder"),
            _router: router,
        }
    }

    fn start(&self, name: &str, arguments: &[&str]) -> Option<Example> {
        Example::start(name, arguments, &self.endpoint, self.folder.path())
    }
}

/// The simulated robots wombat-1 and wombat-2.
struct Simulation {
    child: Child,
    endpoint: String,
}

impl Simulation {
    fn start() -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_rect-router"))
            .args(["sim", "--port", "0"])
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts");
        let mut lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let endpoint = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| Some(line.strip_prefix("wombat-1  ")?.trim().to_owned()))
            .expect("the endpoint of wombat-1");
        // Keeps reading, because the simulation would wait if nobody read what it prints.
        thread::spawn(move || lines.map_while(Result::ok).for_each(drop));
        Self { child, endpoint }
    }
}

impl Drop for Simulation {
    fn drop(&mut self) {
        let _ = kill(
            Pid::from_raw(self.child.id().try_into().expect("a process id")),
            Signal::SIGTERM,
        );
        let _ = self.child.wait();
    }
}

#[test]
fn hello_prints_a_reply_and_messages_of_a_simulated_robot() {
    let simulation = Simulation::start();
    let folder = tempfile::tempdir().expect("a folder");
    let hello = Example::start("hello", &[], &simulation.endpoint, folder.path());
    let Some(hello) = hello else {
        return;
    };
    hello.wait_for("battery of wombat-2: {\"percent\":");
    hello.wait_for("wombat-2 arm/angle: {\"degrees\":");
}

#[test]
fn telemetry_is_exchanged_in_both_directions() {
    let stage = Stage::new();
    let Some(one) = stage.start("telemetry", &["wombat-1"]) else {
        return;
    };
    let other = stage.start("telemetry", &["wombat-2"]).expect("built");
    other.wait_for("wombat-1: Telemetry { angle_deg");
    one.wait_for("wombat-2: Telemetry { angle_deg");
}

#[test]
fn a_robot_with_a_low_battery_is_asked_for_its_pose() {
    let stage = Stage::new();
    let Some(one) = stage.start("rescue", &["wombat-1"]) else {
        return;
    };
    let two = stage.start("rescue", &["wombat-2", "12"]).expect("built");
    one.wait_for("wombat-2 needs help at 1.5, 0.5");
    two.wait_for("wombat-1: 80 percent");
}

#[test]
fn teleoperation_controls_the_other_robot() {
    let stage = Stage::new();
    let Some(driven) = stage.start("teleoperation", &["wombat-1"]) else {
        return;
    };
    let driver = stage.start("teleoperation", &["laptop", "wombat-1"]);
    driven.wait_for("Drive { left: ");
    drop(driver);
    driven.wait_for("stopping: ");
}

#[test]
fn a_request_is_answered() {
    let stage = Stage::new();
    let Some(serving) = stage.start("request", &["wombat-1"]) else {
        return;
    };
    serving.wait_for("serves");
    let deadline = Instant::now() + DEADLINE;
    // It takes a moment until the service is known at the router.
    let asking = loop {
        let asking = stage.start("request", &["wombat-2", "wombat-1"]);
        let mut asking = asking.expect("built");
        if asking.child.wait().expect("our child").success() {
            break asking;
        }
        assert!(Instant::now() < deadline, "the request is not answered");
    };
    asking.wait_for("wombat-1: Cell { cell: 1, volt: 3.6 }");
    asking.wait_for("the cell must be 1 or 2");
}

#[test]
fn a_camera_is_watched() {
    let stage = Stage::new();
    let Some(_camera) = stage.start("camera", &["wombat-1"]) else {
        return;
    };
    let watching = stage.start("camera", &["laptop", "wombat-1"]);
    watching.expect("built").wait_for("320x240");
}

#[test]
fn a_file_is_transferred() {
    let stage = Stage::new();
    std::fs::write(stage.folder.path().join("map.bin"), vec![7; 100_000]).expect("written");
    let Some(taking) = stage.start("transfer", &["wombat-1"]) else {
        return;
    };
    taking.wait_for("receives files");
    let sending = stage.start("transfer", &["wombat-2", "wombat-1", "map.bin"]);
    sending.expect("built").wait_for("map.bin: complete");
    taking.wait_for("map.bin from wombat-2");
}

#[test]
fn a_late_program_receives_the_last_mode() {
    let simulation = Simulation::start();
    let folder = tempfile::tempdir().expect("a folder");
    let start = |arguments: &[&str]| {
        Example::start("state", arguments, &simulation.endpoint, folder.path())
    };
    let set = |mode| {
        let mut setting = start(&["wombat-1", mode])?;
        Some(setting.child.wait().expect("our child").success())
    };
    let Some(is_kept) = set("auto") else {
        return;
    };
    assert!(is_kept);
    let printing = start(&["wombat-1"]).expect("built");
    printing.wait_for("wombat-1: auto, for ");
    assert_eq!(set("manual"), Some(true));
    printing.wait_for("wombat-1: manual, for 0 s");
    assert_eq!(set("none"), Some(true));
    printing.wait_for("wombat-1: none, for 0 s");
}

#[test]
fn lines_and_an_alert_stay_when_the_program_has_ended() {
    let simulation = Simulation::start();
    let folder = tempfile::tempdir().expect("a folder");
    let log = Example::start("log", &["wombat-1"], &simulation.endpoint, folder.path());
    let Some(mut log) = log else {
        return;
    };
    assert!(log.child.wait().expect("our child").success());
    let options = Options::new("wombat-1").expect("a name");
    let reader = Robot::connect(options.router(&simulation.endpoint)).expect("joined");
    let logs = reader
        .logs("wombat-1", LogOptions::new())
        .expect("a reader");
    let lines: Vec<_> = logs
        .flat_map(|item| match item {
            LogItem::Lines { lines, .. } => lines,
            _ => Vec::new(),
        })
        .map(|kept| (kept.line.level, kept.line.text))
        .collect();
    for expected in [(Level::Info, "ready"), (Level::Warn, "the gripper is slow")] {
        let expected = (expected.0, expected.1.to_owned());
        assert!(lines.contains(&expected), "{lines:?}");
    }
    let alert = reader.latest::<Payload>("wombat-1", "alerts/battery-low");
    assert!(alert.expect("an answer").is_some());
}

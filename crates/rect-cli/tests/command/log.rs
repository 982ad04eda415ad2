//! Tests `rect run`, `rect log` and `rect alert`, connected to a robot in the test's own process, which keeps the lines:
//! `cargo test -p rect-cli --test command log`
use std::{
    path::Path,
    process::{Command, Output, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use rect::{blocking::Robot, Level, Options};
use rustix::process::{kill_process, Pid, Signal};

use crate::pair::{free_endpoint, TIMEOUT};

/// A robot that keeps lines, and the folder in which commands remember what they have seen.
struct World {
    endpoint: String,
    robot: Robot,
    folder: tempfile::TempDir,
}

impl World {
    fn new(name: &str) -> Self {
        let endpoint = free_endpoint();
        let options = Options::new(name).expect("a name").login_file("/none");
        let robot = Robot::connect(options.listen(&endpoint)).expect("connected");
        let folder = tempfile::tempdir().expect("a folder");
        Self {
            endpoint,
            robot,
            folder,
        }
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
        command
            .args(&arguments[..1])
            .args([
                "--as",
                self.robot.name().as_str(),
                "--router",
                &self.endpoint,
            ])
            .args(&arguments[1..])
            .env("XDG_STATE_HOME", self.folder.path())
            .stdin(Stdio::null());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("started")
    }

    /// Runs a shell script as the program `arm`.
    fn shell(&self, options: &[&str], script: &str) -> Output {
        let arguments = [
            &["run", "--name", "arm"],
            options,
            &["--", "sh", "-c", script],
        ];
        self.run(&arguments.concat())
    }

    /// Returns what `rect log` prints for a robot.
    fn log(&self, arguments: &[&str]) -> String {
        text(&self.run(&[&["log"], arguments].concat()).stdout)
    }

    fn alerts(&self) -> Vec<String> {
        let alerts = self.robot.alerts(None).expect("an answer");
        alerts.into_iter().map(|one| one.alert.text).collect()
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn until(what: &str, condition: impl Fn() -> bool) {
    let began = Instant::now();
    while !condition() {
        assert!(began.elapsed() < TIMEOUT, "{what}");
        sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_program_that_fails_says_why_on_the_laptop() {
    let world = World::new("a");
    let script = "echo one; printf 'Traceback (most recent call last):\\n  line 1\\nValueError: bad angle\\n' >&2; exit 3";
    let output = world.shell(&[], script);
    assert_eq!(output.status.code(), Some(3));
    assert_eq!(text(&output.stdout), "one\n");
    assert!(
        text(&output.stderr).contains("arm failed after"),
        "{output:?}"
    );
    let printed = world.log(&["a"]);
    let parts = [
        "arm rect run: started pid=",
        "info  arm one\n",
        "warn  arm Traceback (most recent call last):\n      line 1\n    ValueError: bad angle\n",
        "error arm rect run: failed after",
        "exit status 3",
        "exit_status=3",
    ];
    for part in parts {
        assert!(printed.contains(part), "{part:?} in {printed}");
    }
    assert_eq!(world.log(&["a", "--level", "error"]).lines().count(), 1);
    assert_eq!(
        world
            .log(&["a", "--text", "VALUEERROR"])
            .matches(" arm ")
            .count(),
        1
    );
    assert_eq!(world.log(&["a", "--program", "drive"]), "");
    let json = world.log(&["a", "--json", "--last", "1"]);
    assert!(
        json.contains(r#""program":"arm""#) && json.contains(r#""level":"error""#),
        "{json}"
    );
    let alerts = world.alerts();
    let [alert] = &alerts[..] else {
        panic!("{alerts:?}");
    };
    assert!(alert.starts_with("arm failed after") && alert.ends_with(": ValueError: bad angle"));
    // The next run is sound, and the alert ends.
    assert!(world.shell(&[], "true").status.success());
    assert!(world.alerts().is_empty());
}

#[test]
fn a_program_is_restarted_until_it_succeeds_and_gets_its_name_and_router() {
    let world = World::new("a");
    let count = world.folder.path().join("count");
    let script = format!(
        "echo $RECT_PROGRAM at $RECT_ENDPOINT; echo x >> {0}; test $(wc -l < {0}) = 2",
        count.display()
    );
    let output = world.shell(&["--restart", "on-failure"], &script);
    assert!(output.status.success(), "{output:?}");
    let line = format!("arm at {}\n", world.endpoint);
    assert_eq!(text(&output.stdout), line.repeat(2));
    let printed = world.log(&["a"]);
    assert!(
        printed.contains("started again") && printed.contains("restarts=1"),
        "{printed}"
    );
    assert!(world.alerts().is_empty());
}

#[test]
fn any_output_is_kept_within_limits() {
    let world = World::new("a");
    let script = "printf '\\033[31mred\\033[0m\\n'; head -c 1000000 /dev/zero | tr '\\0' x; echo; \
                  head -c 1000 /dev/urandom; echo; printf 'no line break'; exec >&- 2>&-; sleep 0.1";
    let output = world.shell(&[], script);
    assert!(output.status.success(), "{output:?}");
    assert!(output.stdout.len() > 1_000_000, "everything is passed on");
    let printed = world.log(&["a"]);
    assert!(
        printed.contains("arm red\n") && !printed.contains('\x1b'),
        "{printed}"
    );
    assert!(
        printed.contains("bytes)\n") && printed.len() < 40_000,
        "{}",
        printed.len()
    );
    assert!(printed.contains("no line break"), "{printed}");
}

#[test]
fn a_program_that_leaves_others_behind_does_not_hold_up_its_end() {
    let world = World::new("a");
    let began = Instant::now();
    let output = world.shell(&[], "sleep 30 & echo $!");
    assert!(output.status.success() && began.elapsed() < Duration::from_secs(20));
    assert!(world.log(&["a"]).contains("left programs behind"));
    let pid = text(&output.stdout)
        .trim()
        .parse()
        .ok()
        .and_then(Pid::from_raw);
    kill_process(pid.expect("a process"), Signal::KILL).expect("killed");
}

#[test]
fn a_program_that_ignores_the_request_to_end_is_killed() {
    let world = World::new("a");
    let script = "trap '' TERM; echo ready; while :; do sleep 0.05; done";
    let arguments = [
        "run", "--name", "arm", "--grace", "200ms", "--", "sh", "-c", script,
    ];
    let mut running = world
        .command(&arguments)
        .stdout(Stdio::null())
        .spawn()
        .expect("started");
    until("it is ready", || world.log(&["a"]).contains("ready"));
    let pid = i32::try_from(running.id()).ok().and_then(Pid::from_raw);
    kill_process(pid.expect("a process"), Signal::TERM).expect("sent");
    let status = running.wait().expect("ended");
    assert_eq!(status.code(), Some(128 + 9));
    let printed = world.log(&["a"]);
    assert!(
        printed.contains("does not end within 200 ms and is killed"),
        "{printed}"
    );
    assert!(world.alerts().is_empty(), "somebody has asked for it");
}

#[test]
fn a_program_runs_without_a_router_and_its_lines_arrive_later() {
    let endpoint = free_endpoint();
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
    let arguments = ["run", "--name", "arm", "--as", "a", "--router", &endpoint];
    command
        .args(arguments)
        .args(["--", "sh", "-c", "echo early; sleep 300"]);
    let mut running = command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("started");
    sleep(Duration::from_millis(100));
    let options = Options::new("a").expect("a name").login_file("/none");
    let robot = Robot::connect(options.listen(&endpoint)).expect("connected");
    until("the line has arrived", || {
        let logs = robot.logs("a", rect::LogOptions::new()).expect("a reader");
        format!("{:?}", logs.collect::<Vec<_>>()).contains("early")
    });
    let pid = i32::try_from(running.id()).ok().and_then(Pid::from_raw);
    kill_process(pid.expect("a process"), Signal::TERM).expect("sent");
    running.wait().expect("ended");
}

#[test]
fn the_lines_of_a_silent_robot_are_those_that_this_computer_has_seen() {
    let silent = World::new("a");
    silent.robot.log(Level::Warn, "the last words");
    until("the line is kept", || {
        silent.log(&["a"]).contains("the last words")
    });
    silent.robot.close().expect("closed");
    let other = World {
        folder: silent.folder,
        ..World::new("b")
    };
    let output = other.run(&["log", "a", "--timeout", "200ms"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stdout).contains("the last words"),
        "{output:?}"
    );
    let errors = text(&output.stderr);
    assert!(
        errors.contains("a does not answer") && errors.contains("seen these lines before"),
        "{errors}"
    );
    let unknown = text(&other.run(&["log", "c", "--timeout", "200ms"]).stderr);
    assert!(
        unknown.contains("has not seen any of its lines; reachable robots: "),
        "{unknown}"
    );
    let file = Path::new("rect/log/rect/a.jsonl");
    assert!(other.folder.path().join(file).is_file());
}

#[test]
fn alerts_are_raised_listed_and_cleared_on_the_command_line() {
    let world = World::new("a");
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
        command
            .arg("alert")
            .args(arguments)
            .args(["--as", "a", "--router", &world.endpoint]);
        let output = command.output().expect("started");
        assert!(output.status.success(), "{output:?}");
        text(&output.stdout)
    };
    assert_eq!(run(&["list"]), "no alerts\n");
    run(&["raise", "battery low", "--level", "warn"]);
    let listed = run(&["list"]);
    assert!(
        listed.contains("battery low") && listed.contains("warn"),
        "{listed}"
    );
    run(&["clear", "battery-low"]);
    assert_eq!(run(&["list", "a"]), "no alerts\n");
}

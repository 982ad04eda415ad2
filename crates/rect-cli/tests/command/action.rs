//! Tests `rect action`, connected to a robot in the test's own process: `cargo test -p rect-cli --test command action`
use std::{
    io::{BufRead, BufReader},
    process::{Child, Command, Output, Stdio},
};

use rect::{Action, ActionOptions, Goal, Json, Options, Robot};
use serde_json::{json, Value};

use crate::pair::free_endpoint;

/// A robot whose program digs, and the command that is connected to it.
struct Digger {
    endpoint: String,
    robot: Robot,
    _dig: Action,
    _rest: Action,
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Digs as deep as the goal says: 0 is rock, and below that there is no end.
async fn dig(goal: Goal) -> Result<Json<Value>, String> {
    let depth: i64 = goal.payload.value().map_err(|error| error.to_string())?;
    goal.feedback(Json(json!({"depth": depth})), Some(0.5))
        .map_err(|error| error.to_string())?;
    match depth {
        0 => Err("rock".to_owned()),
        1.. => Ok(Json(json!({"dug": depth}))),
        _ => Err(goal.cancelled().await),
    }
}

async fn rest(goal: Goal) -> Result<&'static str, String> {
    Err(goal.cancelled().await)
}

impl Digger {
    async fn start() -> Self {
        let endpoint = free_endpoint();
        let options = Options::new("a").expect("a name").login_file("/none");
        let options = options.program("digger").expect("a name");
        let robot = options.listen(&endpoint).connect().await;
        let robot = robot.expect("connected");
        let options = ActionOptions::new("dig").about("digs a hole");
        let _dig = robot.action(options, dig).await.expect("declared");
        let options = ActionOptions::new("rest").refuse_when_busy();
        let _rest = robot.action(options, rest).await.expect("declared");
        Self {
            endpoint,
            robot,
            _dig,
            _rest,
        }
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
        command.arg("action").args(arguments);
        command.args(["--router", &self.endpoint]);
        command.stdin(Stdio::null());
        command
    }

    fn run(&self, arguments: &[&str]) -> Output {
        self.command(arguments).output().expect("started")
    }

    /// Runs `rect action` successfully, and returns what it prints.
    fn printed(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let problem = text(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {problem}");
        text(&output.stdout)
    }

    /// Runs `rect action`, which fails, and returns its message.
    fn failed(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        let printed = text(&output.stdout);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {printed}");
        text(&output.stderr)
    }

    /// Starts `rect action` with `--json`, and returns it with its lines.
    fn follow(&self, arguments: &[&str]) -> (Child, impl Iterator<Item = Value>) {
        let mut command = self.command(arguments);
        command.arg("--json").stdout(Stdio::piped());
        let mut child = command.spawn().expect("started");
        let lines = BufReader::new(child.stdout.take().expect("piped")).lines();
        let lines = lines.map(|line| serde_json::from_str(&line.expect("a line")).expect("JSON"));
        (child, lines)
    }
}

/// Sends Ctrl-C.
fn interrupt(child: &Child) {
    let sent = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status();
    assert!(sent.expect("sent").success());
}

fn until(lines: &mut impl Iterator<Item = Value>, phase: &str) -> Value {
    let found = lines.find(|line| line["phase"] == phase);
    found.unwrap_or_else(|| panic!("it was never {phase}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn start_prints_the_end_and_its_status_says_whether_it_is_done() {
    let digger = Digger::start().await;
    assert_eq!(
        digger.printed(&["start", "a", "dig", "3"]),
        "done: {\"dug\":3}\n"
    );
    let failed = digger.failed(&["start", "a", "dig", "0"]);
    assert!(failed.contains("the goal failed: rock"), "{failed}");
    let (mut child, lines) = digger.follow(&["start", "a", "dig", "4", "--id", "hole"]);
    let last = lines.last().expect("an end");
    assert_eq!(
        (&last["id"], &last["phase"], &last["result"]),
        (&json!("hole"), &json!("done"), &json!({"dug": 4}))
    );
    assert!(child.wait().expect("ended").success());
    // The same goal again has the same end.
    assert_eq!(
        digger.printed(&["start", "a", "dig", "4", "--id", "hole"]),
        "done: {\"dug\":4}\n"
    );
    assert_eq!(
        digger.printed(&["watch", "a", "dig", "hole"]),
        "done: {\"dug\":4}\n"
    );
    for (arguments, reason) in [
        (
            &["start", "a", "digg"][..],
            "no program of a has the action digg; did you mean dig?",
        ),
        (&["start", "b", "dig"], "b"),
        (&["watch", "a", "rest"], "a knows no goal of rest"),
        (&["watch", "b", "dig"], "reachable robots: a"),
        (&["watch", "a", "dig", "none"], "none"),
        (
            &["cancel", "a", "dig", "hole"],
            "a/dig/hole has ended already: done",
        ),
        (&["cancel", "a", "dig", "none"], "none"),
    ] {
        let message = digger.failed(arguments);
        assert!(message.contains(reason), "{arguments:?}: {message}");
    }
    let wrong = digger.run(&["start", "a", "a/b"]);
    assert_eq!(wrong.status.code(), Some(2));
    digger.robot.close().await.expect("closed");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_interrupt_cancels_the_goal_and_waits_for_its_end() {
    let digger = Digger::start().await;
    let (mut child, mut lines) = digger.follow(&["start", "a", "dig", "-1"]);
    let running = lines.find(|line| !line["progress"].is_null());
    let running = running.expect("feedback");
    assert_eq!(
        (
            &running["phase"],
            &running["progress"],
            &running["feedback"]
        ),
        (&json!("running"), &json!(0.5), &json!({"depth": -1}))
    );
    interrupt(&child);
    let end = until(&mut lines, "cancelled");
    assert_eq!(end["reason"], "by rect-tool");
    assert_eq!(child.wait().expect("ended").code(), Some(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_detached_goal_is_watched_listed_and_cancelled() {
    let digger = Digger::start().await;
    let id = digger.printed(&["start", "a", "rest", "--detach"]);
    let id = id.trim();
    let refused = digger.failed(&["start", "a", "rest"]);
    assert!(refused.contains("the goal was refused: busy"), "{refused}");
    let refused = digger.failed(&["start", "a", "rest", "--detach"]);
    assert!(refused.contains("the goal was refused: busy"), "{refused}");

    let (mut watching, mut lines) = digger.follow(&["watch", "a", "rest"]);
    assert_eq!(until(&mut lines, "running")["id"], id);
    // It ends the command only.
    interrupt(&watching);
    assert_eq!(watching.wait().expect("ended").code(), Some(130));

    let listed = digger.printed(&["list"]);
    let lines: Vec<Vec<&str>> = listed
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(lines[0], ["ACTION", "PROGRAM", "ABOUT"]);
    assert_eq!(lines[1], ["a/dig", "digger", "digs", "a", "hole"]);
    assert_eq!(lines[2], ["a/rest", "digger", "-"]);
    let place = format!("a/rest/{id}");
    assert_eq!(lines[5][..2], [place.as_str(), "running"], "{listed}");

    let (mut watching, mut lines) = digger.follow(&["watch", "a", "rest", id]);
    until(&mut lines, "running");
    let cancelled = digger.printed(&["cancel", "a", "rest", id]);
    assert_eq!(cancelled, format!("{place} is asked to end\n"));
    assert_eq!(until(&mut lines, "cancelled")["reason"], "by rect-tool");
    assert_eq!(watching.wait().expect("ended").code(), Some(1));

    let id = digger.printed(&["start", "a", "dig", "-1", "--detach"]);
    let listed = digger.printed(&["list", "a", "--json"]);
    let listed: Value = serde_json::from_str(&listed).expect("JSON");
    assert_eq!(
        listed["actions"]["a"]["dig"],
        json!({"program": "digger", "about": "digs a hole"})
    );
    let goals = listed["goals"].as_array().expect("goals");
    let (newest, before) = (&goals[0], &goals[1]);
    assert_eq!(
        (
            &newest["id"],
            &newest["phase"],
            &newest["goal"],
            &newest["by"]
        ),
        (
            &json!(id.trim()),
            &json!("running"),
            &json!(-1),
            &json!("rect-tool")
        )
    );
    assert_eq!(
        (&before["action"], &before["phase"]),
        (&json!("rest"), &json!("cancelled"))
    );
}

//! Tests `rect param`, connected to a robot in the test's own process: `cargo test -p rect-cli --test command parameter`
use std::{
    fs,
    process::{Command, Output, Stdio},
};

use rect::{GroupOptions, Options, Parameter, ParameterGroup, Robot};
use serde_json::{json, Value};
use tempfile::TempDir;
use zenoh::Wait;

use crate::pair::{free_endpoint, stock_client};

/// A robot with two groups of parameters, and the command that is connected to it.
struct Tuned {
    folder: TempDir,
    endpoint: String,
    drive: ParameterGroup,
    _arm: ParameterGroup,
    robot: Robot,
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn drive() -> Vec<Parameter> {
    vec![
        Parameter::new("kp", 1.0)
            .range(0.0, 10.0)
            .unit("1/s")
            .about("gain of the heading"),
        Parameter::new("side", "left").choices(["left", "right"]),
        Parameter::new("turbo", false),
        Parameter::new("points", vec![1.0, 2.0]),
        Parameter::new("robot_mass", 3.5).unit("kg").read_only(),
    ]
}

impl Tuned {
    /// Starts the program `drive` of the robot `a`. Its groups are `drive`, which it keeps in a file, and `arm`, which it does not.
    async fn start() -> Self {
        let (endpoint, folder) = (free_endpoint(), tempfile::tempdir().expect("a folder"));
        let options = Options::new("a").expect("a name").login_file("/none");
        let options = options.program("drive").expect("a name").listen(&endpoint);
        let robot = options.connect().await.expect("connected");
        let group = GroupOptions::with("drive", drive()).file(folder.path().join("drive.json"));
        let group = group.check(|values| match &values["turbo"] {
            turbo if *turbo == true.into() && values["kp"] == 10.0.into() => {
                Err("turbo needs a kp below 10".to_owned())
            }
            _ => Ok(()),
        });
        let drive = robot.parameters(group).await.expect("declared");
        let steps = vec![Parameter::new("steps", 3)];
        let arm = robot.parameters(GroupOptions::with("arm", steps).without_file());
        let _arm = arm.await.expect("declared");
        let tuned = Self {
            folder,
            endpoint,
            drive,
            _arm,
            robot,
        };
        // The values are published in the background.
        while tuned.run(&["get", "a/arm/steps"]).status.code() != Some(0) {}
        while tuned.run(&["get", "a/drive/kp"]).status.code() != Some(0) {}
        tuned
    }

    /// Runs `rect param` until it exits.
    fn run(&self, arguments: &[&str]) -> Output {
        let arguments = [&["param"], arguments, &["--router", &self.endpoint]].concat();
        let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
        let command = command.args(arguments).current_dir(self.folder.path());
        command.stdin(Stdio::null()).output().expect("started")
    }

    /// Runs `rect param` successfully, and returns what it prints.
    fn printed(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert!(
            output.status.success(),
            "{arguments:?}: {}",
            text(&output.stderr)
        );
        text(&output.stdout)
    }

    /// Runs `rect param`, which fails, and returns its message.
    fn failed(&self, arguments: &[&str]) -> String {
        let output = self.run(arguments);
        assert_ne!(
            output.status.code(),
            Some(0),
            "{arguments:?}: {}",
            text(&output.stdout)
        );
        text(&output.stderr)
    }

    fn write(&self, name: &str, profile: &Value) {
        fs::write(self.folder.path().join(name), profile.to_string()).expect("written");
    }

    fn read(&self, name: &str) -> Value {
        let text = fs::read_to_string(self.folder.path().join(name)).expect("a file");
        serde_json::from_str(&text).expect("JSON")
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn list_and_get_print_tables_or_json() {
    let tuned = Tuned::start().await;
    tuned.printed(&["set", "a/drive", "kp=2"]);
    let drive = "\
PARAMETER           VALUE      DEFAULT    RANGE              UNIT  ABOUT
a/drive/kp          2 *        1          0 to 10            1/s   gain of the heading
a/drive/side        \"left\"     \"left\"     left, right        -     -
a/drive/turbo       false      false      true, false        -     -
a/drive/points      [1.0,2.0]  [1.0,2.0]  list               -     -
a/drive/robot_mass  3.5        3.5        number, read-only  kg    -
";
    let steps = "a/arm/steps         3          3          integer            -     -\n";
    let legend = "*: not the default\n";
    let (heading, rows) = drive.split_once('\n').expect("lines");
    for arguments in [&["list"][..], &["list", "a"]] {
        assert_eq!(
            tuned.printed(arguments),
            format!("{heading}\n{steps}{rows}{legend}")
        );
    }
    let got = tuned.printed(&["get", "a/drive"]);
    assert!(
        got.starts_with(drive) && got.ends_with("last change: kp, by rect-tool\n"),
        "{got}"
    );

    let listed = tuned.printed(&["list", "--json"]);
    let listed: Value = serde_json::from_str(&listed).expect("JSON");
    let arm = json!({"name": "steps", "type": "integer", "default": 3, "value": 3});
    let group = &listed["a"]["arm"];
    assert_eq!(
        (&group["parameters"], &group["program"]),
        (&json!([arm]), &json!("drive"))
    );
    assert_eq!(listed["a"]["drive"]["changed"], json!(["kp"]));

    assert_eq!(tuned.printed(&["get", "a/drive/kp"]), "2.0\n");
    assert_eq!(tuned.printed(&["get", "a/drive/side"]), "\"left\"\n");
    for (place, reason) in [
        (
            "a/drive/turb",
            "there is no parameter \"turb\"; did you mean turbo?",
        ),
        (
            "a/driv",
            "no program of a has the parameters driv; did you mean drive?",
        ),
        ("a/driv/kp", "did you mean drive?"),
        ("b/drive", "at b; reachable robots: a"),
        ("b/drive/kp", "at b; reachable robots: a"),
        ("a", "<robot>/<group>"),
    ] {
        let message = tuned.failed(&["get", place]);
        assert!(message.contains(reason), "{message}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn set_and_reset_change_all_or_nothing() {
    let tuned = Tuned::start().await;
    let changed = tuned.printed(&["set", "a/drive", "kp=2.5", "side=right", "points=[3, 4.5]"]);
    let expected = "a/drive: kp = 2.5, points = [3.0,4.5], side = \"right\": in force and stored\n";
    assert_eq!(changed, expected);
    assert_eq!(tuned.drive.get()["kp"], 2.5.into());
    assert_eq!(
        tuned.read("drive.json"),
        json!({"kp": 2.5, "points": [3.0, 4.5], "side": "right"})
    );
    let changed = tuned.printed(&["set", "a/drive", "turbo=true", "--no-wait"]);
    assert_eq!(changed, "a/drive: turbo = true: in force\n");

    for (arguments, reason) in [
        (
            &["a/drive", "side=left", "kp=11"][..],
            "a/drive: refused: kp cannot be 11: the maximum is 10 1/s; nothing has changed",
        ),
        (
            &["a/drive", "side=left", "kp=nan"],
            "it must be a number, not a text",
        ),
        (
            &["a/drive", "side=left", "turb=1"],
            "there is no parameter \"turb\"; did you mean turbo?",
        ),
        (
            &["a/drive", "side=left", "robot_mass=1"],
            "robot_mass is read-only",
        ),
        (
            &["a/drive", "side=left", "kp=10"],
            "refused: turbo needs a kp below 10",
        ),
        (&["a/drive", "kp=1", "kp=2"], "kp occurs twice"),
        (&["a/driv", "kp=1"], "did you mean drive?"),
        (
            &["b/drive", "kp=1"],
            "b is not reachable; reachable robots: a",
        ),
        (&["a/drive", "kp"], "<name>=<value>"),
        (&["a/drive/kp", "2"], "write the group alone"),
    ] {
        let message = tuned.failed(&[&["set"], arguments].concat());
        assert!(message.contains(reason), "{message}");
    }
    assert_eq!(tuned.drive.get()["side"], "right".into());

    let changed = tuned.printed(&["reset", "a/drive", "kp"]);
    assert_eq!(changed, "a/drive: kp = 1: in force and stored\n");
    let message = tuned.failed(&["reset", "a/drive", "side", "turb"]);
    assert!(message.contains("did you mean turbo?"), "{message}");
    assert_eq!(tuned.drive.get()["side"], "right".into());
    tuned.printed(&["reset", "a/drive"]);
    assert_eq!(tuned.read("drive.json"), json!({}));
}

#[tokio::test(flavor = "multi_thread")]
async fn values_that_the_program_does_not_store_are_in_force_with_a_warning() {
    let tuned = Tuned::start().await;
    for (arguments, printed) in [
        (
            &["set", "a/arm", "steps=4"][..],
            "a/arm: steps = 4: in force\n",
        ),
        (
            &["reset", "a/arm", "steps"],
            "a/arm: the defaults of steps: in force\n",
        ),
    ] {
        let output = tuned.run(arguments);
        let warning = text(&output.stderr);
        assert!(output.status.success(), "{warning}");
        assert_eq!(text(&output.stdout), printed);
        assert!(
            warning.contains("warning: a/arm is not stored"),
            "{warning}"
        );
        assert!(
            warning.contains("does not keep its parameters in a file"),
            "{warning}"
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn exported_profile_is_imported_again() {
    let tuned = Tuned::start().await;
    tuned.printed(&["set", "a/drive", "kp=2", "side=right"]);
    let profile = json!({"a": {"arm": {}, "drive": {"kp": 2.0, "side": "right"}}});
    for arguments in [&["export"][..], &["export", "a", "a"]] {
        let exported: Value = serde_json::from_str(&tuned.printed(arguments)).expect("JSON");
        assert_eq!(exported, profile);
    }
    let written = tuned.printed(&["export", "--to", "practice.json"]);
    assert_eq!(
        written,
        "practice.json has the parameters of 1 robot, 2 groups\n"
    );
    assert_eq!(tuned.read("practice.json"), profile);
    let all: Value = serde_json::from_str(&tuned.printed(&["export", "--all"])).expect("JSON");
    let drive = json!({"kp": 2.0, "side": "right", "turbo": false, "points": [1.0, 2.0]});
    assert_eq!(all, json!({"a": {"arm": {"steps": 3}, "drive": drive}}));
    let message = tuned.failed(&["export", "a", "b", "--to", "practice.json"]);
    assert!(message.contains("no profile is written"), "{message}");
    assert_eq!(tuned.read("practice.json"), profile);

    // The values that the profile does not name get their defaults.
    tuned.printed(&["set", "a/drive", "kp=3", "side=left", "turbo=true"]);
    let would = tuned.printed(&["import", "practice.json", "--dry-run"]);
    let changes = "kp 3 -> 2, side \"left\" -> \"right\", turbo true -> false";
    assert!(
        would.contains(&format!("a/drive: would be set: {changes}\n")),
        "{would}"
    );
    assert!(would.contains("a/arm: unchanged\n"), "{would}");
    let end = "1 of 2 groups would be set, 1 unchanged\n";
    assert!(would.ends_with(end), "{would}");
    assert_eq!(tuned.drive.get()["kp"], 3.0.into());
    let imported = tuned.printed(&["import", "practice.json"]);
    assert!(
        imported.contains(&format!("a/drive: set: {changes}\n")),
        "{imported}"
    );
    assert!(
        imported.ends_with("1 of 2 groups set, 1 unchanged\n"),
        "{imported}"
    );
    assert_eq!(
        tuned.read("drive.json"),
        json!({"kp": 2.0, "side": "right"})
    );
    let imported = tuned.printed(&["import", "practice.json"]);
    assert!(
        imported.ends_with("0 of 2 groups set, 2 unchanged\n"),
        "{imported}"
    );

    tuned.write("part.json", &json!({"a": {"drive": {"turbo": true}}}));
    let imported = tuned.printed(&["import", "part.json", "--keep"]);
    assert_eq!(
        imported,
        "a/drive: set: turbo false -> true\n1 of 1 groups set\n"
    );
    assert_eq!(tuned.drive.get()["side"], "right".into());
}

#[tokio::test(flavor = "multi_thread")]
async fn import_of_which_a_part_fails_sets_the_rest() {
    let tuned = Tuned::start().await;
    let part = json!({
        "a": {"drive": {"side": "right", "turb": 2}, "arm": {"steps": 5}, "leg": {"kp": 1}},
        "b": {"drive": {"kp": 1}},
    });
    tuned.write("match.json", &part);
    for (option, set) in [
        ("--dry-run", "would be set: steps 3 -> 5"),
        ("--keep", "set: steps 3 -> 5; not stored"),
    ] {
        let output = tuned.run(&["import", "match.json", option]);
        assert_eq!(output.status.code(), Some(1));
        let printed = text(&output.stdout);
        for line in [
            format!("a/arm: {set}"),
            "a/drive: refused: there is no parameter \"turb\"; did you mean turbo?".to_owned(),
            "b/drive: not reachable".to_owned(),
        ] {
            assert!(
                printed.lines().any(|printed| printed.starts_with(&line)),
                "{printed}"
            );
        }
        assert!(
            printed.contains("a/leg: ") && printed.contains("the parameters leg"),
            "{printed}"
        );
        let message = text(&output.stderr);
        assert!(
            message.contains("1 of 4 groups ") && message.contains(", 3 "),
            "{message}"
        );
    }
    assert_eq!(tuned.drive.get()["side"], "left".into());
    let imported = tuned.printed(&[
        "import",
        "match.json",
        "--robot",
        "a",
        "--robot",
        "a",
        "--help",
    ]);
    assert!(imported.contains("Examples:"), "{imported}");
    let message = tuned.failed(&["import", "match.json", "--robot", "c"]);
    assert!(
        message.contains("match.json has no parameters of c; its robots: a, b"),
        "{message}"
    );
    fs::write(
        tuned.folder.path().join("wrong.json"),
        r#"{"a": {"drive": {"kp": 1, "kp": 2}}}"#,
    )
    .expect("written");
    for (file, reason) in [
        ("wrong.json", "wrong.json: \"kp\" occurs twice at line 1"),
        ("none.json", "none.json: No such file"),
    ] {
        let message = tuned.failed(&["import", file]);
        assert!(message.contains(reason), "{message}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn texts_of_hostile_programs_are_harmless() {
    const HOSTILE: &str = "\x1b]0;pwned\x07\u{9b}2J\nfake/c \u{202e}";
    let tuned = Tuned::start().await;
    let group = vec![Parameter::new("title", HOSTILE)];
    let group = GroupOptions::with("panel", group)
        .check(|_| Err(HOSTILE.to_owned()))
        .without_file();
    let _panel = tuned.robot.parameters(group).await.expect("declared");
    let stock = stock_client(&tuned.endpoint);
    let declaration = json!([{
        "instance": "0000001f",
        "program": "claw",
        "services": [{"topic": "@rect/@set/parameters/claw", "parameters": [
            {"name": "title", "type": "text", "default": HOSTILE},
        ]}],
    }]);
    let answer = move |query: zenoh::query::Query| {
        let reply = query.reply(query.key_expr(), declaration.to_string());
        reply.wait().expect("replied");
    };
    let catalogue = stock
        .declare_queryable("rect/c/@rect/catalogue")
        .callback(answer);
    let _catalogue = catalogue.wait().expect("declared");
    let profile = json!({"a": {"panel": {"title": "x"}}});
    tuned.write("profile.json", &profile);
    for arguments in [
        &["list", "a"][..],
        &["list", "c"],
        &["list", "c", "--json"],
        &["list", "a", "--json"],
        &["get", "a/panel/title"],
        &["set", "a/panel", "title=x"],
        &["export", "a"],
        &["import", "profile.json"],
    ] {
        let output = tuned.run(arguments);
        let shown = text(&[&output.stdout[..], &output.stderr].concat());
        let is_control = |c: char| c != '\n' && (c.is_control() || c == '\u{202e}');
        assert!(!shown.contains(is_control), "{arguments:?}: {shown:?}");
        assert!(
            !shown.lines().any(|line| line.starts_with("fake/")),
            "{arguments:?}: {shown:?}"
        );
    }
}

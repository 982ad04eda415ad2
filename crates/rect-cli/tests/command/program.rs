//! Tests `rect program list` and `rect service list`: `cargo test -p rect-cli --test command program`
use std::process::{Command, Output, Stdio};

use rect::{Json, Options, Robot, Service, ServiceOptions};
use serde_json::{json, Value};
use zenoh::Wait;

use crate::pair::{free_endpoint, stock_client};

/// Text of a hostile program, which sets the title of the terminal, adds a line, and changes the direction of text.
const HOSTILE: &str = "closes\x1b]0;pwned\x07\u{9b}2J\nfake/c  -  the\u{202e} gripper";

/// Runs `rect` until it exits.
fn ran(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
    let command = command.args(arguments).stdin(Stdio::null());
    command.output().expect("started")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Starts the program `arm` of the robot `a`, to which the command can connect; returns it with its endpoint.
async fn arm() -> (Robot, String) {
    let endpoint = free_endpoint();
    let options = Options::new("a").expect("a name").login_file("/none");
    let options = options.program("arm").expect("a name").listen(&endpoint);
    (options.connect().await.expect("connected"), endpoint)
}

async fn serve(robot: &Robot, topic: &str, about: &str, allow_several: bool) -> Service {
    let options = ServiceOptions {
        about: about.to_owned(),
        allow_several,
    };
    let served = robot.serve_with(topic, options, |_| async { Ok::<_, String>(Json(1)) });
    served.await.expect("served")
}

#[tokio::test(flavor = "multi_thread")]
async fn program_list_and_service_list_print_tables_or_json() {
    let (robot, endpoint) = arm().await;
    let listed = |arguments: &[&str]| {
        let output = ran(&[arguments, &["--router", &endpoint]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    assert_eq!(
        listed(&["program", "list", "a"]),
        "PROGRAM  SERVICES\na/arm    -\n"
    );
    let _grab = serve(&robot, "grab", "closes the gripper", false).await;
    let _look = serve(&robot, "look", "", true).await;
    let programs = "PROGRAM  SERVICES\na/arm    grab, look\n";
    let services = "SERVICE  PROGRAM  ABOUT\n\
                    a/grab   arm      closes the gripper\n\
                    a/look   arm      -\n";
    for (what, table) in [("program", programs), ("service", services)] {
        // All robots, or one.
        assert_eq!(listed(&[what, "list"]), table);
        assert_eq!(listed(&[what, "list", "a"]), table);
        let json = listed(&[what, "list", "a", "--json"]);
        let json: Value = serde_json::from_str(&json).expect("JSON");
        let expected = json!({"a": [{
            "program": "arm",
            "instance": json["a"][0]["instance"],
            "services": [
                {"topic": "grab", "about": "closes the gripper"},
                {"topic": "look", "several": true},
            ],
        }]});
        assert_eq!(json, expected);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn list_of_an_unreachable_robot_fails_with_those_that_are() {
    let (_robot, endpoint) = arm().await;
    for what in ["program", "service"] {
        let failed = ran(&[what, "list", "nobody", "--router", &endpoint]);
        assert_eq!(failed.status.code(), Some(1));
        let message = text(&failed.stderr);
        assert!(
            message.contains("(catalogue) at nobody") && message.contains("reachable robots: a"),
            "{message}"
        );
    }
}

/// Checks that a list contains no control characters, and no line that the hostile program has made up.
fn is_harmless(output: &Output) {
    let shown = text(&[&output.stdout[..], &output.stderr].concat());
    let is_control = |c: char| c != '\n' && (c.is_control() || c == '\u{202e}');
    assert!(!shown.contains(is_control), "{shown:?}");
    assert!(
        !shown.lines().any(|line| line.starts_with("fake/")),
        "{shown:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn control_characters_in_descriptions_are_harmless() {
    let (robot, endpoint) = arm().await;
    let _grab = serve(&robot, "grab", HOSTILE, false).await;
    // A stock program answers with the characters that the library has replaced.
    let stock = stock_client(&endpoint);
    let document = json!([{
        "program": "claw",
        "instance": "0000001f",
        "services": [{"topic": "grab", "about": HOSTILE}],
    }]);
    let answer = move |query: zenoh::query::Query| {
        let reply = query.reply(query.key_expr(), document.to_string());
        reply.wait().expect("replied");
    };
    let catalogue = stock.declare_queryable("rect/c/@rect/catalogue");
    let _catalogue = catalogue.callback(answer).wait().expect("declared");
    for robot in ["a", "c"] {
        for json in [&[][..], &["--json"]] {
            let arguments = ["service", "list", robot, "--router", &endpoint];
            let listed = ran(&[&arguments, json].concat());
            assert!(listed.status.success(), "{}", text(&listed.stderr));
            assert!(text(&listed.stdout).contains("closes"), "{listed:?}");
            is_harmless(&listed);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn hostile_names_and_topics_are_rejected() {
    let (_robot, endpoint) = arm().await;
    let stock = stock_client(&endpoint);
    for (robot, program, topic) in [("c", HOSTILE, "grab"), ("d", "claw", HOSTILE)] {
        let document = json!([{
            "program": program,
            "instance": "0000001f",
            "services": [{"topic": topic}],
        }]);
        let key = format!("rect/{robot}/@rect/catalogue");
        let answer = move |query: zenoh::query::Query| {
            let reply = query.reply(query.key_expr(), document.to_string());
            reply.wait().expect("replied");
        };
        let catalogue = stock.declare_queryable(key).callback(answer);
        catalogue.background().wait().expect("declared");
        let failed = ran(&["program", "list", robot, "--router", &endpoint]);
        assert_eq!(failed.status.code(), Some(1), "{failed:?}");
        let message = text(&failed.stderr);
        assert!(message.contains("catalogue"), "{message}");
        is_harmless(&failed);
    }
}

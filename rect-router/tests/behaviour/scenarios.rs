//! Runs the behaviour scenarios in `tests/conformance/behaviour/two_robots.json`, which Python (`rect-py/tests/test_behaviour.py`)
//! and C++ (`rect-cpp/tests/test_behaviour.cpp`) run, too: `cargo test -p rect-router --test behaviour scenarios`

mod outcome;
mod program;

use std::fs;

use crate::support::{free_socket, joined, repository, Air, Wombat};
use rect::{Options, Robot};
use serde_json::Value;

use self::program::Program;

/// The name of this language in the scenarios that apply to some languages only.
const LANGUAGE: &str = "rust";

#[tokio::test(flavor = "multi_thread")]
async fn linked_programs_behave_as_the_scenarios_state() {
    let document = document();
    for scenario in scenarios(&document, "link") {
        let endpoint = format!("tcp/{}", free_socket());
        let one = options("wombat-1").listen(&endpoint).connect().await;
        let two = options("wombat-2").endpoint(&endpoint).connect().await;
        let robots = [one.expect("listening"), two.expect("dialling")];
        run(&document, scenario, robots).await;
    }
}

#[test]
fn programs_at_routers_behave_as_the_scenarios_state() {
    let document = document();
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a directory"));
    let dials = crate::support::file(&[crate::support::ble("radio", "wombat-2")]);
    let two = Wombat::start(&air, &folder, 2, &crate::support::file(&[]));
    let one = Wombat::start(&air, &folder, 1, &dials);
    // Runtimes must not be nested, and the air has one.
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async {
        for scenario in scenarios(&document, "routers") {
            let robots = [
                joined("wombat-1", &one.endpoint).await,
                joined("wombat-2", &two.endpoint).await,
            ];
            run(&document, scenario, robots).await;
        }
    });
}

fn document() -> Value {
    let file = repository().join("tests/conformance/behaviour/two_robots.json");
    serde_json::from_str(&fs::read_to_string(file).expect("the scenarios")).expect("JSON")
}

/// Returns the scenarios of a network that apply to Rust.
fn scenarios<'a>(document: &'a Value, network: &'a str) -> impl Iterator<Item = &'a Value> {
    let names = |names: &Value, name: &str| {
        names
            .as_array()
            .is_some_and(|all| all.contains(&name.into()))
    };
    let all = document["scenarios"].as_array().expect("scenarios").iter();
    all.filter(move |scenario| {
        let languages = &scenario["languages"];
        names(&scenario["networks"], network) && (languages.is_null() || names(languages, LANGUAGE))
    })
}

fn options(name: &str) -> Options {
    Options::new(name).expect("a name").login_file("/none")
}

async fn run(document: &Value, scenario: &Value, [one, two]: [Robot; 2]) {
    println!("{}", scenario["about"]);
    let dictionaries = &document["dictionaries"];
    let mut one = Program::new(one, dictionaries);
    let mut two = Program::new(two, dictionaries);
    for step in scenario["steps"].as_array().expect("steps") {
        let program = match step["robot"].as_str() {
            Some("one") => &mut one,
            Some("two") => &mut two,
            other => panic!("{other:?} is not a robot"),
        };
        let (name, arguments) = step["do"]
            .as_array()
            .and_then(|all| all.split_first())
            .expect("a call");
        let outcome = program
            .call(name.as_str().expect("a name"), arguments)
            .await;
        outcome::check(&step["do"], &step["expect"], outcome);
    }
    one.close().await;
    two.close().await;
}

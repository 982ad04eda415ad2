//! Runs the scenarios in `tests/conformance/drivers/*.json`: what a driver of the core does, given events and the time. The
//! Python package runs the same files (`rect-py/tests/test_drivers.py`).
//!
//!     cargo test -p rect-core --test conformance drivers
//!     RECT_UPDATE_VECTORS=1 cargo test -p rect-core --test conformance drivers    # rewrites the expectations; review the diff
//!
//! A scenario names the driver and lists its steps. A step calls a method (`do`) and states what it returns (`expect`).
//! `poll_all` polls until the driver waits or has finished. Bytes are `{"text": ...}`, `{"hex": ...}`, `{"zeros": <length>}` or
//! `{"cbor": ...}`.
use std::{fs, path::PathBuf};

use serde_json::{json, Value};

mod arguments;
mod content;
mod describe;
mod program;
mod subject;

use subject::Subject;

#[test]
fn drivers_act_as_the_scenarios_state() {
    let folder = PathBuf::from(crate::FOLDER).join("drivers");
    let mut files: Vec<_> = fs::read_dir(&folder)
        .expect("the scenarios")
        .map(|entry| entry.expect("a file").path())
        .collect();
    files.sort();
    assert!(files.len() >= 10, "{files:?}");
    for file in files {
        let text = fs::read_to_string(&file).expect("text");
        let mut document: Value = serde_json::from_str(&text).expect("JSON");
        let updates = std::env::var_os("RECT_UPDATE_VECTORS").is_some();
        let scenarios = document["scenarios"].as_array_mut().expect("scenarios");
        assert!(!scenarios.is_empty());
        for scenario in scenarios {
            let about = format!("{}: {}", file.display(), scenario["about"]);
            let mut subject = Subject::new(&scenario["driver"]);
            for step in scenario["steps"].as_array_mut().expect("steps") {
                let found = subject.call(step["do"].as_array().expect("a call"));
                if updates {
                    step["expect"] = found;
                } else {
                    assert_eq!(step["expect"], found, "{about}: {}", step["do"]);
                }
            }
        }
        if updates {
            fs::write(&file, formatted(&document)).expect("written");
        }
    }
}

/// Formats a file with one line for each call and each expectation.
fn formatted(document: &Value) -> String {
    let scenario = |scenario: &Value| {
        let steps = scenario["steps"].as_array().expect("steps").iter();
        let steps: Vec<String> = steps
            .map(|step| {
                format!(
                    "        {{ \"do\": {},\n          \"expect\": {} }}",
                    step["do"], step["expect"]
                )
            })
            .collect();
        format!(
            "    {{\n      \"about\": {},\n      \"driver\": {},\n      \"steps\": [\n{}\n      ]\n    }}",
            scenario["about"],
            scenario["driver"],
            steps.join(",\n")
        )
    };
    let scenarios = document["scenarios"].as_array().expect("scenarios").iter();
    let scenarios: Vec<String> = scenarios.map(scenario).collect();
    format!(
        "{{\n  \"scenarios\": [\n{}\n  ]\n}}\n",
        scenarios.join(",\n")
    )
}

/// Returns the JSON of a value without meaning.
fn nothing() -> Value {
    json!(null)
}

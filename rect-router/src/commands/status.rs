//! Owns `rect-router status`: which robots there are, a line for each.
use serde_json::Value;

use super::{client::show, table::seconds, AskArgs, Failure};

const COLUMNS: [&str; 7] = [
    "ROBOT",
    "UP",
    "CONNECTED",
    "MISSING",
    "DISCOVERED",
    "CONNECTS TO",
    "VERSION",
];

pub fn run(args: &AskArgs) -> Result<(), Failure> {
    show(args, "status", &COLUMNS, |robot, status| {
        vec![row(robot, status)]
    })
}

fn row(robot: &str, status: &Value) -> Vec<String> {
    let counts = &status["connections"];
    let connected = |count: &Value| count["connected"].as_u64().unwrap_or(0);
    let by_method = counts["methods"].as_object().into_iter().flatten();
    let by_method: Vec<_> = by_method
        .filter(|(_, count)| connected(count) > 0)
        .map(|(method, count)| format!("{} {method}", connected(count)))
        .collect();
    let missing = counts["total"].as_u64().unwrap_or(0) - connected(counts);
    let connects_to = match status["auto_connect"].as_str() {
        Some("fleet") => format!("listed, {} of the fleet", status["auto_links"]),
        Some("none") => "nobody".to_owned(),
        _ => "listed".to_owned(),
    };
    let or_none = |texts: Vec<String>| match texts.is_empty() {
        true => "-".to_owned(),
        false => texts.join(", "),
    };
    vec![
        robot.to_owned(),
        (status["up_s"].as_f64()).map_or_else(|| "-".to_owned(), seconds),
        or_none(by_method),
        missing.to_string(),
        counts["discovered"].as_u64().unwrap_or(0).to_string(),
        connects_to,
        status["version"].as_str().unwrap_or("-").to_owned(),
    ]
}

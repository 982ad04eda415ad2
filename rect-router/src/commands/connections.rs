//! Owns `rect-router connections`: the registry's answer as a table or as JSON.
use rect::core::wording;
use serde_json::Value;

use super::{
    client::show,
    table::{bytes, seconds},
    ConnectionsArgs, Failure,
};

const COLUMNS: [&str; 12] = [
    "ROBOT",
    "NAME",
    "METHOD",
    "ADDRESS",
    "STATE",
    "PEER",
    "UP",
    "SENT",
    "RECEIVED",
    "ROUND TRIP",
    "SIGNAL",
    "LAST ERROR",
];

pub fn run(args: &ConnectionsArgs) -> Result<(), Failure> {
    let method = args.method.as_ref();
    let parameters = method.map_or_else(String::new, |method| format!("?method={method}"));
    let what = format!("connections{parameters}");
    show(&args.ask, &what, &COLUMNS, |robot, connections| {
        let all = connections.as_array().into_iter().flatten();
        all.map(|one| row(robot, one)).collect()
    })
}

fn row(robot: &str, one: &Value) -> Vec<String> {
    let text = |value: &Value| value.as_str().unwrap_or("-").to_owned();
    let number = |value: &Value, show: &dyn Fn(f64) -> String| {
        value.as_f64().map_or_else(|| "-".to_owned(), show)
    };
    let peer = match &one["peer"]["robot"] {
        Value::String(robot) => robot.clone(),
        _ => text(&one["peer"]["id"]).chars().take(8).collect(),
    };
    let carried = |way: &Value| {
        let count = way["bytes"].as_u64();
        count.map_or_else(|| "-".to_owned(), bytes)
    };
    vec![
        robot.to_owned(),
        text(&one["name"]),
        text(&one["method"]),
        text(&one["address"]),
        text(&one["state"]),
        peer,
        number(&one["up_s"], &seconds),
        carried(&one["sent"]),
        carried(&one["received"]),
        number(&one["round_trip_ms"], &wording::milliseconds),
        number(&one["rssi_dbm"], &|dbm| format!("{dbm:.0} dBm")),
        text(&one["last_error"]["what"]),
    ]
}

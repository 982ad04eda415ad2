//! Owns `rect-router connections`: the registry's answer as a table or as JSON.
use serde_json::Value;

use super::{
    client::{answers, nobody, session},
    table::{bytes, seconds, table},
    AskArgs, Failure,
};

pub fn run(args: &AskArgs) -> Result<(), Failure> {
    let session = session(&args.router)?;
    let method = args.method.as_ref();
    let parameters = method.map_or_else(String::new, |method| format!("?method={method}"));
    let selector = format!(
        "{}/{}/@rect/connections{parameters}",
        args.fleet, args.robot
    );
    let answers = answers(&session, &selector)?;
    if answers.is_empty() {
        return Err(nobody(&args.fleet, &args.robot));
    }
    if args.json {
        let all: serde_json::Map<_, _> = answers.into_iter().collect();
        println!("{:#}", Value::Object(all));
        return Ok(());
    }
    let names = [
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
    let mut shown = table(&names);
    for (robot, connections) in &answers {
        for one in connections.as_array().into_iter().flatten() {
            shown.add_row(row(robot, one));
        }
    }
    println!("{shown}");
    Ok(())
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
        number(&one["round_trip_ms"], &|ms| format!("{ms:.0} ms")),
        number(&one["rssi_dbm"], &|dbm| format!("{dbm:.0} dBm")),
        text(&one["last_error"]["what"]),
    ]
}

//! Owns `rect-router connections`: the registry's answer as a table or as JSON.
use std::{fs, path::Path, time::Duration};

use serde_json::Value;
use zenoh::{Config, Session, Wait};

use crate::message;

use super::{
    table::{bytes, seconds, table},
    AskArgs, Failure, RouterArgs,
};

/// How long to wait for answers: over a slow link, with several robots.
const PATIENCE: Duration = Duration::from_secs(5);

pub fn run(args: &AskArgs) -> Result<(), Failure> {
    let session = session(&args.router)?;
    let answers = ask(&session, args)?;
    if answers.is_empty() {
        let robot = &args.robot;
        let who = if robot == "*" { "no robot" } else { robot };
        return Err(format!(
            "{who} of fleet {} answers: does its router run, with plugins/rect in its configuration?",
            args.fleet
        )
        .into());
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
        text(&one["last_error"]["what"]),
    ]
}

/// Each robot's connections.
fn ask(session: &Session, args: &AskArgs) -> Result<Vec<(String, Value)>, Failure> {
    let method = args.method.as_ref();
    let parameters = method.map_or_else(String::new, |method| format!("?method={method}"));
    let selector = format!(
        "{}/{}/@rect/connections{parameters}",
        args.fleet, args.robot
    );
    let mut answers = Vec::new();
    for reply in session.get(selector).timeout(PATIENCE).wait()? {
        match reply.into_result() {
            Ok(sample) => {
                let key = sample.key_expr().as_str();
                let robot = key.split('/').nth(1).unwrap_or(key).to_owned();
                answers.push((robot, serde_json::from_slice(&sample.payload().to_bytes())?));
            }
            Err(error) => {
                let said = error.payload().to_bytes();
                return Err(String::from_utf8_lossy(&said).into_owned().into());
            }
        }
    }
    answers.sort_by(|(one, _), (other, _)| one.cmp(other));
    Ok(answers)
}

/// A client of that router, logged in where there is a login file.
pub(super) fn session(args: &RouterArgs) -> Result<Session, Failure> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", Value::from("client")),
        ("connect/endpoints", Value::from(vec![args.router.clone()])),
        ("scouting/multicast/enabled", Value::from(false)),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    if let Some((user, password)) = first_login(&args.users) {
        let login = serde_json::json!({ "user": user, "password": password });
        config.insert_json5("transport/auth/usrpwd", &login.to_string())?;
    }
    zenoh::open(config).wait().map_err(|error| {
        let why = message::with_causes(error.as_ref());
        format!("no router answers at {}: {why}", args.router).into()
    })
}

fn first_login(users: &Path) -> Option<(String, String)> {
    let text = fs::read_to_string(users).ok()?;
    let (user, password) = text.lines().find_map(|line| line.split_once(':'))?;
    Some((user.trim().to_owned(), password.trim().to_owned()))
}

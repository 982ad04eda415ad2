//! Owns what the commands share that ask a running router: a session with it, and the robots' answers.
use std::{fs, path::Path, time::Duration};

use serde_json::Value;
use zenoh::{Config, Session, Wait};

use super::{Failure, RouterArgs};
use crate::message;

/// How long to wait for answers: over a slow link, with several robots.
const PATIENCE: Duration = Duration::from_secs(5);

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

/// What each robot answers, by its name; an error that one answers is this one's, too.
pub(super) fn answers(session: &Session, selector: &str) -> Result<Vec<(String, Value)>, Failure> {
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

/// Nobody answered.
pub(super) fn nobody(fleet: &str, robot: &str) -> Failure {
    let who = if robot == "*" { "no robot" } else { robot };
    format!("{who} of fleet {fleet} answers: does its router run, with plugins/rect in its configuration?").into()
}

fn first_login(users: &Path) -> Option<(String, String)> {
    let text = fs::read_to_string(users).ok()?;
    let (user, password) = text.lines().find_map(|line| line.split_once(':'))?;
    Some((user.trim().to_owned(), password.trim().to_owned()))
}

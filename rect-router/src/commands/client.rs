//! Owns what the commands share that ask a running router: a session with it, and the robots' answers.
use std::{fs, time::Duration};

use rect::{
    core::{login, wording},
    terminal::{self, Table},
};
use serde_json::Value;
use zenoh::{Config, Session, Wait};

use super::{AskArgs, Failure, RouterArgs};

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
    let users = fs::read_to_string(&args.users).unwrap_or_default();
    if let Some((user, password)) = login::logins(&users).next() {
        let login = serde_json::json!({ "user": user, "password": password });
        config.insert_json5("transport/auth/usrpwd", &login.to_string())?;
    }
    zenoh::open(config).wait().map_err(|error| {
        let why = wording::with_causes(error.as_ref());
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

/// Prints what the robots answer about `what` of theirs: as JSON, or as the table that `table` makes of it.
pub(super) fn show(
    args: &AskArgs,
    what: &str,
    table: impl FnOnce(&[(String, Value)]) -> Result<Table, Failure>,
) -> Result<(), Failure> {
    let AskArgs { robot, fleet, .. } = args;
    let session = session(&args.router)?;
    let robots = answers(&session, &format!("{fleet}/{robot}/@rect/{what}"))?;
    if robots.is_empty() {
        let who = match robot.as_str() {
            "*" => "no robot".to_owned(),
            robot => format!("no robot {robot}"),
        };
        let advice = "does its router run, with plugins/rect in its configuration?";
        return Err(format!("{who} of fleet {fleet} answers: {advice}").into());
    }
    if args.json {
        let all: serde_json::Map<_, _> = robots.into_iter().collect();
        return Ok(terminal::json(&all)?);
    }
    table(&robots)?.print();
    Ok(())
}

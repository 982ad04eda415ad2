//! Owns what the commands share that ask a running router: a session with it, and the robots' answers.
use std::{
    net::{TcpStream, ToSocketAddrs},
    os::unix::net::UnixStream,
    time::Duration,
};

use rect::{
    core::{
        login,
        wording::{self, short_reason},
    },
    terminal::{self, Table},
};
use serde_json::Value;
use zenoh::{Config, Session, Wait};

use super::{AskArgs, Failure, RouterArgs};
use crate::config::read_login_file;

/// How long to wait for answers: over a slow link, with several robots.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long to wait for the router to accept a connection at all.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// There is no session with a router.
#[derive(Debug, thiserror::Error)]
#[error("{what}; {advice}")]
pub(super) struct NoSession {
    /// Why.
    pub what: String,
    /// How to mend it.
    pub advice: &'static str,
}

/// A client of that router, logged in where there is a login file.
pub(super) fn session(args: &RouterArgs) -> Result<Session, NoSession> {
    let users = read_login_file(&args.users).unwrap_or_default();
    let login = login::logins(&users).next();
    let opened = config(args, login).and_then(|config| zenoh::open(config).wait());
    opened.map_err(|error| no_session(args, login.map(|(user, _)| user), &error))
}

fn config(args: &RouterArgs, login: Option<(&str, &str)>) -> zenoh::Result<Config> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", Value::from("client")),
        ("connect/endpoints", Value::from(vec![args.router.clone()])),
        ("scouting/multicast/enabled", Value::from(false)),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    if let Some((user, password)) = login {
        let login = serde_json::json!({ "user": user, "password": password });
        config.insert_json5("transport/auth/usrpwd", &login.to_string())?;
    }
    Ok(config)
}

/// Why there is no session: nobody listens there, or the router does not let this program in.
fn no_session(args: &RouterArgs, user: Option<&str>, error: &zenoh::Error) -> NoSession {
    let (router, file) = (&args.router, args.users.display());
    let (what, advice) = match (is_listening(router), user) {
        (false, _) => (
            format!("no router answers at {router}: {}", short_reason(&wording::with_causes(error.as_ref()))),
            "start it (`rect init` writes its configuration), or name another one with --router",
        ),
        (true, Some(user)) => (
            format!("the router at {router} refuses the login {user} of {file}"),
            "name the login file of the router's team with --users",
        ),
        (true, None) => (
            format!("the router at {router} refuses programs without a login, and there is none in {file}"),
            "name the team's login file with --users; to read /etc/rect/users: `sudo usermod -aG rect $USER`, and log in again",
        ),
    };
    NoSession { what, advice }
}

/// Whether something accepts connections there.
fn is_listening(endpoint: &str) -> bool {
    let endpoint = endpoint.split(['#', '?']).next().unwrap_or_default();
    match endpoint.split_once('/') {
        Some(("tcp" | "tls" | "ws", address)) => {
            let mut addresses = address.to_socket_addrs().into_iter().flatten();
            addresses.any(|address| TcpStream::connect_timeout(&address, PROBE_TIMEOUT).is_ok())
        }
        Some(("unixsock-stream", path)) => UnixStream::connect(path).is_ok(),
        _ => false,
    }
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

//! Connects to a running router and queries the registry, for all commands that do so.
use std::{
    net::{TcpStream, ToSocketAddrs},
    os::unix::net::UnixStream,
    path::Path,
    thread,
    time::Duration,
};

use rect_core::{
    message::{encoding::Encoding, payload::Payload},
    registry::error_reply,
    session::{endpoint, login, router::CLOSED},
    text::{
        display::line,
        humanize::{self, short_reason},
    },
};
use rect_terminal::{self as terminal, Table};
use serde_json::Value;
use zenoh::{Config, Session, Wait};

use super::Failure;
use crate::{
    args::{QueryArgs, RouterArgs},
    config::read_login_file,
};

/// Timeout for replies, which several robots may send over a slow link.
const REPLY_TIMEOUT: Duration = Duration::from_secs(5);

/// Timeout for finding out whether the router accepts connections at all.
const PROBE_TIMEOUT: Duration = Duration::from_secs(2);

/// How often a command looks whether the router closes the session, and the pause between two looks.
const LOOKS: usize = 10;
const PAUSE: Duration = Duration::from_millis(50);

/// The reason why no session with a router could be opened.
#[derive(Debug, thiserror::Error)]
#[error("{what}; {advice}")]
pub(super) struct SessionError {
    /// Description of the problem.
    pub what: String,
    /// Advice on how to solve it.
    pub advice: &'static str,
}

/// Opens a client session with the router, logged in as the first user of the login file if there is one.
///
/// # Errors
/// The reason why the router did not accept the session, with advice.
pub(super) fn session(args: &RouterArgs) -> Result<Session, SessionError> {
    let users = read_login_file(&args.users).unwrap_or_default();
    let login = login::logins(&users).next();
    let opened = config(args, login).and_then(|config| zenoh::open(config).wait());
    opened.map_err(|error| session_error(args, login.map(|(user, _)| user), &error))
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

/// Finds out why there is no session: nothing listens at the endpoint, or the router rejected the login.
fn session_error(args: &RouterArgs, user: Option<&str>, error: &zenoh::Error) -> SessionError {
    let (router, file) = (&args.router, args.users.display());
    let (what, advice) = match (is_listening(router), user) {
        (false, _) => (
            format!("no router answers at {router}{}", connect_reason(error)),
            "start it (`rect init` writes its configuration), or give another endpoint with --router",
        ),
        (true, Some(user)) => (
            format!("the router at {router} refuses the login {user} of {file}"),
            "give the login file of the router's team with --users",
        ),
        (true, None) => (
            format!("the router at {router} refuses programs without a login, and {file} {}", missing_login(&args.users)),
            "give the team's login file with --users; to read /etc/rect/users, run `sudo usermod -aG rect $USER` and log in again",
        ),
    };
    SessionError { what, advice }
}

/// Returns the reason why Zenoh did not connect, after a colon; nothing if Zenoh only repeats the endpoint.
fn connect_reason(error: &zenoh::Error) -> String {
    let reason = short_reason(&humanize::with_causes(error.as_ref()));
    if reason.starts_with("Unable to connect to any of") {
        return String::new();
    }
    format!(": {reason}")
}

/// Describes a login file that contains no login for this program.
fn missing_login(file: &Path) -> &'static str {
    match file.try_exists() {
        Ok(true) => "contains none that you can read",
        Ok(false) => "does not exist",
        Err(_) => "cannot be read",
    }
}

/// Returns whether something accepts connections at the endpoint.
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

/// The replies of registries.
pub(super) struct Answers {
    /// The document of each robot, sorted by its name.
    pub documents: Vec<(String, Value)>,
    /// Problems of the other replies: a registry refused the query, or its reply is not JSON.
    pub problems: Vec<String>,
}

/// Queries the registries and returns their replies.
///
/// # Errors
/// Fails if the query cannot be sent.
pub(super) fn answers(session: &Session, selector: &str) -> Result<Answers, Failure> {
    let (mut documents, mut problems) = (Vec::new(), Vec::new());
    for reply in session.get(selector).timeout(REPLY_TIMEOUT).wait()? {
        match reply.into_result() {
            Ok(sample) => {
                let key = sample.key_expr().as_str();
                let robot = key.split('/').nth(1).unwrap_or(key).to_owned();
                match serde_json::from_slice(&sample.payload().to_bytes()) {
                    Ok(document) => documents.push((robot, document)),
                    Err(error) => {
                        problems.push(format!(
                            "cannot read the reply of {}: {error}",
                            line(&robot)
                        ));
                    }
                }
            }
            Err(error) => {
                let reply = Payload::new(error.payload().to_bytes().into_owned(), Encoding::TEXT);
                problems.push(error_reply("a robot", REPLY_TIMEOUT, &reply));
            }
        }
    }
    documents.sort_by(|(robot, _), (other_robot, _)| robot.cmp(other_robot));
    Ok(Answers {
        documents,
        problems,
    })
}

/// Returns whether the router closes the session. Zenoh opens it again and again, so that it may be open at the moment.
fn is_closed(session: &Session) -> bool {
    (0..LOOKS).any(|_| {
        thread::sleep(PAUSE);
        let info = session.info();
        info.routers_zid().wait().next().is_none() && info.peers_zid().wait().next().is_none()
    })
}

/// Queries the document `name` of the robots and prints the replies, as JSON or as the table that `table` returns. It adds to the
/// problems what it cannot show. Problems are printed, too; they fail the command only if there is no reply to show.
///
/// # Errors
/// Fails if there is no session, if no robot replies, or if all of them reply with an error.
pub(super) fn show(
    args: &QueryArgs,
    name: &str,
    table: impl FnOnce(&[(String, Value)], &mut Vec<String>) -> Table,
) -> Result<(), Failure> {
    let QueryArgs { robot, fleet, .. } = args;
    let session = session(&args.router)?;
    let Answers {
        documents,
        mut problems,
    } = answers(&session, &format!("{fleet}/{robot}/@rect/{name}"))?;
    if documents.is_empty() && is_closed(&session) {
        let RouterArgs { router, .. } = &args.router;
        let advice = endpoint::advice(router, CLOSED, "rect-router");
        return Err(format!("no router answers at {router}: {CLOSED}. {advice}").into());
    }
    if documents.is_empty() {
        if let Some(problem) = problems.into_iter().next() {
            return Err(problem.into());
        }
        let missing = match robot.as_str() {
            "*" => "no robot".to_owned(),
            robot => format!("no robot {robot}"),
        };
        let advice = "is its router running, with plugins/rect in its configuration? --fleet selects another fleet";
        return Err(format!("{missing} of the fleet {fleet} answers: {advice}").into());
    }
    if args.json {
        let all: serde_json::Map<_, _> = documents.into_iter().collect();
        terminal::json(&all)?;
    } else {
        table(&documents, &mut problems).print();
    }
    for problem in problems {
        rect_terminal::errln!("rect: {problem}");
    }
    Ok(())
}

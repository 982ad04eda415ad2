//! Checks the connections of this computer: its router, its peers and their clocks.

use rect_connections::file::{self, Limits};
use rect_core::{
    registry::{
        named_connection::CONFIG,
        topics::{Topics, TOPICS},
    },
    text::{display, humanize::short_reason},
};
use serde_json::Value;
use std::{
    collections::BTreeSet,
    thread,
    time::{Duration, Instant},
};
use zenoh::{Session, Wait};

use super::login;
use crate::{
    args::DoctorArgs,
    commands::client::{answers, session},
    doctor::{alerts, declarations, encryption, names, radio, refused, slow_link, Finding},
    registry::now_s,
};

/// Maximum difference between clocks in seconds. Zenoh drops no messages for a larger one by default, but the times of
/// messages cannot be compared.
const MAX_SKEW_S: f64 = 2.0;
/// How long the links count what they send.
const COUNTED: Duration = Duration::from_secs(2);
/// Timeout for liveliness tokens.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Checks the login file, the router, and everything that the router knows about the network. Returns also the adapters of the
/// router's Bluetooth listeners, if it answers.
pub fn findings(args: &DoctorArgs) -> (Vec<Finding>, Option<Vec<String>>) {
    let mut findings = login::findings(&args.router.users);
    let session = match session(&args.router) {
        Ok(session) => session,
        Err(error) => {
            findings.push(Finding::wrong("router", error.what, error.advice));
            return (findings, None);
        }
    };
    findings.push(Finding::good(
        "router",
        format!("the router answers at {}", args.router.router),
    ));
    let robot = robot_of_router(&session, &args.fleet);
    findings.push(robot_of_programs(args, robot.as_deref()));
    let mut adapters = None;
    if let Some(robot) = &robot {
        findings.extend(connections_file(&session, &args.fleet, robot));
        let counting = topics(&session, &args.fleet, robot);
        let asked = Instant::now();
        findings.push(others(&session, &args.fleet, robot));
        let own = format!("{}/{robot}/@rect", args.fleet);
        let status = replies(&session, &format!("{own}/status"));
        let may_choose = status
            .iter()
            .find_map(|(_, status)| status["chooses_intervals"].as_bool());
        let delayed = status
            .iter()
            .find_map(|(_, status)| status["delayed_declarations"].as_u64());
        adapters = status
            .iter()
            .find_map(|(_, status)| serde_json::from_value(status["adapters"].clone()).ok());
        findings.extend(declarations::finding(delayed.unwrap_or_default()));
        for (_, connections) in replies(&session, &format!("{own}/connections")) {
            findings.extend(radio::findings(&connections, may_choose));
            findings.extend(encryption::findings(
                &connections,
                adapters.as_deref().unwrap_or_default(),
            ));
            findings.extend(refused::findings(&connections));
        }
        if counting.is_some_and(|topics| !topics.links.is_empty()) {
            // The links count from the first question on.
            thread::sleep(COUNTED.saturating_sub(asked.elapsed()));
            let counted = topics(&session, &args.fleet, robot);
            let counted = counted.iter();
            findings.extend(counted.flat_map(|topics| slow_link::findings(robot, topics)));
        }
    }
    findings.extend(peers(&session));
    findings.extend(clocks(&session));
    let statuses = replies(&session, "*/*/@rect/status");
    findings.extend(alerts::findings(&statuses));
    findings.extend(names::findings(&statuses));
    (findings, adapters)
}

/// Returns what the router of a robot has counted since the last question.
fn topics(session: &Session, fleet: &str, robot: &str) -> Option<Topics> {
    let answers = replies(session, &format!("{fleet}/{robot}/@rect/{TOPICS}"));
    let (_, answer) = answers.into_iter().next()?;
    serde_json::from_value(answer).ok()
}

/// Returns the robot whose router this session is connected to.
fn robot_of_router(session: &Session, fleet: &str) -> Option<String> {
    let routers: Vec<_> = session
        .info()
        .routers_zid()
        .wait()
        .map(|id| id.to_string())
        .collect();
    let statuses = replies(session, &format!("{fleet}/*/@rect/status"));
    let is_its = |status: &Value| {
        status["id"]
            .as_str()
            .is_some_and(|id| routers.iter().any(|router| router == id))
    };
    statuses
        .into_iter()
        .find(|(_, status)| is_its(status))
        .map(|(robot, _)| robot)
}

/// Checks that the router belongs to the robot under whose name programs on this computer publish.
fn robot_of_programs(args: &DoctorArgs, robot: Option<&str>) -> Finding {
    const ABOUT: &str = "robot";
    let (router, fleet) = (&args.router.router, &args.fleet);
    match (robot, &args.robot) {
        (Some(robot), None) => Finding::good(ABOUT, format!("programs here publish as {robot} of the fleet {fleet}")),
        (Some(robot), Some(named)) if robot == named => {
            Finding::good(ABOUT, format!("programs here publish as {robot} of the fleet {fleet}"))
        }
        (Some(robot), Some(named)) => Finding::wrong(
            ABOUT,
            format!(
                "the router at {router} is that of {robot}, not of {named}: messages that a program here publishes as {named} may not reach any robot"
            ),
            format!("use the name {robot} in programs here, or give the endpoint of {named}'s router with --router"),
        ),
        (None, _) => Finding::poor(
            ABOUT,
            format!("the router at {router} does not belong to a robot of the fleet {fleet}"),
            "set the robot's name in the router's configuration (plugins/rect/robot), or give its fleet with --fleet",
        ),
    }
}

/// Checks that the connections file of the router's robot has no mistake.
fn connections_file(session: &Session, fleet: &str, robot: &str) -> Option<Finding> {
    const ABOUT: &str = "connections";
    let answers = replies(session, &format!("{fleet}/{robot}/@rect/{CONFIG}"));
    let (_, answer) = answers.into_iter().next()?;
    let limits = Limits {
        robot: robot.to_owned(),
        // These are settings of the router that it does not report.
        max_connections: usize::MAX,
        option_folders: vec!["/".into()],
    };
    Some(match file::parse(answer["text"].as_str()?, &limits) {
        Ok(_) => Finding::good(
            ABOUT,
            format!("the connections file of {robot} has no mistake"),
        ),
        Err(mistake) => Finding::wrong(
            ABOUT,
            format!("the router of {robot} rejects its connections file: {mistake}"),
            "correct the file; the router applies it as soon as it is saved",
        ),
    })
}

/// Checks that other robots of the fleet are present.
fn others(session: &Session, fleet: &str, own: &str) -> Finding {
    const ABOUT: &str = "fleet";
    let tokens = session.liveliness().get(format!("{fleet}/*/@rect/alive/*"));
    let mut robots = BTreeSet::new();
    for reply in tokens.timeout(TIMEOUT).wait().into_iter().flatten() {
        if let Ok(sample) = reply.into_result() {
            robots.extend(
                sample
                    .key_expr()
                    .as_str()
                    .split('/')
                    .nth(1)
                    .map(str::to_owned),
            );
        }
    }
    robots.remove(own);
    if robots.is_empty() {
        let advice =
            "switch one on within range; `rect scan` shows whether its advertisements are received";
        return Finding::poor(
            ABOUT,
            format!("no other robot of the fleet {fleet} is present"),
            advice,
        );
    }
    let robots: Vec<_> = robots.into_iter().collect();
    Finding::good(
        ABOUT,
        format!("other robots present: {}", robots.join(", ")),
    )
}

/// Reports named connections that are not connected.
fn peers(session: &Session) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (robot, waiting) in replies(session, "*/*/@rect/connections?state=connecting") {
        for connection in waiting.as_array().into_iter().flatten() {
            let text = |value: &Value| value.as_str().unwrap_or("?").to_owned();
            let why = connection["last_error"]["what"]
                .as_str()
                .unwrap_or("no attempt has failed yet");
            let what = format!(
                "{robot} has no connection {} to {}/{}: {}",
                text(&connection["name"]),
                text(&connection["method"]),
                text(&connection["address"]),
                short_reason(why)
            );
            findings.push(Finding::wrong("peer", what, refused::advice(why)));
        }
    }
    findings
}

/// Reports robots whose clock differs from this computer's.
fn clocks(session: &Session) -> Vec<Finding> {
    let asked = now_s();
    let mut findings = Vec::new();
    for (robot, clock) in replies(session, "*/*/@rect/clock") {
        // The clock was read at some time between the query and now.
        let (Some(theirs), answered) = (clock["unix_s"].as_f64(), now_s()) else {
            continue;
        };
        let skew = (theirs - answered).max(0.0) + (theirs - asked).min(0.0);
        if skew.abs() > MAX_SKEW_S {
            let what = format!(
                "the clock of {robot} differs from this computer's by {:+.0} s",
                skew
            );
            let advice =
                "set the clock (`sudo timedatectl set-ntp true`, or `sudo date -s ...` without a network)";
            findings.push(Finding::poor("clock", what, advice));
        }
    }
    findings
}

/// Returns the replies of robots by name. A missing reply is not an error.
fn replies(session: &Session, selector: &str) -> Vec<(String, Value)> {
    let mut replies = answers(session, selector).map_or_else(|_| Vec::new(), |all| all.documents);
    for (robot, _) in &mut replies {
        *robot = display::line(robot).into_owned();
    }
    replies
}

//! Owns what can be wrong between this computer and the others: its router, its peers, their clocks.
use serde_json::Value;
use zenoh::Session;

use super::Finding;
use crate::{
    commands::{
        client::{answers, session},
        RouterArgs,
    },
    registry::now_s,
};

/// Zenoh drops nothing for it by default, but what was when can't be told any more.
const SKEW: f64 = 2.0;

/// Of the router, and of all that it knows.
pub fn findings(args: &RouterArgs) -> Vec<Finding> {
    let session = match session(args) {
        Ok(session) => session,
        Err(error) => {
            let advice = "start it (`rect-router -c ...`), or give another one by --router; a login is taken from --users";
            return vec![Finding::wrong("router", error.to_string(), advice)];
        }
    };
    let mut findings = vec![Finding::good(
        "router",
        format!("it answers at {}", args.router),
    )];
    findings.extend(peers(&session));
    findings.extend(clocks(&session));
    findings
}

/// Connections that are wanted and not there.
fn peers(session: &Session) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (robot, waiting) in said(session, "*/*/@rect/connections?state=connecting") {
        for one in waiting.as_array().into_iter().flatten() {
            let text = |value: &Value| value.as_str().unwrap_or("?").to_owned();
            let why = one["last_error"]["what"]
                .as_str()
                .unwrap_or("it was never heard");
            let what = format!(
                "{robot} has no connection {} to {}/{}: {why}",
                text(&one["name"]),
                text(&one["method"]),
                text(&one["address"])
            );
            let advice = "is it switched on, in range, and called so? `rect-router connections` shows what there is";
            findings.push(Finding::wrong("peer", what, advice));
        }
    }
    findings
}

/// Robots whose clock is not this computer's.
fn clocks(session: &Session) -> Vec<Finding> {
    let asked = now_s();
    let mut findings = Vec::new();
    for (robot, clock) in said(session, "*/*/@rect/clock") {
        // It was read at some time between the question and now.
        let (Some(theirs), answered) = (clock["unix_s"].as_f64(), now_s()) else {
            continue;
        };
        let skew = (theirs - answered).max(0.0) + (theirs - asked).min(0.0);
        if skew.abs() > SKEW {
            let what = format!(
                "the clock of {robot} is {:+.0} s from this computer's",
                skew
            );
            let advice =
                "set it (`sudo timedatectl set-ntp true`, or `sudo date -s ...` without a network)";
            findings.push(Finding::poor("clock", what, advice));
        }
    }
    findings
}

/// What robots say; none that does is no trouble of its own.
fn said(session: &Session, selector: &str) -> Vec<(String, Value)> {
    answers(session, selector).unwrap_or_default()
}

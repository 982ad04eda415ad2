//! Reports robots that have asked for a link and got none, and gives advice on the reason of a failed attempt on either side.
use rect_core::text::humanize::duration_of_s;
use serde_json::Value;

use super::{peer, Finding};

/// A part of the reasons of both sides if a robot has another secret.
const OTHER_SECRET: &str = "same secret";

/// Returns a finding for each discovered robot that was refused a link. `connections` is the answer of a registry.
pub fn findings(connections: &Value) -> Vec<Finding> {
    let all = connections.as_array().into_iter().flatten();
    let refused = all.filter(|connection| connection["state"] == "discovered");
    refused.filter_map(finding).collect()
}

fn finding(connection: &Value) -> Option<Finding> {
    let reason = connection["last_error"]["what"].as_str()?;
    let ago = connection["last_error"]["ago_s"].as_f64()?;
    let times = match connection["failed"].as_u64() {
        Some(1) => "once".to_owned(),
        Some(count) => format!("{count} times"),
        None => "repeatedly".to_owned(),
    };
    let what = format!(
        "{} has asked for a link {times}, {} ago for the last time, and got none: {reason}",
        peer(connection),
        duration_of_s(ago)
    );
    Some(Finding::poor("peer", what, advice(reason)))
}

/// Returns what to do about an attempt that has failed for this reason.
pub fn advice(reason: &str) -> &'static str {
    if reason.contains(OTHER_SECRET) {
        return "if both robots are of one team, give both the same login file: copy /etc/rect/users of one to the other (`rect init \
                --users` for a new robot), and restart that router. If the other one is of another team, use another name of the \
                fleet (`rect init --fleet`)";
    }
    "is the robot switched on and in range, and is its name correct? `rect connections` shows all connections"
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn a_robot_with_another_secret_is_reported_by_the_side_that_refuses_it() {
        let error = json!({ "what": "it did not prove that it has the same secret", "ago_s": 1.4 });
        let refused = json!({ "method": "ble", "address": "wombat-2", "state": "discovered", "failed": 9, "last_error": error });
        let other = json!({ "method": "ble", "address": "wombat-3", "state": "discovered", "last_error": null });
        let dialled = json!({ "method": "ble", "address": "wombat-4", "state": "connecting", "last_error": error });
        let found = findings(&json!([refused, other, dialled]));
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!(found[0].verdict, Verdict::Poor);
        assert!(
            found[0]
                .what
                .starts_with("wombat-2 has asked for a link 9 times, 1.4 s ago"),
            "{found:?}"
        );
        let advice = found[0].advice.as_deref();
        assert!(advice.is_some_and(|advice| advice.contains("same login file")));
    }
}

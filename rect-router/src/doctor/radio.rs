//! Checks the air around a robot: how many Bluetooth links it has, how many robots are in range, how well it receives them,
//! and whether its router may choose connection intervals. docs/concepts/radio.md explains the limits.
use serde_json::Value;

use super::{has_radio, peer, Finding};

const ABOUT: &str = "radio";
/// Most controllers hold about this number of links.
const MAX_LINKS: usize = 7;
/// Number of robots in range up to which a robot finds its fleet within 10 s.
const MAX_ROBOTS: usize = 100;
/// Signal strength below which packets are lost now and then, in dBm.
const WEAK_DBM: i64 = -80;

/// Returns the findings about the Bluetooth connections of a robot, which are the answer of its registry. `may_choose` is
/// whether its router may choose connection intervals, if that is known.
pub fn findings(connections: &Value, may_choose: Option<bool>) -> Vec<Finding> {
    let ble = || {
        let all = connections.as_array().into_iter().flatten();
        all.filter(|connection| has_radio(connection))
    };
    let is = |state: &'static str| move |connection: &&Value| connection["state"] == state;
    let links = ble().filter(is("connected")).count();
    let robots = links + ble().filter(is("discovered")).count();
    if robots == 0 {
        return Vec::new();
    }
    let mut findings = vec![crowd(links, robots)];
    // Links of which this robot is the central have one clock. A link without a name was dialled by the other robot, or as
    // one of the fleet.
    let is_mixed = links > 1
        && ble()
            .filter(is("connected"))
            .any(|link| link["name"].is_null());
    if is_mixed && may_choose == Some(false) {
        findings.push(Finding::poor(
            ABOUT,
            format!("all {links} Bluetooth links have the same connection interval, so one of them may be lost now and then"),
            "start the router as the installed service, which may set the interval of each link, or let one robot dial all others \
             (docs/concepts/radio.md)",
        ));
    }
    findings.extend(ble().filter_map(weak));
    findings
}

fn crowd(links: usize, robots: usize) -> Finding {
    let what = format!("Bluetooth links: {links}, robots of the fleet in range: {robots}");
    if links > MAX_LINKS {
        return Finding::poor(
            ABOUT,
            what,
            "many adapters hold 7 links: connect the other robots to one of the linked ones, which forwards messages",
        );
    }
    if robots > MAX_ROBOTS {
        return Finding::poor(
            ABOUT,
            what,
            "with more than 100 robots in range, links take more than 10 s to open: divide the robots among halls, or use Wi-Fi",
        );
    }
    Finding::good(ABOUT, what)
}

fn weak(connection: &Value) -> Option<Finding> {
    let rssi_dbm = connection["rssi_dbm"].as_i64()?;
    if rssi_dbm >= WEAK_DBM {
        return None;
    }
    Some(Finding::poor(
        ABOUT,
        format!(
            "{} is received with {rssi_dbm} dBm, and packets are lost below {WEAK_DBM} dBm",
            peer(connection)
        ),
        "bring the two closer, or mount the antennas outside the metal (docs/how-to/distance.md)",
    ))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::doctor::Verdict;

    fn link(name: Option<&str>, rssi_dbm: i64) -> Value {
        json!({
            "name": name, "method": "ble", "state": "connected", "address": "wombat-2", "rssi_dbm": rssi_dbm,
            "peer": { "robot": "wombat-2" }
        })
    }

    fn not_good(connections: Value, may_choose: Option<bool>) -> Vec<String> {
        let findings = findings(&connections, may_choose).into_iter();
        let bad = findings.filter(|finding| finding.verdict != Verdict::Good);
        bad.map(|finding| finding.what).collect()
    }

    #[test]
    fn reports_the_numbers_of_links_and_robots() {
        let discovered =
            json!({ "name": null, "method": "ble", "state": "discovered", "rssi_dbm": -60 });
        let other = json!({ "name": "base", "method": "tcp", "state": "connected" });
        let found = findings(&json!([link(None, -60), discovered, other]), Some(false));
        assert_eq!(found.len(), 1);
        assert_eq!(
            found[0].what,
            "Bluetooth links: 1, robots of the fleet in range: 2"
        );
        assert_eq!(findings(&json!([other]), None), []);
    }

    #[test]
    fn links_over_several_paths_count() {
        let mut link = link(None, -60);
        link["method"] = json!("any");
        let found = findings(&json!([link]), None);
        assert!(
            found[0].what.starts_with("Bluetooth links: 1,"),
            "{found:?}"
        );
    }

    #[test]
    fn equal_intervals_matter_only_with_links_of_different_clocks() {
        let mixed = || json!([link(Some("radio"), -60), link(None, -60)]);
        assert!(not_good(mixed(), Some(false))[0].contains("the same connection interval"));
        assert!(not_good(mixed(), Some(true)).is_empty());
        assert!(not_good(mixed(), None).is_empty());
        let star = json!([link(Some("a"), -60), link(Some("b"), -60)]);
        assert!(not_good(star, Some(false)).is_empty());
    }

    #[test]
    fn warns_of_crowds_and_weak_signals() {
        assert!(not_good(json!([link(None, -81)]), None)[0]
            .contains("wombat-2 is received with -81 dBm"));
        assert!(not_good(json!([link(None, -80)]), None).is_empty());
        let links = |count| Value::from(vec![link(Some("a"), -60); count]);
        assert!(not_good(links(7), None).is_empty());
        assert!(not_good(links(8), None)[0].starts_with("Bluetooth links: 8,"));
        let robots = |count| {
            let robot = json!({ "name": null, "method": "ble", "state": "discovered" });
            Value::from(vec![robot; count])
        };
        assert!(not_good(robots(100), None).is_empty());
        assert!(not_good(robots(101), None)[0].ends_with(": 101"));
    }
}

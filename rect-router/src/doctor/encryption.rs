//! Checks that what leaves this computer is encrypted.
use serde_json::Value;

use super::{has_radio, is_simulated, peer, Finding};

const ABOUT: &str = "encryption";

/// Returns a finding for each link of a robot that is not encrypted. `connections` is the answer of its registry, and `adapters` are
/// those of its Bluetooth listeners. Links over the simulated air stay on this computer.
pub fn findings(connections: &Value, adapters: &[String]) -> Vec<Finding> {
    let all = connections.as_array().into_iter().flatten();
    let stays = |connection: &Value| has_radio(connection) && is_simulated(adapters);
    all.filter(|connection| connection["encrypted"] == false && !stays(connection))
        .map(unencrypted)
        .collect()
}

fn unencrypted(connection: &Value) -> Finding {
    // A link with the method `any` that is not encrypted uses Bluetooth alone.
    let (link, who, advice) = match has_radio(connection) {
        true => (
            "Bluetooth",
            "everybody in range",
            "give both robots the secret of the team: `rect init` on the first, and its login file on the other (docs/how-to/security.md)",
        ),
        false => (
            "network",
            "everybody on the network",
            "use TLS where others share the network (docs/how-to/security.md, \"Connect over Wi-Fi with TLS\")",
        ),
    };
    Finding::poor(
        ABOUT,
        format!(
            "the {link} link with {} is not encrypted: {who} can read and change messages",
            peer(connection)
        ),
        advice,
    )
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn found(method: &str, encrypted: Value) -> Vec<String> {
        let peer = json!({ "robot": "wombat-2" });
        let connection = json!({ "method": method, "peer": peer, "encrypted": encrypted });
        let findings = findings(&json!([connection]), &["hci0".to_owned()]).into_iter();
        findings.map(|finding| finding.what).collect()
    }

    #[test]
    fn warns_of_links_that_are_not_encrypted() {
        for method in ["any", "ble"] {
            assert!(found(method, json!(false))[0]
                .contains("the Bluetooth link with wombat-2 is not encrypted: everybody in range"));
        }
        assert!(found("tcp", json!(false))[0].contains("everybody on the network"));
    }

    #[test]
    fn is_silent_about_the_simulated_air() {
        let connection = json!({ "method": "ble", "address": "wombat-2", "encrypted": false });
        let network = json!({ "method": "tcp", "address": "10.0.0.2:7447", "encrypted": false });
        let found = |adapters: &[&str]| {
            let adapters = adapters
                .iter()
                .map(|&one| one.to_owned())
                .collect::<Vec<_>>();
            findings(&json!([connection, network]), &adapters).len()
        };
        assert_eq!(found(&["sim-1"]), 1);
        assert_eq!(
            (found(&["hci0"]), found(&["sim-1", "hci0"]), found(&[])),
            (2, 2, 2)
        );
    }

    #[test]
    fn is_silent_about_encrypted_links_and_links_within_the_computer() {
        for encrypted in [json!(true), json!(null)] {
            for method in ["ble", "tcp"] {
                assert!(found(method, encrypted.clone()).is_empty());
            }
        }
    }
}

//! Makes the configuration of a router that many fleets share from `config/cloud.json5`, and the connection to such a router.
use rect_connections::spec::{RawSpec, Spec};
use serde_json::json;

use super::Failure;

const TEMPLATE: &str = include_str!("../../../config/cloud.json5");
/// The fleets of the template. Each line that belongs to one contains its name after a quotation mark.
const TEMPLATE_FLEETS: [&str; 2] = ["\"red", "\"blue"];
/// The name of the connection to the shared router.
const NAME: &str = "cloud";

/// Returns the connection to the router at that endpoint, as it is in a connections file.
///
/// # Errors
/// Fails if it is not an endpoint with a host and a port.
pub fn connection(endpoint: &str) -> Result<String, Failure> {
    let parts = endpoint.split_once('/').and_then(|(method, place)| {
        let (host, port) = place.rsplit_once(':')?;
        Some((method, host, port.parse().ok()?))
    });
    let Some((method, host, port)) = parts else {
        return Err(format!(
            "--cloud {endpoint}: give the method, the host and the port, such as tls/cloud.example.org:7448"
        )
        .into());
    };
    let spec = RawSpec {
        name: NAME.to_owned(),
        method: method.to_owned(),
        address: host.to_owned(),
        port: Some(port),
        ..RawSpec::default()
    };
    Spec::of(spec).map_err(|error| format!("--cloud {endpoint}: {error}"))?;
    let connection = json!({ "name": NAME, "method": method, "address": host, "port": port });
    Ok(connection.to_string())
}

/// Checks that no fleet is given twice.
///
/// # Errors
/// Fails if one is.
pub fn check(fleets: &[String]) -> Result<(), Failure> {
    for (number, fleet) in fleets.iter().enumerate() {
        if fleets[..number].contains(fleet) {
            return Err(format!("--fleets: {fleet} is given twice").into());
        }
    }
    Ok(())
}

/// Returns the configuration for these fleets.
pub fn configuration(fleets: &[String]) -> String {
    let [first, other] = TEMPLATE_FLEETS;
    let mut text = String::new();
    for line in TEMPLATE.lines().filter(|line| !line.contains(other)) {
        if line.contains(first) {
            for fleet in fleets {
                text += &line.replace(first, &format!("\"{fleet}"));
                text += "\n";
            }
        } else {
            text += line;
            text += "\n";
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fleet_that_is_given_twice_is_named() {
        let fleets = ["red", "blue", "red"].map(str::to_owned);
        assert!(check(&fleets[..2]).is_ok());
        let error = check(&fleets).expect_err("twice");
        assert_eq!(error.to_string(), "--fleets: red is given twice");
    }

    #[test]
    fn an_endpoint_becomes_a_connection() {
        let text = connection("tls/[::1]:7448").expect("valid");
        let expected =
            json!({ "name": "cloud", "method": "tls", "address": "[::1]", "port": 7448 });
        let read: serde_json::Value = text.parse().expect("JSON");
        assert_eq!(read, expected);
        for wrong in ["example.org", "tls/example.org", "tls/a:99999", "smoke/a:1"] {
            let error = connection(wrong).expect_err("invalid").to_string();
            assert!(error.starts_with(&format!("--cloud {wrong}: ")), "{error}");
        }
    }

    #[test]
    fn each_fleet_has_a_region_a_rule_a_subject_and_a_policy() {
        let fleets = ["lions", "tigers", "bears"].map(str::to_owned);
        let text = configuration(&fleets);
        let config = zenoh::Config::from_json5(&text).expect("valid");
        let config = serde_json::to_value(&config).expect("JSON");
        for list in ["rules", "subjects", "policies"] {
            let parts = &config["access_control"][list];
            assert_eq!(parts.as_array().map(Vec::len), Some(3), "{list}");
            for (part, fleet) in parts.as_array().into_iter().flatten().zip(&fleets) {
                assert!(part.to_string().contains(&format!("\"{fleet}\"")), "{part}");
            }
        }
        let regions = config["gateway"]["south"].as_array().map(Vec::len);
        assert_eq!(regions, Some(4), "one more is for programs");
        assert!(
            !text.contains("\"red") && !text.contains("\"blue"),
            "{text}"
        );
    }
}

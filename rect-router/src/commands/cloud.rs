//! Makes the configuration of a router that many fleets share from `config/cloud.json5`.
use zenoh::config::EndPoint;

use super::Failure;

const TEMPLATE: &str = include_str!("../../../config/cloud.json5");
/// The fleets of the template. Each line that belongs to one contains its name after a quotation mark.
const TEMPLATE_FLEETS: [&str; 2] = ["\"red", "\"blue"];

/// Checks the fleets of such a router, and the endpoint of the one to connect to.
///
/// # Errors
/// Fails if a fleet is given twice, or if the endpoint is invalid.
pub fn check(fleets: &[String], endpoint: Option<&str>) -> Result<(), Failure> {
    for (number, fleet) in fleets.iter().enumerate() {
        if fleets[..number].contains(fleet) {
            return Err(format!("--fleets: {fleet} is given twice").into());
        }
    }
    let Some(endpoint) = endpoint else {
        return Ok(());
    };
    match endpoint.parse::<EndPoint>() {
        Ok(_) => Ok(()),
        Err(_) => Err(format!(
            "--cloud {endpoint}: this is not an endpoint; give one such as tls/cloud.example.org:7448"
        )
        .into()),
    }
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
    fn wrong_fleets_and_endpoints_are_named() {
        let reason = |fleets: &[&str], endpoint| {
            let fleets: Vec<_> = fleets.iter().map(|&fleet| fleet.to_owned()).collect();
            let checked = check(&fleets, endpoint);
            checked.err().map(|reason| reason.to_string())
        };
        assert_eq!(reason(&["red", "blue"], None), None);
        assert_eq!(reason(&[], Some("tls/example.org:7448")), None);
        let twice = "--fleets: red is given twice".to_owned();
        assert_eq!(reason(&["red", "blue", "red"], None), Some(twice));
        let endpoint = reason(&[], Some("example.org"));
        assert!(endpoint.expect("wrong").contains("not an endpoint"));
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

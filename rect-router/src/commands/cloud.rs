//! Makes the configuration of a router that many fleets share from `config/cloud.json5`.

const TEMPLATE: &str = include_str!("../../../config/cloud.json5");
/// The fleets of the template. Each line that belongs to one contains its name after a quotation mark.
const TEMPLATE_FLEETS: [&str; 2] = ["\"red", "\"blue"];

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

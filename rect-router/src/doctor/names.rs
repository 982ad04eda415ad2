//! Detects robots of a fleet that have the same name.
use serde_json::Value;

use super::Finding;

/// Reports robots that share a name, from the `status` documents.
pub fn findings(statuses: &[(String, Value)]) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (robot, status) in statuses {
        let others: Vec<_> = status["same_name"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .collect();
        if !others.is_empty() {
            let what = format!(
                "more than one robot is called {robot}: the routers {} and {}",
                status["id"].as_str().unwrap_or("?"),
                others.join(", ")
            );
            let advice = "give one of them another name (`rect-router init`, or `robot` under plugins/rect): other \
                          robots cannot distinguish their messages and replies";
            findings.push(Finding::wrong("name", what, advice));
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn reports_a_name_that_two_robots_share() {
        let statuses = [
            (
                "wombat-1".to_owned(),
                json!({ "id": "a1", "same_name": ["b2"] }),
            ),
            (
                "wombat-2".to_owned(),
                json!({ "id": "c3", "same_name": [] }),
            ),
            ("wombat-3".to_owned(), json!({ "id": "d4" })),
        ];
        let findings = findings(&statuses);
        assert_eq!(findings.len(), 1, "{findings:?}");
        let what = &findings[0].what;
        assert!(what.contains("wombat-1") && what.contains("b2"), "{what}");
    }
}

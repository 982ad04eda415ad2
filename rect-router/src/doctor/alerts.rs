//! Reports the alerts that programs of robots have raised.
use rect_core::text::humanize::duration_of_s;
use serde_json::Value;

use super::Finding;

/// Returns a finding for each alert in the status of the robots.
pub fn findings(statuses: &[(String, Value)]) -> Vec<Finding> {
    let alerts = statuses.iter().flat_map(|(robot, status)| {
        let alerts = status["alerts"].as_array().into_iter().flatten();
        alerts.filter_map(move |alert| finding(robot, alert))
    });
    alerts.collect()
}

fn finding(robot: &str, alert: &Value) -> Option<Finding> {
    let (text, level) = (alert["text"].as_str()?, alert["level"].as_str()?);
    let since = duration_of_s(alert["age_s"].as_f64()?);
    let what = format!("{robot}: {text} (since {since})");
    let advice = match (alert["has_ended"].as_bool()?, alert["name"].as_str()?) {
        (false, _) => format!("`rect log {robot}` shows what its programs report"),
        (true, name) => format!(
            "the program that raised it has ended; `rect log {robot}` shows why, and `rect alert clear {name}` on the robot clears it"
        ),
    };
    Some(match level {
        "error" => Finding::wrong("alert", what, advice),
        "warn" => Finding::poor("alert", what, advice),
        _ => Finding::good("alert", what),
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn an_alert_is_reported_with_its_robot_and_its_level() {
        let alert = json!({"name": "battery-low", "text": "battery low", "level": "warn", "age_s": 65.0, "has_ended": true});
        let statuses = [
            (
                "wombat-1".to_owned(),
                json!({"alerts": [alert, {"text": 5}]}),
            ),
            ("wombat-2".to_owned(), json!({})),
        ];
        let found = findings(&statuses);
        let [finding] = &found[..] else {
            panic!("{} findings", found.len());
        };
        assert_eq!(finding.verdict, Verdict::Poor);
        assert_eq!(finding.what, "wombat-1: battery low (since 65 s)");
        let advice = finding.advice.as_deref().unwrap_or_default();
        assert!(advice.contains("rect alert clear battery-low"), "{advice}");
    }
}

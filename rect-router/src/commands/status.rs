//! Implements `rect-router status`: shows the status of robots, one line each.
use rect_core::{log::level::Level, text::humanize::duration_of_s};
use rect_terminal::{Cell, Style, Table};
use serde_json::Value;

use super::{client::show, Failure};
use crate::args::QueryArgs;

const COLUMNS: [&str; 8] = [
    "ROBOT",
    "UP",
    "CONNECTED",
    "MISSING",
    "?DISCOVERED",
    "?CONNECTS TO",
    "?VERSION",
    "ALERTS",
];

/// Queries and prints the status of robots.
///
/// # Errors
/// Fails if no router or no robot answers.
pub fn run(args: &QueryArgs) -> Result<(), Failure> {
    show(args, "status", |robots, _| {
        let mut table = Table::new(&COLUMNS);
        for (robot, status) in robots {
            table.row(row(robot, status));
        }
        table
    })
}

fn row(robot: &str, status: &Value) -> Vec<Cell> {
    let counts = &status["connections"];
    let connected = |count: &Value| count["connected"].as_u64().unwrap_or(0);
    let by_method = counts["methods"].as_object().into_iter().flatten();
    let by_method: Vec<_> = by_method
        .filter(|(_, count)| connected(count) > 0)
        .map(|(method, count)| format!("{} {method}", connected(count)))
        .collect();
    let total = counts["total"].as_u64().unwrap_or(0);
    let connects_to = match status["auto_connect"].as_str() {
        Some("fleet") => format!("listed, {} of the fleet", status["auto_links"]),
        Some("none") => "none".to_owned(),
        _ => "listed".to_owned(),
    };
    vec![
        robot.into(),
        status["up_s"].as_f64().map(duration_of_s).into(),
        by_method.join(", ").into(),
        match total.saturating_sub(connected(counts)) {
            0 => "0".into(),
            missing => Cell::styled(Style::Poor, missing.to_string()),
        },
        counts["discovered"]
            .as_u64()
            .unwrap_or(0)
            .to_string()
            .into(),
        connects_to.into(),
        status["version"].as_str().unwrap_or_default().into(),
        alerts(&status["alerts"]),
    ]
}

/// Returns the alerts of a robot in the colour of the most important one.
fn alerts(alerts: &Value) -> Cell {
    let alerts = alerts.as_array().into_iter().flatten();
    let (mut texts, mut worst) = (Vec::new(), Level::Debug);
    for alert in alerts {
        let level = alert["level"].as_str().and_then(|level| level.parse().ok());
        worst = worst.max(level.unwrap_or_default());
        texts.extend(alert["text"].as_str());
    }
    let style = Style::of_level(worst).unwrap_or(Style::Faint);
    Cell::styled(style, texts.join("; "))
}

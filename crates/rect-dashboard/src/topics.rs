//! Queries the routers of robots for the topics that they publish.
use std::time::Duration;

use rect::{Name, Robot};
use rect_core::registry::topics::{Topics, KEEP, KEPT, TOPIC, TOPICS};

use crate::Failure;

/// Timeout of a query, chosen for a slow link with several robots.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Queries the routers, which continue to count for the time `keep`, and returns their replies, ordered by the robot's name.
pub async fn query(
    robot: &Robot,
    publisher: Option<&Name>,
    topic: Option<&str>,
    keep: Duration,
) -> Result<Vec<(String, Topics)>, Failure> {
    let fleet = robot.fleet();
    let publisher_name = publisher.map_or("*", Name::as_str);
    let mut parameters = Vec::new();
    parameters.extend(topic.map(|topic| format!("{TOPIC}={topic}")));
    if keep > KEPT {
        parameters.push(format!("{KEEP}={}", keep.as_secs()));
    }
    let parameters = parameters.join(";");
    let selector = format!("{fleet}/{publisher_name}/@rect/{TOPICS}?{parameters}");
    let replies = robot.zenoh().get(selector).timeout(TIMEOUT).await?;
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        let sample = reply.into_result().map_err(|error| {
            let text = error.payload().to_bytes();
            Failure::from(String::from_utf8_lossy(&text).into_owned())
        })?;
        let key = sample.key_expr().as_str();
        let name = key.split('/').nth(1).unwrap_or(key).to_owned();
        answers.push((name, serde_json::from_slice(&sample.payload().to_bytes())?));
    }
    if answers.is_empty() {
        let asked = publisher.map_or_else(
            || "no robot".to_owned(),
            |robot| format!("no robot {robot}"),
        );
        return Err(format!(
            "{asked} of the fleet {fleet} replied about its topics. Is its router running, with plugins/rect in its configuration?"
        )
        .into());
    }
    answers.sort_by(|(one, _), (other, _)| one.cmp(other));
    Ok(answers)
}

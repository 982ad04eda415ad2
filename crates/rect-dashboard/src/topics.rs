//! Queries the routers of robots for the topics that they publish.
use std::time::Duration;

use rect::{Encoding, Name, Payload, Robot};
use rect_core::{
    registry::{
        error_reply,
        topics::{Topics, KEEP, KEPT, TOPIC, TOPICS},
    },
    text::display::line,
};

use crate::Failure;

/// Timeout of a query, chosen for a slow link with several robots.
pub const QUERY_TIMEOUT: Duration = Duration::from_secs(5);

/// The replies of routers.
pub struct Answers {
    /// The topics of each robot, in the order of their names.
    pub topics: Vec<(String, Topics)>,
    /// Problems of the other replies: a router refused the query, or its reply cannot be read.
    pub problems: Vec<String>,
}

/// Queries the routers, which continue to count for the time `keep`, and returns their topics, ordered by the robot's name. A robot
/// whose router replies with an error is left out.
///
/// # Errors
/// Returns the errors of [`answers`].
pub async fn query(
    robot: &Robot,
    publisher: Option<&Name>,
    topic: Option<&str>,
    keep: Duration,
) -> Result<Vec<(String, Topics)>, Failure> {
    Ok(answers(robot, publisher, topic, keep).await?.topics)
}

/// Queries the routers, which continue to count for the time `keep`, and returns their replies.
///
/// # Errors
/// Fails if no router replies, or if all of them reply with an error.
pub async fn answers(
    robot: &Robot,
    publisher: Option<&Name>,
    topic: Option<&str>,
    keep: Duration,
) -> Result<Answers, Failure> {
    let fleet = robot.fleet();
    let publisher_name = publisher.map_or("*", Name::as_str);
    let mut parameters = Vec::new();
    parameters.extend(topic.map(|topic| format!("{TOPIC}={topic}")));
    if keep > KEPT {
        parameters.push(format!("{KEEP}={}", keep.as_secs()));
    }
    let parameters = parameters.join(";");
    let selector = format!("{fleet}/{publisher_name}/@rect/{TOPICS}?{parameters}");
    let replies = robot.zenoh().get(selector).timeout(QUERY_TIMEOUT).await?;
    let (mut topics, mut problems) = (Vec::new(), Vec::new());
    while let Ok(reply) = replies.recv_async().await {
        match reply.into_result() {
            Ok(sample) => {
                let key = sample.key_expr().as_str();
                let name = key.split('/').nth(1).unwrap_or(key).to_owned();
                match serde_json::from_slice(&sample.payload().to_bytes()) {
                    Ok(found) => topics.push((name, found)),
                    Err(error) => problems.push(format!(
                        "cannot read the topics of {}; does that robot run the same version of RECT? {error}",
                        line(&name)
                    )),
                }
            }
            Err(error) => {
                let who = publisher.map_or("a robot", Name::as_str);
                let reply = Payload::new(error.payload().to_bytes().into_owned(), Encoding::TEXT);
                problems.push(error_reply(who, QUERY_TIMEOUT, &reply));
            }
        }
    }
    if topics.is_empty() {
        if let Some(problem) = problems.into_iter().next() {
            return Err(problem.into());
        }
        let asked = publisher.map_or_else(
            || "no robot".to_owned(),
            |robot| format!("no robot {robot}"),
        );
        return Err(format!(
            "{asked} of the fleet {fleet} replied about its topics. Is its router running, with plugins/rect in its configuration?"
        )
        .into());
    }
    topics.sort_by(|(one, _), (other, _)| one.cmp(other));
    Ok(Answers { topics, problems })
}

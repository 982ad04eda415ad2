//! Implements `rect-router connections`: prints the connections of robots as a table or as JSON.
use rect_core::registry::connection::Connection;
use rect_terminal::connections_of_robots;

use super::{client::show, Failure};
use crate::args::ConnectionsArgs;

/// Queries and prints the connections.
///
/// # Errors
/// Fails if no router or no robot answers, or if a reply cannot be parsed.
pub fn run(args: &ConnectionsArgs) -> Result<(), Failure> {
    let method = args.method.as_ref();
    let parameters = method.map_or_else(String::new, |method| format!("?method={method}"));
    let name = format!("connections{parameters}");
    show(&args.query, &name, |robots| {
        let read = |(robot, answer): &(String, serde_json::Value)| {
            let connections: Vec<Connection> =
                serde_json::from_value(answer.clone()).map_err(|error| {
                    format!("cannot parse the connections of {robot}; does that robot run the same version of RECT? {error}")
                })?;
            Ok((robot.clone(), connections))
        };
        let robots: Vec<_> = robots.iter().map(read).collect::<Result<_, Failure>>()?;
        let each = robots
            .iter()
            .map(|(robot, connections)| (robot.as_str(), connections.as_slice()));
        Ok(connections_of_robots(each))
    })
}

//! Implements `rect-router connections`: prints the connections of robots as a table or as JSON.
use rect_core::{registry::connection::Connection, text::display::line};
use rect_terminal::connections_of_robots;

use super::{client::show, Failure};
use crate::args::ConnectionsArgs;

/// Queries and prints the connections.
///
/// # Errors
/// Fails if no router or no robot answers.
pub fn run(args: &ConnectionsArgs) -> Result<(), Failure> {
    let method = args.method.as_ref();
    let parameters = method.map_or_else(String::new, |method| format!("?method={method}"));
    let name = format!("connections{parameters}");
    show(&args.query, &name, |robots, problems| {
        let mut read = Vec::new();
        for (robot, answer) in robots {
            match serde_json::from_value::<Vec<Connection>>(answer.clone()) {
                Ok(connections) => read.push((robot.as_str(), connections)),
                Err(error) => problems.push(format!(
                    "cannot read the connections of {}; does that robot run the same version of RECT? {error}",
                    line(robot)
                )),
            }
        }
        let each = read
            .iter()
            .map(|(robot, connections)| (*robot, connections.as_slice()));
        connections_of_robots(each)
    })
}

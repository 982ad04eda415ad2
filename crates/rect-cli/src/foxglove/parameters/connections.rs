//! Shows the named connections of the robot's router as parameters.
use std::collections::BTreeMap;

use foxglove::websocket::Parameter;
use rect::{Connection, Error, Robot};
use serde_json::json;

/// Returns a parameter for each named connection of the router.
pub async fn all(robot: &Robot) -> Result<Vec<Parameter>, Error> {
    match robot.connections().await {
        Ok(connections) => Ok(connections.iter().filter_map(parameter).collect()),
        // A router without the registry, such as a stock zenohd.
        Err(Error::NoService { .. }) => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

/// Returns the parameter of a named connection; `None` for other links.
fn parameter(connection: &Connection) -> Option<Parameter> {
    let name = connection.name.as_ref()?;
    let failure = connection.last_error.as_ref();
    let fields = [
        ("method", json!(connection.method)),
        ("address", json!(connection.address)),
        ("state", json!(connection.state)),
        ("robot", json!(connection.robot())),
        ("last_error", json!(failure.map(|failure| &failure.what))),
    ];
    // Parameters cannot be null: what is not known is left out.
    let known = fields.into_iter().filter_map(|(field, value)| {
        let value = serde_json::from_value(value).ok()?;
        Some((field.to_owned(), value))
    });
    let fields = BTreeMap::from_iter(known);
    Some(Parameter::dict(format!("connections/{name}"), fields))
}

//! Shows the named connections of the robot's router as parameters.
use std::collections::BTreeMap;

use foxglove::websocket::{
    AnyClient, GetParametersResponder, Parameter, ParameterHandler, SetParametersResponder,
};
use rect::{Connection, Error, Robot};
use serde_json::json;
use tokio::runtime::Handle;

/// Answers viewers that ask for parameters.
pub struct Parameters {
    robot: Robot,
    runtime: Handle,
}

impl Parameters {
    /// Creates the answers for the router of `robot`. Call it on a tokio runtime.
    pub fn new(robot: Robot) -> Self {
        let runtime = Handle::current();
        Self { robot, runtime }
    }
}

impl ParameterHandler for Parameters {
    fn get(
        &self,
        client: AnyClient,
        names: Vec<String>,
        _request_id: Option<String>,
        responder: GetParametersResponder,
    ) {
        let robot = self.robot.clone();
        self.runtime.spawn(async move {
            let mut parameters = all(&robot).await.unwrap_or_else(|error| {
                client.send_error(error.to_string());
                Vec::new()
            });
            parameters.retain(|parameter| names.is_empty() || names.contains(&parameter.name));
            responder.respond(parameters);
        });
    }

    fn set(
        &self,
        client: AnyClient,
        _parameters: Vec<Parameter>,
        _request_id: Option<String>,
        responder: SetParametersResponder,
    ) {
        client.send_error(
            "connections are changed with `rect connect` and `rect disconnect`, or in `rect dashboard`",
        );
        responder.respond(Vec::new());
    }
}

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

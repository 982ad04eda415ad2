//! Parses the parameters of a query to the registry, such as `?method=ble;state=connected`.
use super::connection::{Connection, ConnectionState as State};

/// Selects connections. An omitted parameter matches every connection.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selector {
    method: Option<String>,
    name: Option<String>,
    peer: Option<String>,
    state: Option<State>,
    min_connections: Option<usize>,
}

const KNOWN_PARAMETERS: &str =
    "method, name, peer, state (connected, connecting or discovered), min_connections";

impl Selector {
    /// Parses the parameters of a query, given as keys with values. Keys that begin with `_` are Zenoh's own and are ignored.
    ///
    /// # Errors
    /// A message for the requester if a parameter is unknown, empty or invalid.
    pub fn parse<'a>(parameters: impl Iterator<Item = (&'a str, &'a str)>) -> Result<Self, String> {
        let mut selector = Self::default();
        for (key, value) in parameters {
            if key.is_empty() || key.starts_with('_') {
                continue;
            }
            if value.is_empty() {
                return Err(format!("{key} has no value; known are {KNOWN_PARAMETERS}"));
            }
            let text = || Some(value.to_owned());
            match key {
                "method" => selector.method = text(),
                "name" => selector.name = text(),
                "peer" => selector.peer = text(),
                "state" => {
                    let state = State::parse(value);
                    let error =
                        || format!("state={value}: a state is connected, connecting or discovered");
                    selector.state = Some(state.ok_or_else(error)?);
                }
                "min_connections" => {
                    let error = |_| format!("min_connections={value}: must be a whole number");
                    selector.min_connections = Some(value.parse().map_err(error)?);
                }
                _ => return Err(format!("`{key}` is unknown; known are {KNOWN_PARAMETERS}")),
            }
        }
        Ok(selector)
    }

    /// Returns whether a connection matches.
    pub fn matches(&self, connection: &Connection) -> bool {
        let is_peer = |name: &String| {
            let peer = connection.peer.as_ref();
            peer.is_some_and(|peer| peer.id == *name || peer.robot.as_ref() == Some(name))
        };
        self.method.as_ref().is_none_or(|m| *m == connection.method)
            && (self.name.as_ref()).is_none_or(|name| connection.name.as_ref() == Some(name))
            && self.state.is_none_or(|state| state == connection.state)
            && self.peer.as_ref().is_none_or(is_peer)
    }

    /// Returns whether a peer with `connections` matching connections matches: it needs `min_connections`, by default one.
    pub fn matches_peer(&self, connections: usize) -> bool {
        connections >= self.min_connections.unwrap_or(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_parameters_and_names_invalid_ones() {
        let parse = |text: &str| {
            let parameters = text.split(';').filter(|parameter| !parameter.is_empty());
            Selector::parse(parameters.map(|one| one.split_once('=').unwrap_or((one, ""))))
        };
        let read =
            parse("method=ble;state=connected;_time=[now()];min_connections=2").expect("valid");
        assert_eq!(read.method.as_deref(), Some("ble"));
        assert_eq!(
            (read.state, read.min_connections),
            (Some(State::Connected), Some(2))
        );
        assert_eq!(parse(""), Ok(Selector::default()));
        for (wrong, expected) in [
            ("metod=ble", "`metod`"),
            ("state=up", "state=up"),
            ("min_connections=-1", "min_connections=-1"),
            ("min_connections=many", "many"),
            ("method", "method has no value"),
        ] {
            let error = parse(wrong).expect_err(wrong);
            assert!(error.contains(expected), "{error}");
        }
    }
}

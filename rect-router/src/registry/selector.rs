//! Owns the parameters of a question to the registry: `?method=ble;state=connected`.
use rect::core::connection::{Connection, ConnectionState as State};
use zenoh::query::Parameters;

use super::document::Peer;

/// What is asked for; what is left out holds for all.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selector {
    method: Option<String>,
    name: Option<String>,
    peer: Option<String>,
    state: Option<State>,
    min_connections: Option<usize>,
}

const KNOWN: &str =
    "method, name, peer, state (connected, connecting or discovered), min_connections";

impl Selector {
    /// Reads it; an error says what is known. Zenoh's own parameters begin with `_`.
    pub fn parse(parameters: &Parameters<'_>) -> Result<Self, String> {
        let mut selector = Self::default();
        for (key, value) in parameters.iter() {
            if key.is_empty() || key.starts_with('_') {
                continue;
            }
            if value.is_empty() {
                return Err(format!("{key} has no value; known are {KNOWN}"));
            }
            let text = || Some(value.to_owned());
            match key {
                "method" => selector.method = text(),
                "name" => selector.name = text(),
                "peer" => selector.peer = text(),
                "state" => {
                    let state = State::parse(value);
                    let wanted =
                        || format!("state={value}: a state is connected, connecting or discovered");
                    selector.state = Some(state.ok_or_else(wanted)?);
                }
                "min_connections" => {
                    let wanted = |_| format!("min_connections={value}: a whole number is wanted");
                    selector.min_connections = Some(value.parse().map_err(wanted)?);
                }
                _ => return Err(format!("`{key}` is unknown; known are {KNOWN}")),
            }
        }
        Ok(selector)
    }

    /// Whether a connection is asked for.
    pub fn takes(&self, connection: &Connection) -> bool {
        let is_peer = |wanted: &String| {
            let peer = connection.peer.as_ref();
            peer.is_some_and(|peer| peer.id == *wanted || peer.robot.as_ref() == Some(wanted))
        };
        self.method.as_ref().is_none_or(|m| *m == connection.method)
            && (self.name.as_ref()).is_none_or(|name| connection.name.as_ref() == Some(name))
            && self.state.is_none_or(|state| state == connection.state)
            && self.peer.as_ref().is_none_or(is_peer)
    }

    /// Whether a peer is asked for, which has one at least of the connections asked for.
    pub fn takes_peer(&self, peer: &Peer) -> bool {
        peer.connections.len() >= self.min_connections.unwrap_or(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_read_or_named() {
        let parse = |text: &str| Selector::parse(&Parameters::from(text));
        let read =
            parse("method=ble;state=connected;_time=[now()];min_connections=2").expect("valid");
        assert_eq!(read.method.as_deref(), Some("ble"));
        assert_eq!(
            (read.state, read.min_connections),
            (Some(State::Connected), Some(2))
        );
        assert_eq!(parse(""), Ok(Selector::default()));
        for (wrong, named) in [
            ("metod=ble", "`metod`"),
            ("state=up", "state=up"),
            ("min_connections=-1", "min_connections=-1"),
            ("min_connections=many", "many"),
            ("method", "method has no value"),
        ] {
            let error = parse(wrong).expect_err(wrong);
            assert!(error.contains(named), "{error}");
        }
    }
}

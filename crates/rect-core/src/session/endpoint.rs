//! Parses the endpoint of a router as people write it, and determines the default.

/// The environment variable that names the router, for programs that do not set one.
pub const ROUTER_VARIABLE: &str = "RECT_ENDPOINT";

/// The endpoint at which a robot's router serves its programs by default.
pub const DEFAULT_ROUTER: &str = "tcp/127.0.0.1:7447";

/// The protocol of an endpoint without one.
const DEFAULT_PROTOCOL: &str = "tcp";

/// The text is not a valid endpoint. Write it as `tcp/127.0.0.1:7447`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not an endpoint: write <protocol>/<address>, such as tcp/127.0.0.1:7447")]
pub struct EndpointError(String);

/// Returns the router of programs that do not set one: `given`, the value of [`ROUTER_VARIABLE`], or else
/// [`DEFAULT_ROUTER`].
pub fn default_router(given: Option<String>) -> String {
    let given = given.filter(|given| !given.is_empty());
    given.unwrap_or_else(|| DEFAULT_ROUTER.to_owned())
}

/// Parses an endpoint. A host and port without a protocol, such as `127.0.0.1:7447`, mean TCP.
///
/// # Errors
/// Returns an [`EndpointError`] if the text is not a valid endpoint.
pub fn parse(text: &str) -> Result<String, EndpointError> {
    let wrong = || EndpointError(text.chars().take(100).collect());
    let (protocol, address) = text.split_once('/').unwrap_or(("", text));
    if address.is_empty() || text.chars().any(|c| c.is_whitespace() || c.is_control()) {
        return Err(wrong());
    }
    if text.contains('/') {
        let is_protocol =
            |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '-' | '_' | '.');
        let is_named = !protocol.is_empty() && protocol.chars().all(is_protocol);
        return if is_named {
            Ok(text.to_owned())
        } else {
            Err(wrong())
        };
    }
    let has_port = |(host, port): (&str, &str)| !host.is_empty() && port.parse::<u16>().is_ok();
    if address.rsplit_once(':').is_some_and(has_port) {
        return Ok(format!("{DEFAULT_PROTOCOL}/{address}"));
    }
    Err(wrong())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_protocol_is_tcp() {
        for (text, endpoint) in [
            ("127.0.0.1:7447", "tcp/127.0.0.1:7447"),
            ("laptop.local:7447", "tcp/laptop.local:7447"),
            ("[::1]:7447", "tcp/[::1]:7447"),
            ("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"),
            (
                "unixsock-stream//run/rect/router.sock",
                "unixsock-stream//run/rect/router.sock",
            ),
            ("ble/wombat-2#timeout=8000", "ble/wombat-2#timeout=8000"),
        ] {
            assert_eq!(parse(text).as_deref(), Ok(endpoint));
        }
    }

    #[test]
    fn invalid_endpoints_are_rejected_with_an_example() {
        for wrong in [
            "",
            "7447",
            "localhost",
            ":7447",
            "host:",
            "host:70000",
            "/x",
            "TCP/x:1",
            "a b:1",
            "tcp/",
        ] {
            let error = parse(wrong).expect_err(wrong).to_string();
            assert!(error.contains("tcp/127.0.0.1:7447"), "{error}");
        }
    }
}

//! Reads the endpoint of a router as people write it, and knows the one of programs that name none.

/// The environment variable that names the router of programs that name none.
pub const ROUTER_VARIABLE: &str = "RECT_ENDPOINT";

/// Where a robot's router serves its programs unless told otherwise.
pub const DEFAULT_ROUTER: &str = "tcp/127.0.0.1:7447";

/// The protocol of an endpoint that names none.
const DEFAULT_PROTOCOL: &str = "tcp";

/// The text is no endpoint. Write it as `tcp/127.0.0.1:7447`.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not an endpoint: write <protocol>/<address>, such as tcp/127.0.0.1:7447")]
pub struct EndpointError(String);

/// Returns the router of programs that name none: `given`, the value of [`ROUTER_VARIABLE`], else [`DEFAULT_ROUTER`].
pub fn default_router(given: Option<String>) -> String {
    let given = given.filter(|given| !given.is_empty());
    given.unwrap_or_else(|| DEFAULT_ROUTER.to_owned())
}

/// Returns the endpoint that `text` means. A host and a port without a protocol, `127.0.0.1:7447`, are those of TCP.
///
/// # Errors
/// [`EndpointError`].
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
    fn an_address_without_a_protocol_is_one_of_tcp() {
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
    fn anything_else_is_an_error_that_shows_how_to_write_it() {
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

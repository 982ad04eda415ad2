//! Parses the endpoint of a router as people write it, and determines the default.
use std::net::IpAddr;

use super::router::CLOSED;

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

/// The methods whose address is a host and a port.
const WITH_PORT: [&str; 5] = ["tcp", "tls", "quic", "ws", "udp"];

/// Returns what to do if no router answers at an endpoint, which depends on where that is. `router` is the command that runs a router
/// on this computer; `reason` is why there is no session.
pub fn advice(endpoint: &str, reason: &str, router: &str) -> String {
    let (protocol, rest) = endpoint.split_once('/').unwrap_or(("", endpoint));
    let address = rest.split(['#', '?']).next().unwrap_or(rest);
    let (host, port) = address.rsplit_once(':').unwrap_or((address, ""));
    let other =
        "select another one with the option `router` or the environment variable RECT_ENDPOINT";
    match protocol {
        _ if reason == CLOSED => "Close programs that use the same login; the log of the router names the user".to_owned(),
        "unixsock-stream" => format!(
            "A router listens on this socket file if its configuration names it, and programs in its group may use it. \
             Check the path, or {other}"
        ),
        "ble" | "any" => format!(
            "Is the robot {host} switched on and in range? `rect scan` shows the robots whose advertisements are received. \
             Usually a program connects to the router of its own computer, {DEFAULT_ROUTER}, and that router to the robot"
        ),
        protocol if !WITH_PORT.contains(&protocol) => format!(
            "Is {protocol} the method that you mean? Write for example {DEFAULT_ROUTER}"
        ),
        _ if is_this_computer(host) => {
            let starting = match (protocol, port) {
                ("tcp", _) => format!("`{router} -l {endpoint}`"),
                _ => format!("`{router} -l {DEFAULT_ROUTER}`"),
            };
            format!("Start one on this computer with {starting}, or {other}")
        }
        _ if reason.contains("lookup") => format!(
            "Is the name {host} spelled correctly? `ping {host}` finds its address if it is known here; otherwise give the IP address"
        ),
        _ => format!(
            "Is that computer switched on and in this network (`ping {host}`), is its router running, does it listen there and not on \
             127.0.0.1 alone (`rect init` writes that), and does its firewall permit port {port}? Otherwise {other}"
        ),
    }
}

/// Returns whether a host is this computer for everybody.
fn is_this_computer(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let is_loopback = |address: IpAddr| address.is_loopback() || address.is_unspecified();
    host.parse().map_or(host == "localhost", is_loopback)
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
    fn advice_depends_on_where_the_router_is() {
        for (endpoint, reason, expected) in [
            (
                "tcp/127.0.0.1:7447",
                "refused",
                "Start one on this computer with `rect-router -l tcp/127.0.0.1:7447`",
            ),
            (
                "tcp/[::1]:7448",
                "refused",
                "Start one on this computer with `rect-router -l tcp/[::1]:7448`",
            ),
            (
                "udp/localhost:7447",
                "refused",
                "Start one on this computer with `rect-router -l tcp/127.0.0.1:7447`",
            ),
            ("tcp/192.168.0.7:7447", "refused", "(`ping 192.168.0.7`)"),
            (
                "tls/base.local:7449#a=b",
                "no answer",
                "firewall permit port 7449",
            ),
            (
                "tcp/wombat:7447",
                "failed to lookup address information",
                "Is the name wombat spelled correctly?",
            ),
            (
                "unixsock-stream//run/rect/router.sock",
                "no such file",
                "socket file",
            ),
            (
                "ble/wombat-2#timeout=1",
                "not found",
                "Is the robot wombat-2 switched on",
            ),
            (
                "any/wombat-2",
                "not found",
                "Is the robot wombat-2 switched on",
            ),
            (
                "tcp/127.0.0.1:7447",
                CLOSED,
                "Close programs that use the same login",
            ),
            (
                "pigeon/home",
                "not supported",
                "Is pigeon the method that you mean?",
            ),
        ] {
            let advice = advice(endpoint, reason, "rect-router");
            assert!(advice.contains(expected), "{endpoint}: {advice}");
            let starts = advice.contains("Start one on this computer");
            assert_eq!(
                starts,
                expected.starts_with("Start one"),
                "{endpoint}: {advice}"
            );
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

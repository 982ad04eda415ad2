//! Decides how a service handles its requests: how many wait and run, who sent them, and until when it waits for a reply.
use std::time::Duration;

use crate::{
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{error_to_payload, RequestHeader, DEFAULT_TIMEOUT_MS},
    },
    name::Name,
};

/// The number of requests that may wait for the program. Further ones are refused at once.
pub const CAPACITY: usize = 256;
/// The number of requests that a service with a function processes concurrently.
pub const MAX_CONCURRENT: usize = 16;

/// The sender of a request, and how long it waits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Requester {
    /// The robot that the request names as its sender. `None` if a stock Zenoh program sent it.
    pub robot: Option<Name>,
    /// How long the sender waits for a reply.
    pub timeout: Duration,
}

impl Requester {
    /// Returns the sender of a query with that key expression and attachment. `None` if the query is not a request: a stock Zenoh
    /// program that looks around with wildcards (`rect/**`, or a REST `GET`) does not mean to run every service of the fleet.
    pub fn of(key: &str, attachment: Option<&[u8]>) -> Option<Self> {
        let header = attachment.and_then(RequestHeader::decode);
        if header.is_none() && key.contains('*') {
            return None;
        }
        let timeout_ms = header.as_ref().map_or(DEFAULT_TIMEOUT_MS, |h| h.timeout_ms);
        Some(Self {
            robot: header.map(|header| header.sender),
            timeout: Duration::from_millis(timeout_ms.into()),
        })
    }
}

/// Returns the error reply of `robot` to a request for which there is no room.
pub fn busy(robot: &Name) -> Payload {
    let text = format!("the service is busy with {CAPACITY} requests: try again later");
    error_to_payload(robot, Payload::new(text, Encoding::TEXT))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "rect/wombat-2/battery";

    #[test]
    fn requests_of_stock_programs_have_the_default_timeout() {
        let stock = Requester::of(KEY, Some(b"?")).expect("a request");
        assert_eq!(Some(&stock), Requester::of(KEY, None).as_ref());
        assert_eq!(
            (stock.robot, stock.timeout),
            (None, Duration::from_secs(10))
        );
    }

    #[test]
    fn requests_of_robots_name_them() {
        let sender = Name::new("wombat-1").expect("valid name");
        let header = RequestHeader {
            sender: sender.clone(),
            timeout_ms: 1500,
        };
        let timeout = Duration::from_millis(1500);
        let robot = Some(sender);
        let requester = Requester { robot, timeout };
        // A request to the services of all robots has a wildcard.
        for key in [KEY, "rect/*/battery"] {
            let read = Requester::of(key, Some(&header.encode()));
            assert_eq!(read.as_ref(), Some(&requester), "{key}");
        }
    }

    #[test]
    fn query_with_wildcards_of_a_stock_program_is_not_a_request() {
        for key in ["rect/**", "rect/*/battery", "rect/wombat-2/bat$*", "**"] {
            for attachment in [None, Some(&b"?"[..])] {
                assert_eq!(Requester::of(key, attachment), None, "{key}");
            }
        }
    }
}

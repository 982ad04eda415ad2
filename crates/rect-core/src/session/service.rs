//! Decides how a service handles its requests: how many wait and run, who sent them, and until when it waits for a reply.
use std::time::Duration;

use crate::{
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{error_to_payload, RequestHeader, RequestId, DEFAULT_TIMEOUT_MS},
    },
    name::{instance::Instance, Name},
};

/// The number of requests that may wait for the program. Further ones are refused at once.
pub const CAPACITY: usize = 256;
/// The number of requests that a service with a function processes concurrently.
pub const MAX_CONCURRENT: usize = 16;

/// The parameters of the query with which a router asks whether a service still answers.
pub const PING: &str = "@ping";
/// The beginning of the parameters of the query with which a router tells a program that another one serves its topic. The run of the
/// program follows.
const TAKEN_OVER: &str = "@taken=";

/// The beginning of the parameters of the query which announces that a requester has closed a request, whose id follows.
const CLOSED: &str = "@closed=";

/// Returns the parameters of the query that announces the end of a request.
pub(super) fn requester_closed(id: RequestId) -> String {
    format!("{CLOSED}{id}")
}

/// Returns the parameters of the query that tells a run of a program that another one serves its topic.
pub fn taken_over(instance: Instance) -> String {
    format!("{TAKEN_OVER}{instance}")
}

/// The meaning of a query to a service.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServiceQuery {
    /// A request, or a query that looks around ([`Requester::of`]).
    Request,
    /// The router asks whether the service still answers. The library replies at once, whatever the service is doing.
    Ping,
    /// Another program of the robot may serve the topic now. Since anybody can send this, the library asks its router: the service ends
    /// if that refuses to register it again.
    TakenOver,
    /// The requester has closed the request of this id.
    Closed(RequestId),
    /// The router means another program of the robot.
    OfAnother,
}

impl ServiceQuery {
    /// Returns the meaning of the parameters of a query, for a run of a program.
    pub fn of(parameters: &str, own: Instance) -> Self {
        if let Some(id) = parameters.strip_prefix(CLOSED) {
            return RequestId::parse(id).map_or(Self::OfAnother, Self::Closed);
        }
        match parameters.strip_prefix(TAKEN_OVER) {
            Some(instance) if instance == own.to_string() => Self::TakenOver,
            Some(_) => Self::OfAnother,
            None if parameters == PING => Self::Ping,
            None => Self::Request,
        }
    }
}

/// The sender of a request, and how long it waits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Requester {
    /// The header of the request. `None` if a stock Zenoh program sent it.
    pub header: Option<RequestHeader>,
}

impl Requester {
    /// Returns the sender of a query with that key expression and attachment. `None` if the query is not a request: a stock Zenoh
    /// program that looks around with wildcards (`rect/**`, or a REST `GET`) does not mean to run every service of the fleet.
    pub fn of(key: &str, attachment: Option<&[u8]>) -> Option<Self> {
        let header = attachment.and_then(RequestHeader::decode);
        if header.is_none() && key.contains('*') {
            return None;
        }
        Some(Self { header })
    }

    /// Returns the robot that the request names as its sender. `None` if a stock Zenoh program sent it.
    pub fn robot(&self) -> Option<&Name> {
        self.header.as_ref().map(|header| &header.sender)
    }

    /// Returns how long the sender waits for a reply.
    pub fn timeout(&self) -> Duration {
        let timeout_ms = self.header.as_ref().map(|header| header.timeout_ms);
        Duration::from_millis(timeout_ms.unwrap_or(DEFAULT_TIMEOUT_MS).into())
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
    use crate::{name::key::KeySpace, session::request_ids::RequestIds};

    const KEY: &str = "rect/wombat-2/battery";

    #[test]
    fn requests_of_stock_programs_have_the_default_timeout() {
        let stock = Requester::of(KEY, Some(b"?")).expect("a request");
        assert_eq!(Some(&stock), Requester::of(KEY, None).as_ref());
        assert_eq!(
            (stock.robot(), stock.timeout()),
            (None, Duration::from_secs(10))
        );
    }

    #[test]
    fn requests_of_robots_name_them() {
        let ids = RequestIds::new(Instance(0x1f), true);
        let place = KeySpace {
            fleet: Name::new("rect").expect("valid name"),
            robot: Name::new("wombat-1").expect("valid name"),
        };
        let timeout = Duration::from_millis(1500);
        let header = ids.header(&place, timeout);
        // A request to the services of all robots has a wildcard.
        for key in [KEY, "rect/*/battery"] {
            let read = Requester::of(key, Some(&header.encode())).expect("a request");
            assert_eq!(
                (read.robot(), read.timeout()),
                (Some(&place.robot), timeout)
            );
        }
    }

    #[test]
    fn queries_of_the_router_are_no_requests() {
        let own = Instance(0x1f);
        let closed = RequestId {
            run: own,
            number: 7,
        };
        for (parameters, meaning) in [
            ("", ServiceQuery::Request),
            ("_time=now", ServiceQuery::Request),
            (PING, ServiceQuery::Ping),
            (&taken_over(own), ServiceQuery::TakenOver),
            (&taken_over(Instance(1)), ServiceQuery::OfAnother),
            ("@taken=", ServiceQuery::OfAnother),
            ("@closed=0000001f/7", ServiceQuery::Closed(closed)),
            ("@closed=7", ServiceQuery::OfAnother),
        ] {
            assert_eq!(ServiceQuery::of(parameters, own), meaning, "{parameters}");
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

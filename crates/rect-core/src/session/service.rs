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
    /// Reads the attachment of a request.
    pub fn of(attachment: Option<&[u8]>) -> Self {
        let header = attachment.and_then(RequestHeader::decode);
        let timeout_ms = header.as_ref().map_or(DEFAULT_TIMEOUT_MS, |h| h.timeout_ms);
        Self {
            robot: header.map(|header| header.sender),
            timeout: Duration::from_millis(timeout_ms.into()),
        }
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

    #[test]
    fn requests_of_stock_programs_have_the_default_timeout() {
        let stock = Requester::of(Some(b"?"));
        assert_eq!(stock, Requester::of(None));
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
        let requester = Requester::of(Some(&header.encode()));
        let timeout = Duration::from_millis(1500);
        let robot = Some(sender);
        assert_eq!(requester, Requester { robot, timeout });
    }
}

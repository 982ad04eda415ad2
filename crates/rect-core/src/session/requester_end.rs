//! Builds the announcement that a requester has closed its request, and passes it on.
//!
//! The announcement is a query to the catalogue of the robot. Its router, or the program itself without one, passes it to the services
//! of the topic. It does not go to the service directly, because a service of a stock Zenoh program would carry it out as a request.
use std::time::Duration;

use super::service::requester_closed;
use crate::{
    driver::{Get, Target},
    message::{encoding::Encoding, payload::Payload, request::RequestId},
    name::{
        key::{KeySpace, CATALOGUE},
        topic::Topic,
        Name,
    },
};

/// The first word of the announcement; the id and the topic follow.
const CLOSED: &str = "closed";
/// How long the announcement may take.
const TIMEOUT: Duration = Duration::from_secs(2);

/// Returns the query that announces that a requester has closed a request to a robot, or to all robots (`None`).
pub fn announcement(place: &KeySpace, robot: Option<&Name>, topic: &Topic, id: RequestId) -> Get {
    let text = format!("{CLOSED} {id} {topic}");
    Get {
        payload: Some(Payload::new(text, Encoding::TEXT)),
        target: Target::All,
        ..Get::new(place.own(robot, CATALOGUE), TIMEOUT)
    }
}

/// Returns the topic and the query that passes an announcement to the services of the robot of `place`. `None` if the payload of a
/// query to the catalogue is something else.
pub fn passed_on(place: &KeySpace, payload: &[u8]) -> Option<(Topic, Get)> {
    // A topic may contain spaces.
    let mut words = std::str::from_utf8(payload).ok()?.splitn(3, ' ');
    let (CLOSED, id, topic) = (words.next()?, words.next()?, words.next()?) else {
        return None;
    };
    let topic = Topic::new(topic).ok()?;
    let closed = requester_closed(RequestId::parse(id)?);
    let get = Get {
        target: Target::All,
        ..Get::new(format!("{}?{closed}", place.publication(&topic)), TIMEOUT)
    };
    Some((topic, get))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::name::instance::Instance;

    fn place(robot: &str) -> KeySpace {
        let name = |text: &str| Name::new(text).expect("valid name");
        KeySpace {
            fleet: name("rect"),
            robot: name(robot),
        }
    }

    #[test]
    fn announcement_is_passed_to_the_services_of_the_topic() {
        let id = RequestId {
            run: Instance(0x1f),
            number: 7,
        };
        for text in ["grab", "arm/left grab"] {
            let topic = Topic::new(text).expect("valid topic");
            let get = announcement(&place("wombat-1"), None, &topic, id);
            assert_eq!(get.selector, "rect/*/@rect/catalogue");
            let payload = get.payload.expect("a payload");
            let passed = passed_on(&place("wombat-2"), &payload.bytes).expect("an announcement");
            let selector = format!("rect/wombat-2/{text}?@closed=0000001f/7");
            assert_eq!((passed.0, passed.1.selector), (topic, selector));
        }
        for wrong in [
            "",
            "closed",
            "closed 0000001f/7",
            "closed 1/7 grab",
            "closed 0000001f/7 a//b",
        ] {
            assert_eq!(
                passed_on(&place("wombat-2"), wrong.as_bytes()),
                None,
                "{wrong}"
            );
        }
    }
}

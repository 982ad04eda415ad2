//! Throttled subscriptions. They receive fewer messages than are published: a limited number per second, or only values that differ
//! from the last one.
//!
//! A subscriber declares its [`Wish`] as a liveliness token. The router of the robot that publishes ([`crate::throttle`]) sends each
//! robot with wishes a stream of its own for each topic, as fast as the largest of that robot's wishes. So the messages that nobody
//! wants never reach the air. Each subscriber then takes from the stream what it wants ([`receiver`]).
//!
//! | purpose | key |
//! |---|---|
//! | the token of a wish | `<fleet>/<receiver>/@rect/throttle/<wish>/<publisher, or *>/<topic, with wildcards>` |
//! | the messages | `<fleet>/<publisher>/@rect/throttled/<receiver>/<topic>` |
pub mod header;
pub mod receiver;
pub mod wish;

pub use wish::{Wish, WishError};

use crate::name::{
    key::KeySpace,
    topic::{Pattern, Topic},
    Name,
};

/// The part of a token's key after `@rect/`.
const WISHES: &str = "throttle";
/// The part of a message's key after `@rect/`.
const MESSAGES: &str = "throttled";

/// Returns the key of the token by which a program of the robot of `place` wishes the messages of a pattern.
pub fn token(place: &KeySpace, wish: Wish, pattern: &Pattern) -> String {
    let robot = pattern.robot().map_or("*", Name::as_str);
    let rest = format!("{WISHES}/{wish}/{robot}/{}", pattern.topic());
    place.own(Some(&place.robot), &rest)
}

/// Returns the key expression of the tokens that concern the messages of the robot of `place`.
pub fn tokens(place: &KeySpace) -> String {
    place.own(None, &format!("{WISHES}/*/{}/**", place.robot))
}

/// Returns the robot that wishes something, its wish, and the topics that it wishes. `None` if the key is not that of a token.
pub fn of_token<'a>(place: &KeySpace, key: &'a str) -> Option<(Name, Wish, &'a str)> {
    let receiver = place.robot_of(key)?;
    let rest = key.strip_prefix(&place.own(Some(&receiver), WISHES))?;
    let (wish, rest) = rest.strip_prefix('/')?.split_once('/')?;
    let (_, topic) = rest.split_once('/')?;
    Some((receiver, wish.parse().ok()?, topic))
}

/// Returns the key of the messages that the robot of `place` publishes on `topic` for `receiver`.
pub fn publication(place: &KeySpace, receiver: &Name, topic: &str) -> String {
    place.own(
        Some(&place.robot),
        &format!("{MESSAGES}/{receiver}/{topic}"),
    )
}

/// Returns the key expression of the messages of a pattern for the robot of `place`.
pub fn subscription(place: &KeySpace, pattern: &Pattern) -> String {
    let rest = format!("{MESSAGES}/{}/{}", place.robot, pattern.topic());
    place.own(pattern.robot(), &rest)
}

/// Returns the robot that published a message for the robot of `place`, and the topic. `None` if the key is not that of such a message.
pub fn of_message(place: &KeySpace, key: &str) -> Option<(Name, Topic)> {
    let sender = place.robot_of(key)?;
    let own = place.own(Some(&sender), MESSAGES);
    let rest = key.strip_prefix(&own)?.strip_prefix('/')?;
    let topic = rest.strip_prefix(place.robot.as_str())?.strip_prefix('/')?;
    Some((sender, Topic::new(topic).ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(robot: &str) -> KeySpace {
        let name = |text| Name::new(text).expect("valid name");
        KeySpace {
            fleet: name("rect"),
            robot: name(robot),
        }
    }

    #[test]
    fn keys_round_trip() {
        let (laptop, wombat) = (place("laptop"), place("wombat-1"));
        let wish: Wish = "2c".parse().expect("valid wish");
        let pattern = Pattern::new("*/arm/*").expect("valid pattern");
        let key = token(&laptop, wish, &pattern);
        assert_eq!(key, "rect/laptop/@rect/throttle/2c/*/arm/*");
        let expected = Some((laptop.robot.clone(), wish, "arm/*"));
        assert_eq!(of_token(&wombat, &key), expected);
        let key = publication(&wombat, &laptop.robot, "arm/angle");
        let topic = Topic::new("arm/angle").expect("valid topic");
        let expected = Some((wombat.robot.clone(), topic));
        assert_eq!(of_message(&laptop, &key), expected);
        assert_eq!(of_message(&wombat, &key), None, "for another robot");
        let expected = "rect/*/@rect/throttled/laptop/arm/*";
        assert_eq!(subscription(&laptop, &pattern), expected);
    }

    #[test]
    fn keys_of_others_are_ignored() {
        for key in [
            "rect/laptop/@rect/throttle/2/wombat-1",
            "rect/laptop/@rect/throttle/x/wombat-1/pose",
            "rect/laptop/@rect/throttled/2/wombat-1/pose",
            "lions/laptop/@rect/throttle/2/wombat-1/pose",
            "rect/laptop/pose",
        ] {
            assert_eq!(of_token(&place("wombat-1"), key), None, "{key}");
        }
    }
}

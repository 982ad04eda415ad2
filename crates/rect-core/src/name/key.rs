//! Builds and parses Zenoh keys, which consist of fleet, robot and topic.
//!
//! | purpose | key |
//! |---|---|
//! | published messages, services | `<fleet>/<robot>/<topic>` |
//! | messages to one robot | `<fleet>/<robot>/to/<recipient>/<topic>` |
//! | internal keys of RECT | `<fleet>/<robot>/@rect/...` |
use super::{
    topic::{Pattern, Topic, TO},
    Name,
};

/// The part of a key below which RECT's internal keys are. Wildcards do not match it.
pub const OWN: &str = "@rect";

/// The part after `@rect/` of the key of a robot's catalogue.
pub const CATALOGUE: &str = "catalogue";

/// The keys of one robot of a fleet.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct KeySpace {
    /// The name of the fleet.
    pub fleet: Name,
    /// The name of the robot.
    pub robot: Name,
}

/// The reason why a key is not that of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AddressError {
    /// The key belongs to another fleet, or has another form.
    NotAMessage,
    /// The key is that of a message except for its topic, which RECT does not allow (see [`Topic`]). Only other Zenoh
    /// programs publish there.
    InvalidTopic {
        /// The one robot that the message was sent to.
        recipient: Option<Name>,
    },
}

/// The robots that receive a message, as seen from one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Audience {
    /// All robots: the message was published.
    All,
    /// This robot alone.
    ThisRobot,
    /// Another robot alone.
    OtherRobot,
}

/// A Zenoh subscription, one of those that deliver the messages that a program selects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selected {
    /// The key expression.
    pub key: String,
    /// The robots to which the messages were sent that this subscription delivers. Its key expression may match other messages, too.
    pub audience: Audience,
}

/// The parts of a message's key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// The robot that sent the message.
    pub sender: Name,
    /// The one robot that the message was sent to. `None` if it was published to all robots.
    pub recipient: Option<Name>,
    /// The topic of the message.
    pub topic: Topic,
}

impl KeySpace {
    /// Returns the key of messages that this robot publishes on `topic`, and of its service of that name.
    pub fn publication(&self, topic: &Topic) -> String {
        self.publication_of(topic.as_str())
    }

    /// Returns the key expression of messages that this robot publishes on topics with wildcards.
    pub fn publication_of(&self, topics: &str) -> String {
        format!("{}/{}/{topics}", self.fleet, self.robot)
    }

    /// Returns the key of messages that this robot sends to `robot` alone.
    pub fn message(&self, robot: &Name, topic: &Topic) -> String {
        format!("{}/{}/{TO}/{robot}/{topic}", self.fleet, self.robot)
    }

    /// Returns the key of a service of `robot`, or the key expression of that service of all robots (`None`).
    pub fn service(&self, robot: Option<&Name>, topic: &Topic) -> String {
        format!("{}/{}/{topic}", self.fleet, robot.map_or("*", Name::as_str))
    }

    /// Returns the key expression of all services of this robot.
    pub fn services(&self) -> String {
        self.publication_of("**")
    }

    /// Returns an internal key, `@rect/<rest>`, of `robot` or of all robots (`None`).
    pub fn own(&self, robot: Option<&Name>, rest: &str) -> String {
        let robot = robot.map_or("*", Name::as_str);
        format!("{}/{robot}/{OWN}/{rest}", self.fleet)
    }

    /// Returns the subscriptions of a pattern: to published messages, and to messages to this robot alone.
    pub fn subscriptions(&self, pattern: &Pattern) -> [Selected; 2] {
        let from = pattern.robot().map_or("*", Name::as_str);
        [Audience::All, Audience::ThisRobot]
            .map(|audience| self.selected(from, audience, pattern.topic()))
    }

    /// Returns the subscriptions of a recorder: to what [`subscriptions`](Self::subscriptions) selects, and to messages that
    /// this robot sends to another one alone. Without patterns, to everything that this robot publishes, and that is sent by it
    /// or to it.
    pub fn recorded(&self, patterns: &[Pattern]) -> Vec<Selected> {
        let own = self.robot.as_str();
        if patterns.is_empty() {
            return vec![
                self.selected(own, Audience::All, "**"),
                self.selected("*", Audience::ThisRobot, "**"),
                self.selected(own, Audience::OtherRobot, "**"),
            ];
        }
        let selected = patterns.iter().flat_map(|pattern| {
            let is_sent = pattern.robot().is_none_or(|robot| *robot == self.robot);
            let sent = is_sent.then(|| self.selected(own, Audience::OtherRobot, pattern.topic()));
            self.subscriptions(pattern).into_iter().chain(sent)
        });
        selected.collect()
    }

    fn selected(&self, from: &str, audience: Audience, topic: &str) -> Selected {
        let Self { fleet, robot } = self;
        let key = match audience {
            Audience::All => format!("{fleet}/{from}/{topic}"),
            Audience::ThisRobot => format!("{fleet}/{from}/{TO}/{robot}/{topic}"),
            Audience::OtherRobot => format!("{fleet}/{from}/{TO}/*/{topic}"),
        };
        Selected { key, audience }
    }

    /// Returns the audience of messages to `recipient`, or to all robots (`None`).
    pub fn audience(&self, recipient: Option<&Name>) -> Audience {
        match recipient {
            None => Audience::All,
            Some(robot) if *robot == self.robot => Audience::ThisRobot,
            Some(_) => Audience::OtherRobot,
        }
    }

    /// Returns the robot that a key of this fleet belongs to, be it a message's key or an internal one.
    pub fn robot_of(&self, key: &str) -> Option<Name> {
        let rest = key.strip_prefix(self.fleet.as_str())?.strip_prefix('/')?;
        let (robot, _) = rest.split_once('/')?;
        Name::new(robot).ok()
    }

    /// Returns the address that a key contains. `None` if the key is not that of a message, or is that of a message to
    /// another robot alone, which a subscription to `**` also receives.
    pub fn address(&self, key: &str) -> Option<Address> {
        let address = self.parse(key).ok()?;
        (self.audience(address.recipient.as_ref()) != Audience::OtherRobot).then_some(address)
    }

    /// Parses the key of a message of this fleet.
    ///
    /// # Errors
    /// Returns an [`AddressError`] if the key is not one.
    pub fn parse(&self, key: &str) -> Result<Address, AddressError> {
        let sender = self.robot_of(key).ok_or(AddressError::NotAMessage)?;
        let rest = &key[self.fleet.as_str().len() + sender.as_str().len() + 2..];
        let directed = rest
            .strip_prefix(TO)
            .and_then(|rest| rest.strip_prefix('/'));
        let (recipient, topic) = match directed {
            Some(rest) => {
                let (to, topic) = rest.split_once('/').ok_or(AddressError::NotAMessage)?;
                let to = Name::new(to).map_err(|_| AddressError::NotAMessage)?;
                (Some(to), topic)
            }
            None => (None, rest),
        };
        match Topic::new(topic) {
            Ok(topic) => Ok(Address {
                sender,
                recipient,
                topic,
            }),
            Err(_) => Err(AddressError::InvalidTopic { recipient }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys() -> KeySpace {
        let name = |text| Name::new(text).expect("valid name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        KeySpace { fleet, robot }
    }

    #[test]
    fn keys_round_trip() {
        let (me, other) = (keys(), Name::new("wombat-2").expect("valid name"));
        let recipient = KeySpace {
            robot: other.clone(),
            ..me.clone()
        };
        let topic = Topic::new("arm/angle").expect("valid topic");
        let published = recipient.address(&me.publication(&topic)).expect("address");
        assert_eq!(
            (
                published.sender.as_str(),
                published.recipient,
                &published.topic
            ),
            ("wombat-1", None, &topic)
        );
        let direct = recipient
            .address(&me.message(&other, &topic))
            .expect("address");
        assert_eq!(
            (direct.sender.as_str(), direct.recipient, &direct.topic),
            ("wombat-1", Some(other), &topic)
        );
    }

    #[test]
    fn rejects_keys_that_are_not_of_a_message_for_this_robot() {
        for key in [
            "rect/a/to/wombat-2/x",
            "rect/a/@rect/status",
            "rect/a/to",
            "rect/a/to/wombat-1",
            "lions/a/x",
            "rect/a",
            "rectx/a/x",
            "",
        ] {
            assert_eq!(keys().address(key), None, "{key}");
        }
    }

    #[test]
    fn a_pattern_subscribes_to_published_and_direct_messages() {
        let pattern = Pattern::new("*/arm/*").expect("valid pattern");
        let expected = ["rect/*/arm/*", "rect/*/to/wombat-1/arm/*"];
        let selected = keys().subscriptions(&pattern);
        assert_eq!(selected.map(|selected| selected.key), expected);
    }
}

//! Owns the keys: how fleet, robot and topic make a Zenoh key, and what a key says of a message.
//!
//! | what | key |
//! |---|---|
//! | to all, a service | `<fleet>/<robot>/<topic>` |
//! | to one robot | `<fleet>/<robot>/to/<other>/<topic>` |
//! | RECT's own | `<fleet>/<robot>/@rect/...` |
use super::{
    name::Name,
    topic::{Pattern, Topic, TO},
};

/// The part under which RECT's own keys are; wildcards do not match it.
pub const OWN: &str = "@rect";

/// Who speaks: the place of a program's keys.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Place {
    /// The team.
    pub fleet: Name,
    /// The robot.
    pub robot: Name,
}

/// Why a key is not that of a message to this robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoMessage {
    /// It belongs to another fleet, is sent to another robot alone, or is not a message's key.
    Elsewhere,
    /// It is one but for its topic, which RECT does not allow (see [`Topic`]): only other Zenoh programs publish there.
    InvalidTopic {
        /// Whether it is sent to this robot alone.
        directed: bool,
    },
}

/// What a key says of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Who sent it.
    pub from: Name,
    /// To whom alone; `None`: to all.
    pub to: Option<Name>,
    /// About what.
    pub topic: Topic,
}

impl Place {
    /// The key of what this robot says to all about `topic`; also that of its service of that name.
    pub fn publication(&self, topic: &Topic) -> String {
        format!("{}/{}/{topic}", self.fleet, self.robot)
    }

    /// The key of what it says to `robot` alone.
    pub fn message(&self, robot: &Name, topic: &Topic) -> String {
        format!("{}/{}/{TO}/{robot}/{topic}", self.fleet, self.robot)
    }

    /// The key of a service of `robot`, or of all that have one (`None`).
    pub fn service(&self, robot: Option<&Name>, topic: &Topic) -> String {
        format!("{}/{}/{topic}", self.fleet, robot.map_or("*", Name::as_str))
    }

    /// A key of RECT's own, of `robot` or of all.
    pub fn own(&self, robot: Option<&Name>, rest: &str) -> String {
        let robot = robot.map_or("*", Name::as_str);
        format!("{}/{robot}/{OWN}/{rest}", self.fleet)
    }

    /// The two key expressions of what a pattern means here: what is said to all, and what is said to this robot alone.
    pub fn subscriptions(&self, pattern: &Pattern) -> [String; 2] {
        let Self { fleet, robot } = self;
        let from = pattern.robot().map_or("*", Name::as_str);
        let topic = pattern.topic();
        [
            format!("{fleet}/{from}/{topic}"),
            format!("{fleet}/{from}/{TO}/{robot}/{topic}"),
        ]
    }

    /// Whose a key of this fleet is, a message's or one of RECT's own.
    pub fn robot_of(&self, key: &str) -> Option<Name> {
        let rest = key.strip_prefix(self.fleet.as_str())?.strip_prefix('/')?;
        let (robot, _) = rest.split_once('/')?;
        Name::new(robot).ok()
    }

    /// What a key of this fleet says; `None` for one that is no message's, or is for another robot alone (which a
    /// subscription with `**` receives, too).
    pub fn address(&self, key: &str) -> Option<Address> {
        self.read(key).ok()
    }

    /// Reads a key that a subscription delivered.
    ///
    /// # Errors
    /// [`NoMessage`]: it is not the key of a message to this robot.
    pub fn read(&self, key: &str) -> Result<Address, NoMessage> {
        let from = self.robot_of(key).ok_or(NoMessage::Elsewhere)?;
        let rest = &key[self.fleet.as_str().len() + from.as_str().len() + 2..];
        let directed = rest
            .strip_prefix(TO)
            .and_then(|rest| rest.strip_prefix('/'));
        let (to, topic) = match directed {
            Some(rest) => {
                let (to, topic) = rest.split_once('/').ok_or(NoMessage::Elsewhere)?;
                if self.robot != to {
                    return Err(NoMessage::Elsewhere);
                }
                (Some(self.robot.clone()), topic)
            }
            None => (None, rest),
        };
        let directed = to.is_some();
        let topic = Topic::new(topic).map_err(|_| NoMessage::InvalidTopic { directed })?;
        Ok(Address { from, to, topic })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place() -> Place {
        let name = |text| Name::new(text).expect("a name");
        let (fleet, robot) = (name("rect"), name("wombat-1"));
        Place { fleet, robot }
    }

    #[test]
    fn a_key_and_what_it_says_are_each_others_inverse() {
        let (me, other) = (place(), Name::new("wombat-2").expect("a name"));
        let there = Place {
            robot: other.clone(),
            ..me.clone()
        };
        let topic = Topic::new("arm/angle").expect("a topic");
        let all = there.address(&me.publication(&topic)).expect("a message");
        assert_eq!(
            (all.from.as_str(), all.to, &all.topic),
            ("wombat-1", None, &topic)
        );
        let one = there
            .address(&me.message(&other, &topic))
            .expect("a message");
        assert_eq!(
            (one.from.as_str(), one.to, &one.topic),
            ("wombat-1", Some(other), &topic)
        );
    }

    #[test]
    fn what_is_for_another_robot_or_no_message_is_left() {
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
            assert_eq!(place().address(key), None, "{key}");
        }
    }

    #[test]
    fn a_pattern_means_what_is_said_to_all_and_to_me() {
        let pattern = Pattern::new("*/arm/*").expect("a pattern");
        let expected = ["rect/*/arm/*", "rect/*/to/wombat-1/arm/*"];
        assert_eq!(place().subscriptions(&pattern), expected);
    }
}

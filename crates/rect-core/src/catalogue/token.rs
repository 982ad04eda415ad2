//! The liveliness token of a program: `<fleet>/<robot>/@rect/p/<program>/<instance>/<revision>`. A program without a name has `~` in
//! its place. The revision changes with what the program serves.
use super::Instance;
use crate::name::{key::KeySpace, Name};

/// The part after `@rect/` with which the keys of these tokens begin. It is short, because every router gets every token.
const PROGRAMS: &str = "p";
/// The part in place of a name. No name is like that.
const UNNAMED: &str = "~";

/// The token of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// The robot.
    pub robot: Name,
    /// The name of the program; `None` if it has none.
    pub program: Option<Name>,
    /// The run of the program.
    pub instance: Instance,
    /// The revision of what it serves.
    pub revision: u32,
}

impl Token {
    /// Returns the key.
    pub fn key(&self, fleet: &Name) -> String {
        let place = KeySpace {
            fleet: fleet.clone(),
            robot: self.robot.clone(),
        };
        let program = self.program.as_ref().map_or(UNNAMED, Name::as_str);
        let rest = format!("{PROGRAMS}/{program}/{}/{}", self.instance, self.revision);
        place.own(Some(&self.robot), &rest)
    }

    /// Reads the key of a token; `None` if it is something else.
    pub fn parse(place: &KeySpace, key: &str) -> Option<Self> {
        let robot = place.robot_of(key)?;
        let start = place.own(Some(&robot), PROGRAMS);
        let mut parts = key
            .strip_prefix(start.as_str())?
            .strip_prefix('/')?
            .split('/');
        let (program, instance, revision) = (parts.next()?, parts.next()?, parts.next()?);
        let program = match program {
            UNNAMED => None,
            name => Some(Name::new(name).ok()?),
        };
        let token = Self {
            robot,
            program,
            instance: Instance::parse(instance)?,
            revision: revision.parse().ok()?,
        };
        parts.next().is_none().then_some(token)
    }
}

/// Returns the key expression of the tokens of the programs of a robot, or of all robots (`None`).
pub fn tokens(place: &KeySpace, robot: Option<&Name>) -> String {
    place.own(robot, &format!("{PROGRAMS}/*/*/*"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_round_trip_and_are_short() {
        let name = |text: &str| Name::new(text).expect("valid name");
        let place = KeySpace {
            fleet: name("rect"),
            robot: name("laptop"),
        };
        let token = |program: Option<&str>| Token {
            robot: name("wombat-1"),
            program: program.map(name),
            instance: Instance(0xa1b2_c3d4),
            revision: 12,
        };
        let key = token(Some("gripper")).key(&place.fleet);
        assert_eq!(key, "rect/wombat-1/@rect/p/gripper/a1b2c3d4/12");
        assert!(key.len() <= 60);
        for program in [Some("gripper"), None] {
            let token = token(program);
            assert_eq!(Token::parse(&place, &token.key(&place.fleet)), Some(token));
        }
        for wrong in [
            "lions/wombat-1/@rect/p/gripper/a1b2c3d4/12",
            "rect/wombat-1/@rect/alive/a1b2c3d4",
            "rect/wombat-1/@rect/p/gripper/a1b2c3d4",
            "rect/wombat-1/@rect/p/gripper/a1b2c3d4/12/x",
            "rect/wombat-1/@rect/p/gripper/a1b2c3d4/-1",
            "rect/wombat-1/@rect/p/a b/a1b2c3d4/1",
        ] {
            assert_eq!(Token::parse(&place, wrong), None, "{wrong}");
        }
    }
}

//! Parses the groups, parameters and values on the command line.
use std::{fmt, str::FromStr};

use rect::{Name, ParameterValue};
use rect_core::parameters::{is_name, wrong_name};

/// A group of parameters of a robot: `wombat-2/drive`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupPlace {
    /// The robot.
    pub robot: Name,
    /// The group.
    pub group: String,
}

/// A group, or one of its parameters: `wombat-2/drive/kp`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The group.
    pub group: GroupPlace,
    /// The parameter; `None` for all of the group.
    pub name: Option<String>,
}

/// A parameter with its new value: `kp=2.0`.
#[derive(Clone, Debug, PartialEq)]
pub struct Assignment {
    /// The parameter.
    pub name: String,
    /// The value.
    pub value: ParameterValue,
}

/// Why a text is not one of these.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct PlaceError(String);

impl fmt::Display for GroupPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.robot, self.group)
    }
}

impl FromStr for GroupPlace {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        let place: Place = text.parse()?;
        match place.name {
            None => Ok(place.group),
            Some(name) => Err(PlaceError(format!(
                "write the group alone, {}, and {name} after it",
                place.group
            ))),
        }
    }
}

impl FromStr for Place {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        let parts: Vec<_> = text.split('/').collect();
        let (robot, group, name) = match parts[..] {
            [robot, group] => (robot, group, None),
            [robot, group, name] => (robot, group, Some(name)),
            _ => {
                let wrong =
                    "write <robot>/<group>, such as wombat-2/drive; `rect param list` lists them";
                return Err(PlaceError(wrong.to_owned()));
            }
        };
        let robot = Name::new(robot).map_err(|error| PlaceError(error.to_string()))?;
        let group = checked(group)?.to_owned();
        let name = name.map(checked).transpose()?.map(str::to_owned);
        Ok(Self {
            group: GroupPlace { robot, group },
            name,
        })
    }
}

impl FromStr for Assignment {
    type Err = PlaceError;

    fn from_str(text: &str) -> Result<Self, PlaceError> {
        let Some((name, value)) = text.split_once('=') else {
            let wrong = "write <name>=<value>, such as kp=2.0";
            return Err(PlaceError(wrong.to_owned()));
        };
        let name = checked(name)?.to_owned();
        let value = match serde_json::from_str::<serde_json::Value>(value) {
            // A text that is not JSON needs no quotation marks.
            Err(_) => ParameterValue::Text(value.to_owned()),
            Ok(json) => serde_json::from_value(json).map_err(|error| {
                PlaceError(format!("{name} cannot be {value}: it must be {error}"))
            })?,
        };
        Ok(Self { name, value })
    }
}

fn checked(name: &str) -> Result<&str, PlaceError> {
    if is_name(name) {
        return Ok(name);
    }
    let what = "the name of a group or a parameter";
    Err(PlaceError(wrong_name(name, what)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_and_parameters_are_parsed() {
        let place: Place = "wombat-2/drive/kp".parse().expect("valid");
        assert_eq!(place.group.to_string(), "wombat-2/drive");
        assert_eq!(place.name.as_deref(), Some("kp"));
        let group: GroupPlace = "wombat-2/drive".parse().expect("valid");
        assert_eq!(group, place.group);
        for (wrong, reason) in [
            ("wombat-2", "<robot>/<group>"),
            ("wombat-2/drive/kp/x", "<robot>/<group>"),
            ("wom bat/drive", "' '"),
            ("wombat-2/", "cannot be the name"),
            ("wombat-2/drive/", "cannot be the name"),
            ("wombat-2/*", "cannot be the name"),
        ] {
            let error = wrong.parse::<Place>().expect_err(reason).to_string();
            assert!(error.contains(reason), "{wrong}: {error}");
        }
        let error = "wombat-2/drive/kp"
            .parse::<GroupPlace>()
            .expect_err("a group");
        assert!(
            error.to_string().contains("wombat-2/drive, and kp"),
            "{error}"
        );
    }

    #[test]
    fn values_are_json_or_otherwise_texts() {
        for (text, value) in [
            ("kp=2", ParameterValue::Integer(2)),
            ("kp=2.0", 2.0.into()),
            ("kp=true", true.into()),
            ("kp=left", "left".into()),
            ("kp=", "".into()),
            ("kp=a=b", "a=b".into()),
            (r#"kp="2""#, "2".into()),
            ("kp=[1, 2.5]", vec![1.0, 2.5].into()),
            ("kp=NaN", "NaN".into()),
        ] {
            let parsed: Assignment = text.parse().expect("valid");
            assert_eq!(
                (parsed.name.as_str(), parsed.value),
                ("kp", value),
                "{text}"
            );
        }
        for (wrong, reason) in [
            ("kp", "<name>=<value>"),
            ("=2", "cannot be the name"),
            ("kp=null", "a bool, number, text or list of numbers"),
            (r#"kp={"a": 1}"#, "a bool, number, text or list of numbers"),
            (r#"kp=[1, "a"]"#, "a bool, number, text or list of numbers"),
        ] {
            let error = wrong.parse::<Assignment>().expect_err(reason).to_string();
            assert!(error.contains(reason), "{wrong}: {error}");
        }
    }
}

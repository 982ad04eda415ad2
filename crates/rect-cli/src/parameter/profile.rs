//! Reads and writes profiles: files with the values of groups of parameters, `{robot: {group: {name: value}}}`.
use std::{
    collections::BTreeMap,
    fmt,
    fs::File,
    io::{self, Read},
    path::Path,
};

use rect::{Name, ParameterValue};
use rect_core::parameters::{is_name, MAX_NAME};
use serde::{
    de::{Error as _, MapAccess, SeqAccess, Visitor},
    Deserialize, Deserializer,
};
use serde_json::Value as Json;

use crate::Failure;

/// The maximum size of a profile, in bytes.
const MAX_BYTES: u64 = 1_000_000;
/// The maximum length of a name or value in an error, in characters.
const MAX_SHOWN: usize = 40;

/// The values of a group.
pub type Values = BTreeMap<String, ParameterValue>;
/// The values of the groups of each robot.
pub type Profile = BTreeMap<Name, BTreeMap<String, Values>>;

/// Reads a profile from a file.
///
/// # Errors
/// Returns the reason and the place if the file cannot be read, is larger than 1 MB, or is not a profile.
pub fn read(path: &Path) -> Result<Profile, Failure> {
    let named = |reason: String| Failure::from(format!("{}: {reason}", path.display()));
    let mut text = String::new();
    let file = File::open(path).map_err(|error| named(error.to_string()))?;
    // One byte more than the limit shows that the file is too large.
    let count = file.take(MAX_BYTES + 1).read_to_string(&mut text);
    match count {
        Ok(count) if count as u64 > MAX_BYTES => Err(named(format!(
            "a profile has at most {MAX_BYTES} bytes, and this file has more"
        ))),
        Ok(_) => parse(&text).map_err(named),
        Err(error) if error.kind() == io::ErrorKind::InvalidData => {
            Err(named("it is not a text in UTF-8".to_owned()))
        }
        Err(error) => Err(named(error.to_string())),
    }
}

/// Parses a profile.
fn parse(text: &str) -> Result<Profile, String> {
    let node: Node = serde_json::from_str(text).map_err(|error| error.to_string())?;
    let mut profile = Profile::new();
    for (robot, groups) in node.object("the profile", "robots")? {
        let place = cut(&robot);
        let name = Name::new(&robot).map_err(|error| format!("{place:?}: {error}"))?;
        let mut checked = BTreeMap::new();
        for (group, values) in groups.object(&place, "groups")? {
            let place = format!("{place}/{}", checked_name(&place, &group)?);
            let mut parsed = Values::new();
            for (name, value) in values.object(&place, "parameters")? {
                checked_name(&place, &name)?;
                let value = value.value(&format!("{place}/{name}"))?;
                parsed.insert(name, value);
            }
            checked.insert(group, parsed);
        }
        profile.insert(name, checked);
    }
    if profile.values().all(BTreeMap::is_empty) {
        return Err("it contains no group of parameters".to_owned());
    }
    Ok(profile)
}

fn checked_name<'a>(place: &str, name: &'a str) -> Result<&'a str, String> {
    match is_name(name) {
        true => Ok(name),
        false => Err(format!(
            "{place}: {:?} cannot be a name: use 1 to {MAX_NAME} letters, digits, `_`, `-` and `.`",
            cut(name)
        )),
    }
}

fn cut(text: &str) -> String {
    let mut cut: String = text.chars().take(MAX_SHOWN).collect();
    if cut.len() < text.len() {
        cut += "...";
    }
    cut
}

/// A value of JSON whose objects have no name twice.
enum Node {
    Object(Vec<(String, Node)>),
    List(Vec<Node>),
    Scalar(Json),
}

impl Node {
    fn object(self, place: &str, what: &str) -> Result<Vec<(String, Self)>, String> {
        match self {
            Self::Object(entries) => Ok(entries),
            other => Err(format!(
                "{place} must be an object with {what}, such as {{\"wombat-1\": {{\"drive\": {{\"kp\": 2.0}}}}}}, not {}",
                other.kind()
            )),
        }
    }

    fn value(self, place: &str) -> Result<ParameterValue, String> {
        let kind = self.kind();
        let wrong =
            || format!("{place} must be a bool, number, text or list of numbers, not {kind}");
        let json = match self {
            Self::Object(_) => return Err(wrong()),
            Self::Scalar(json) => json,
            Self::List(nodes) => {
                let scalars = nodes.into_iter().map(|node| match node {
                    Self::Scalar(json @ Json::Number(_)) => Ok(json),
                    other => Err(format!(
                        "{place} must be a list of numbers, and contains {}",
                        other.kind()
                    )),
                });
                Json::Array(scalars.collect::<Result<_, _>>()?)
            }
        };
        serde_json::from_value(json).map_err(|_| wrong())
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Object(_) => "an object",
            Self::List(_) => "a list",
            Self::Scalar(Json::Null) => "null",
            Self::Scalar(Json::Bool(_)) => "a bool",
            Self::Scalar(Json::Number(_)) => "a number",
            Self::Scalar(_) => "a text",
        }
    }
}

impl<'de> Deserialize<'de> for Node {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NodeVisitor)
    }
}

struct NodeVisitor;

impl<'de> Visitor<'de> for NodeVisitor {
    type Value = Node;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<Node, E> {
        Ok(Node::Scalar(Json::Null))
    }

    fn visit_bool<E>(self, value: bool) -> Result<Node, E> {
        Ok(Node::Scalar(value.into()))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Node, E> {
        Ok(Node::Scalar(value.into()))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Node, E> {
        Ok(Node::Scalar(value.into()))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Node, E> {
        Ok(Node::Scalar(value.into()))
    }

    fn visit_str<E>(self, value: &str) -> Result<Node, E> {
        Ok(Node::Scalar(value.into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Node, A::Error> {
        let mut nodes = Vec::new();
        while let Some(node) = list.next_element()? {
            nodes.push(node);
        }
        Ok(Node::List(nodes))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Node, A::Error> {
        let mut entries = BTreeMap::new();
        while let Some(name) = map.next_key::<String>()? {
            if entries.contains_key(&name) {
                return Err(A::Error::custom(format!("{:?} occurs twice", cut(&name))));
            }
            let node: Node = map.next_value()?;
            entries.insert(name, node);
        }
        Ok(Node::Object(entries.into_iter().collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_are_parsed() {
        let profile = parse(
            r#"{"wombat-2": {"arm": {}}, "wombat-1": {"drive": {"kp": 2, "side": "left", "turbo": true, "points": [1, 2.5]}}}"#,
        );
        let profile = profile.expect("valid");
        let robots: Vec<_> = profile.keys().map(Name::as_str).collect();
        assert_eq!(robots, ["wombat-1", "wombat-2"]);
        let drive = &profile[robots_name(&profile, "wombat-1")]["drive"];
        assert_eq!(drive["kp"], ParameterValue::Integer(2));
        assert_eq!(drive["points"], vec![1.0, 2.5].into());
    }

    fn robots_name<'a>(profile: &'a Profile, name: &str) -> &'a Name {
        profile
            .keys()
            .find(|robot| robot.as_str() == name)
            .expect("a robot")
    }

    #[test]
    fn wrong_profiles_are_rejected_with_the_place() {
        for (text, reason) in [
            ("", "EOF"),
            ("{}", "contains no group"),
            (r#"{"a": {}}"#, "contains no group"),
            ("[]", "the profile must be an object with robots"),
            (r#"{"a": 1}"#, "a must be an object with groups"),
            (
                r#"{"a": {"drive": 1}}"#,
                "a/drive must be an object with parameters",
            ),
            (r#"{"a b": {}}"#, "\"a b\": "),
            (r#"{"a": {"b/c": {}}}"#, "a: \"b/c\" cannot be a name"),
            (
                r#"{"a": {"drive": {"": 1}}}"#,
                "a/drive: \"\" cannot be a name",
            ),
            (
                r#"{"a": {"drive": {"kp": null}}}"#,
                "a/drive/kp must be a bool, number, text or list of numbers, not null",
            ),
            (
                r#"{"a": {"drive": {"kp": {}}}}"#,
                "a/drive/kp must be a bool, number, text or list of numbers, not an object",
            ),
            (
                r#"{"a": {"drive": {"kp": [1, "a"]}}}"#,
                "a/drive/kp must be a list of numbers, and contains a text",
            ),
            (
                "{\"a\": {\"drive\": {\"kp\": 1,\n\"kp\": 2}}}",
                "\"kp\" occurs twice at line 2",
            ),
            (
                "{\"a\": {\"drive\": {}, \"drive\": {}}}",
                "\"drive\" occurs twice at line 1",
            ),
            (r#"{"a": {"drive": {"kp": NaN}}}"#, "line 1 column"),
            (
                r#"{"a": {"drive": {"kp": 1e999}}}"#,
                "number out of range at line 1",
            ),
            (r#"{"a": {"drive": {}}} {}"#, "trailing characters"),
        ] {
            let error = parse(text).expect_err(reason);
            assert!(error.contains(reason), "{text}: {error}");
        }
        let deep = parse(&"[".repeat(100_000)).expect_err("too deep");
        assert!(deep.contains("recursion limit"), "{deep}");
        let long = parse(&format!(r#"{{"{}": 1}}"#, "x".repeat(10_000))).expect_err("too long");
        assert!(long.len() < 500, "{long}");
    }

    #[test]
    fn files_over_the_limit_are_rejected() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("large.json");
        let profile = r#"{"a": {"drive": {"kp": 1}}}"#;
        let fill = |size: usize| format!("{profile}{}", " ".repeat(size - profile.len()));
        std::fs::write(&path, fill(MAX_BYTES as usize)).expect("written");
        read(&path).expect("within the limit");
        std::fs::write(&path, fill(MAX_BYTES as usize + 1)).expect("written");
        let error = read(&path).expect_err("too large").to_string();
        assert!(
            error.contains("large.json: a profile has at most 1000000 bytes"),
            "{error}"
        );
        std::fs::write(&path, b"\xff").expect("written");
        let error = read(&path).expect_err("no text").to_string();
        assert!(error.contains("UTF-8"), "{error}");
    }
}

//! Owns changing the text of a file of connections: the whole of it, or one connection, around which comments and everything
//! else stay as they are.
use std::{borrow::Cow, io};

use jsonc_parser::cst::{CstArray, CstInputValue, CstObject, CstRootNode};
use serde_json::Value;

use super::{
    file::{self, Limits, Mistake},
    spec::Spec,
};

/// Where there is no file yet.
const EMPTY: &str = "{\n  \"connections\": []\n}\n";

/// What is to become of a text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Edit {
    /// This takes its place.
    Whole(String),
    /// It gets this connection, as JSON, instead of the one of that name if there is one.
    Add(String),
    /// It has the connection of this name no more.
    Remove(String),
}

/// Why a text is not taken.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// Something in the new one.
    #[error("the new connections, {0}")]
    Mistake(#[from] Mistake),
    /// Mend what is there, or replace the whole of it.
    #[error("the file of connections has a mistake, mend it first: {0}")]
    Before(Mistake),
    /// The connection is none.
    #[error("the connection can't be added: {0}")]
    Connection(String),
    /// There is nothing to remove.
    #[error("there is no connection {name:?} in the file; there are: {there}")]
    NoSuch {
        /// The one that was named.
        name: String,
        /// Those there are.
        there: String,
    },
    /// Read it, and change what is there now.
    #[error("somebody else changed the connections: their revision is {now} now, read them again")]
    Outdated {
        /// Of what is there.
        now: String,
    },
    /// The system does not let it be read or written.
    #[error("the file of connections can't be changed: {0}")]
    File(#[from] io::Error),
}

impl Edit {
    /// What becomes of `text`, which is asked for where that matters.
    pub fn applied(
        &self,
        text: impl FnOnce() -> io::Result<String>,
        limits: &Limits,
    ) -> Result<Cow<'_, str>, EditError> {
        match self {
            Self::Whole(new) => Ok(new.into()),
            Self::Add(connection) => added(text()?, connection, limits).map(Cow::from),
            Self::Remove(name) => removed(&text()?, name, limits).map(Cow::from),
        }
    }
}

fn added(text: String, connection: &str, limits: &Limits) -> Result<String, EditError> {
    let spec = one(connection, limits)?;
    let text = match text.trim().is_empty() {
        true => EMPTY.to_owned(),
        false => text,
    };
    let before = file::parse(&text, limits).map_err(EditError::Before)?;
    if before.connections.contains(&spec) {
        return Ok(text);
    }
    let value = serde_json::from_str(connection)
        .map_err(|error| EditError::Connection(error.to_string()))?;
    let (root, list) = list(&text)?;
    match named(&list, &spec.name) {
        Some(there) => drop(there.replace_with(input(value))),
        None => drop(list.append(input(value))),
    }
    Ok(root.to_string())
}

fn removed(text: &str, name: &str, limits: &Limits) -> Result<String, EditError> {
    let before = match text.trim().is_empty() {
        true => Vec::new(),
        false => {
            file::parse(text, limits)
                .map_err(EditError::Before)?
                .connections
        }
    };
    if before.iter().all(|spec| spec.name != name) {
        let there: Vec<_> = before.iter().map(|spec| spec.name.as_str()).collect();
        return Err(EditError::NoSuch {
            name: name.chars().take(super::spec::MAX_NAME).collect(),
            there: if there.is_empty() {
                "none".to_owned()
            } else {
                there.join(", ")
            },
        });
    }
    let (root, list) = list(text)?;
    if let Some(there) = named(&list, name) {
        there.remove();
    }
    Ok(root.to_string())
}

/// A connection by itself.
fn one(connection: &str, limits: &Limits) -> Result<Spec, EditError> {
    let alone = format!("{{\"connections\":[{connection}]}}");
    let limits = Limits {
        most: 1,
        ..limits.clone()
    };
    let wrong = |what: String| EditError::Connection(what);
    let wanted = file::parse(&alone, &limits).map_err(|mistake| wrong(mistake.what))?;
    let first = wanted.connections.into_iter().next();
    first.ok_or_else(|| wrong("it is { \"name\": ..., \"method\": ..., \"address\": ... }".into()))
}

/// The list of connections of a valid text, and the text that it is changed in.
fn list(text: &str) -> Result<(CstRootNode, CstArray), EditError> {
    let no_list = || EditError::Connection("the file has no list of connections".to_owned());
    let root = CstRootNode::parse(text, &file::json_with_comments()).map_err(|_| no_list())?;
    let list = root
        .object_value()
        .and_then(|whole| whole.array_value("connections"));
    let list = list.ok_or_else(no_list)?;
    Ok((root, list))
}

fn named(list: &CstArray, name: &str) -> Option<CstObject> {
    let mut all = list
        .elements()
        .into_iter()
        .filter_map(|element| element.as_object());
    all.find(|one| {
        let its = one
            .get("name")
            .and_then(|field| field.value()?.as_string_lit());
        its.is_some_and(|its| its.decoded_value().is_ok_and(|its| its == name))
    })
}

fn input(value: Value) -> CstInputValue {
    match value {
        Value::Null => CstInputValue::Null,
        Value::Bool(bool) => CstInputValue::Bool(bool),
        Value::Number(number) => CstInputValue::Number(number.to_string()),
        Value::String(text) => CstInputValue::String(text),
        Value::Array(all) => CstInputValue::Array(all.into_iter().map(input).collect()),
        Value::Object(all) => {
            let fields = all.into_iter().map(|(key, value)| (key, input(value)));
            CstInputValue::Object(fields.collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "{\n  // ours\n  \"connections\": [\n    // the base\n    { \"name\": \"base\", \"method\": \"tcp\", \
                        \"address\": \"10.0.0.1\", \"port\": 7447 }, // always on\n    { \"name\": \"arm\", \"method\": \"ble\", \
                        \"address\": \"wombat-9\" },\n  ]\n}\n";

    fn edited(text: &str, edit: Edit) -> Result<String, String> {
        let limits = Limits {
            robot: "wombat-1".into(),
            most: 3,
        };
        let text = edit.applied(|| Ok(text.to_owned()), &limits);
        let text = text.map_err(|error| error.to_string())?;
        file::parse(&text, &limits).map_err(|mistake| mistake.to_string())?;
        Ok(text.into_owned())
    }

    fn add(text: &str, connection: &str) -> Result<String, String> {
        edited(text, Edit::Add(connection.to_owned()))
    }

    fn remove(text: &str, name: &str) -> Result<String, String> {
        edited(text, Edit::Remove(name.to_owned()))
    }

    #[test]
    fn one_connection_changes_and_comments_stay() {
        let new = r#"{"name":"leg","method":"ble","address":"wombat-4"}"#;
        let more = add(TEXT, new).expect("added");
        assert!(
            more.contains("wombat-4") && more.contains("// ours") && more.contains("// always on"),
            "{more}"
        );
        assert_eq!(add(&more, new).expect("as it is"), more);
        let elsewhere = add(
            &more,
            r#"{"name":"base","method":"tcp","address":"10.0.0.2","port":1}"#,
        )
        .expect("changed");
        assert!(
            elsewhere.contains("10.0.0.2") && !elsewhere.contains("10.0.0.1"),
            "{elsewhere}"
        );
        assert!(
            elsewhere.contains("// the base") && elsewhere.contains("wombat-4"),
            "{elsewhere}"
        );
        let fewer = remove(&more, "arm").expect("removed");
        assert!(
            !fewer.contains("wombat-9") && fewer.contains("// ours"),
            "{fewer}"
        );
        let none = remove(&remove(&fewer, "leg").expect("removed"), "base").expect("removed");
        assert!(none.contains("// ours"), "{none}");
    }

    #[test]
    fn the_first_one_makes_the_file() {
        let text = add("", r#"{"name":"leg","method":"ble","address":"wombat-4"}"#).expect("added");
        assert!(text.starts_with("{\n  \"connections\": [\n"), "{text}");
    }

    #[test]
    fn what_can_not_be_is_said() {
        for (edit, named) in [
            (add(TEXT, "1"), "a connection is {"),
            (add(TEXT, ""), "it is { \"name\""),
            (
                add(TEXT, r#"{"name":"x","method":"tcp","address":"a"}"#),
                "tcp needs a port",
            ),
            (
                add(TEXT, r#"{"name":"x","method":"ble","address":"wombat-9"}"#),
                "leads where",
            ),
            (
                add(TEXT, r#"{"name":"x","method":"ble","address":"wombat-1"}"#),
                "this robot itself",
            ),
            (
                add(
                    TEXT,
                    r#"{"name":"x","method":"ble","address":"a"},{"name":"y","method":"ble","address":"b"}"#,
                ),
                "too many",
            ),
            (add(TEXT, r#"]},{"#), "can't be added"),
            (
                add("{", r#"{"name":"x","method":"ble","address":"a"}"#),
                "mend it first",
            ),
            (remove(TEXT, "leg"), "there are: base, arm"),
            (remove("", "leg"), "there are: none"),
        ] {
            let said = edit.expect_err(named);
            assert!(said.contains(named), "{said}");
        }
    }
}

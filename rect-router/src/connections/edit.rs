//! Edits the text of a connections file. Adding or removing one connection preserves the comments and everything else.
use std::{borrow::Cow, io};

use jsonc_parser::cst::{CstArray, CstInputValue, CstObject, CstRootNode};
use rect_connections::{
    file::{self, Limits, Mistake},
    spec::{Spec, MAX_NAME},
};
use serde_json::Value;

/// The text to edit if there is no file yet.
const EMPTY: &str = "{\n  \"connections\": []\n}\n";

/// A change of the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Edit {
    /// Replaces the whole text.
    Whole(String),
    /// Adds this connection, given as JSON, or replaces the connection of the same name.
    Add(String),
    /// Removes the connection of this name.
    Remove(String),
}

/// The reason why an edit was rejected.
#[derive(Debug, thiserror::Error)]
pub enum EditError {
    /// The new text has a mistake.
    #[error("the new connections have a mistake at {0}")]
    Mistake(#[from] Mistake),
    /// The current file has a mistake. Correct it, or replace the whole text.
    #[error("the connections file has a mistake, correct it first: {0}")]
    Before(Mistake),
    /// The given connection is invalid.
    #[error("the connection cannot be added: {0}")]
    Connection(String),
    /// The connection to remove does not exist.
    #[error("there is no connection {name:?} in the file; there are: {existing}")]
    NoSuch {
        /// Name of the connection to remove.
        name: String,
        /// Names of the existing connections.
        existing: String,
    },
    /// The file has another revision than the editor expected. Read it again and repeat the change.
    #[error("the connections have been changed in the meantime: their revision is now {now}; read them again")]
    Outdated {
        /// Revision of the file.
        now: String,
    },
    /// The file cannot be read or written.
    #[error("the connections file cannot be changed: {0}")]
    File(#[from] io::Error),
}

impl Edit {
    /// Returns the edited text. `text` returns the current text; it is called only if the result depends on it.
    ///
    /// # Errors
    /// Fails if the edit or the current text is invalid, or if `text` fails. The result of [`Edit::Whole`] is not checked.
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

/// Adds a connection to the text, or replaces the one of the same name.
fn added(text: String, connection: &str, limits: &Limits) -> Result<String, EditError> {
    let spec = single_connection(connection, limits)?;
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
        Some(existing) => drop(existing.replace_with(input(value))),
        None => drop(list.append(input(value))),
    }
    Ok(root.to_string())
}

/// Removes the connection of that name from the text.
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
        let existing: Vec<_> = before.iter().map(|spec| spec.name.as_str()).collect();
        return Err(EditError::NoSuch {
            name: name.chars().take(MAX_NAME).collect(),
            existing: if existing.is_empty() {
                "none".to_owned()
            } else {
                existing.join(", ")
            },
        });
    }
    let (root, list) = list(text)?;
    if let Some(existing) = named(&list, name) {
        existing.remove();
    }
    Ok(root.to_string())
}

/// Parses a single connection.
fn single_connection(connection: &str, limits: &Limits) -> Result<Spec, EditError> {
    let alone = format!("{{\"connections\":[{connection}]}}");
    let limits = Limits {
        max_connections: 1,
        ..limits.clone()
    };
    let invalid = |problem: String| EditError::Connection(problem);
    let contents = file::parse(&alone, &limits).map_err(|mistake| invalid(mistake.problem))?;
    let first = contents.connections.into_iter().next();
    first.ok_or_else(|| {
        invalid("give it as { \"name\": ..., \"method\": ..., \"address\": ... }".into())
    })
}

/// Returns the syntax tree of a valid text, and the list of connections in it.
fn list(text: &str) -> Result<(CstRootNode, CstArray), EditError> {
    let no_list = || EditError::Connection("the file has no list of connections".to_owned());
    let root = CstRootNode::parse(text, &file::json_with_comments()).map_err(|_| no_list())?;
    let list = root
        .object_value()
        .and_then(|whole| whole.array_value("connections"));
    let list = list.ok_or_else(no_list)?;
    Ok((root, list))
}

/// Returns the element of the list with that name.
fn named(list: &CstArray, name: &str) -> Option<CstObject> {
    let mut all = list
        .elements()
        .into_iter()
        .filter_map(|element| element.as_object());
    all.find(|connection| {
        let its_name = connection
            .get("name")
            .and_then(|field| field.value()?.as_string_lit());
        its_name.is_some_and(|text| text.decoded_value().is_ok_and(|text| text == name))
    })
}

/// Converts a JSON value to an input of the syntax tree.
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
            max_connections: 3,
            option_folders: vec!["/etc/rect".into()],
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
    fn adding_and_removing_a_connection_preserves_comments() {
        let new = r#"{"name":"leg","method":"ble","address":"wombat-4"}"#;
        let more = add(TEXT, new).expect("added");
        assert!(
            more.contains("wombat-4") && more.contains("// ours") && more.contains("// always on"),
            "{more}"
        );
        assert_eq!(add(&more, new).expect("unchanged"), more);
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
    fn adding_to_an_empty_text_creates_the_list() {
        let text = add("", r#"{"name":"leg","method":"ble","address":"wombat-4"}"#).expect("added");
        assert!(text.starts_with("{\n  \"connections\": [\n"), "{text}");
    }

    #[test]
    fn rejects_invalid_edits() {
        for (edit, expected) in [
            (add(TEXT, "1"), "a connection must be {"),
            (add(TEXT, ""), "give it as { \"name\""),
            (
                add(TEXT, r#"{"name":"x","method":"tcp","address":"a"}"#),
                "tcp needs a port",
            ),
            (
                add(TEXT, r#"{"name":"x","method":"ble","address":"wombat-9"}"#),
                "same peer as",
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
            (
                add(
                    TEXT,
                    r#"{"name":"x","method":"tls","address":"a","port":1,"options":{"root_ca_certificate_file":"/dev/zero"}}"#,
                ),
                "be in /etc/rect",
            ),
            (add(TEXT, r#"]},{"#), "cannot be added"),
            (
                add("{", r#"{"name":"x","method":"ble","address":"a"}"#),
                "correct it first",
            ),
            (remove(TEXT, "leg"), "there are: base, arm"),
            (remove("", "leg"), "there are: none"),
        ] {
            let error = edit.expect_err(expected);
            assert!(error.contains(expected), "{error}");
        }
    }
}

//! Owns the reading of `connections.json`: JSON with comments becomes connections that can be dialled, or the one mistake
//! with its line and column. Half a file is never taken.
use std::{
    collections::HashMap,
    fs::File,
    io::{self, Read},
    path::{Path, PathBuf},
};

use jsonc_parser::{
    ast::{Object, ObjectProp, Value},
    common::{Range, Ranged},
    parse_to_ast, ParseOptions,
};

use super::spec::{Spec, Written, Wrong};

/// The largest file that is read, in bytes: some ten thousand connections.
const MAX_BYTES: u64 = 1 << 20;

/// Why a file is not taken. Nothing changes then.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It is not there, or may not be read.
    #[error("{path} can't be read", path = path.display())]
    Unreadable {
        /// Which.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// It is over the limit.
    #[error("{path} is larger than {MAX_BYTES} bytes: that is no list of connections", path = path.display())]
    TooLarge {
        /// Which.
        path: PathBuf,
    },
    /// Something in it.
    #[error("{path}:{mistake}", path = path.display())]
    Mistake {
        /// Which.
        path: PathBuf,
        /// Where, and what.
        mistake: Mistake,
    },
}

/// The first thing that is wrong in a text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{line}:{column}: {what}")]
pub struct Mistake {
    /// From 1.
    pub line: usize,
    /// In characters, from 1.
    pub column: usize,
    /// What, and what it should be.
    pub what: String,
}

/// The connections of a file.
pub fn read(path: &Path, most: usize) -> Result<Vec<Spec>, FileError> {
    let path = || path.to_owned();
    let mut bytes = Vec::new();
    File::open(path())
        .and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes))
        .map_err(|source| FileError::Unreadable {
            path: path(),
            source,
        })?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(FileError::TooLarge { path: path() });
    }
    let text = String::from_utf8(bytes).map_err(|error| {
        let good = error.utf8_error().valid_up_to();
        let before = String::from_utf8_lossy(&error.as_bytes()[..good]).into_owned();
        let what = "this is no text (UTF-8)".to_owned();
        let mistake = at(&before, before.len(), what);
        FileError::Mistake {
            path: path(),
            mistake,
        }
    })?;
    parse(&text, most).map_err(|mistake| FileError::Mistake {
        path: path(),
        mistake,
    })
}

/// The connections of a text; `most`: how many there may be.
pub fn parse(text: &str, most: usize) -> Result<Vec<Spec>, Mistake> {
    if text.len() as u64 > MAX_BYTES {
        let what = format!("these are more than {MAX_BYTES} bytes");
        return Err(at(text, 0, what));
    }
    let reader = Reader { text, most };
    let parsed = parse_to_ast(text, &Default::default(), &json_with_comments())
        .map_err(|error| reader.wrong(error.range(), error.kind().to_string()))?;
    reader.connections(parsed.value)
}

/// Comments, and commas after the last one; nothing else that JSON has not.
fn json_with_comments() -> ParseOptions {
    ParseOptions {
        allow_comments: true,
        allow_trailing_commas: true,
        allow_loose_object_property_names: false,
        allow_missing_commas: false,
        allow_single_quoted_strings: false,
        allow_hexadecimal_numbers: false,
        allow_unary_plus_numbers: false,
        allow_bare_decimal_point_numbers: false,
        allow_non_finite_numbers: false,
        allow_extended_string_escapes: false,
    }
}

struct Reader<'a> {
    text: &'a str,
    most: usize,
}

impl<'a> Reader<'a> {
    fn connections(&self, whole: Option<Value<'a>>) -> Result<Vec<Spec>, Mistake> {
        let wanted = "the file holds { \"connections\": [ ... ] }";
        let start = Range::new(0, 0);
        let whole = whole.ok_or_else(|| self.wrong(start, wanted))?;
        let Value::Object(whole) = whole else {
            return Err(self.wrong(whole.range(), wanted));
        };
        let fields = self.fields(&whole, &["$schema", "connections"])?;
        let Some(list) = fields.get("connections") else {
            return Err(self.wrong(whole.range, wanted));
        };
        let Value::Array(list) = &list.value else {
            return Err(self.wrong(list.value.range(), "connections is a list"));
        };
        let (mut names, mut targets, mut specs) = (HashMap::new(), HashMap::new(), Vec::new());
        for value in &list.elements {
            if specs.len() == self.most {
                let what = format!(
                    "one connection too many: there may be {} (plugins/rect/max_connections)",
                    self.most
                );
                return Err(self.wrong(value.range(), what));
            }
            let (spec, range) = self.connection(value)?;
            let line = |range: &Range| self.place(range.start).0;
            if let Some(first) = names.insert(spec.name.clone(), range) {
                let what = format!("{} is in line {} already", spec.name, line(&first));
                return Err(self.wrong(range, what));
            }
            if let Some(first) = targets.insert(spec.target(), range) {
                let what = format!(
                    "{} leads where the connection of line {} does",
                    spec.name,
                    line(&first)
                );
                return Err(self.wrong(range, what));
            }
            specs.push(spec);
        }
        Ok(specs)
    }

    fn connection(&self, value: &Value<'a>) -> Result<(Spec, Range), Mistake> {
        const KEYS: [&str; 6] = ["name", "method", "address", "port", "psm", "options"];
        let Value::Object(object) = value else {
            let what = "a connection is { \"name\": ..., \"method\": ..., \"address\": ... }";
            return Err(self.wrong(value.range(), what));
        };
        let fields = self.fields(object, &KEYS)?;
        let text = |key: &str| match fields.get(key).map(|field| &field.value) {
            Some(Value::StringLit(text)) => Ok(text.value.to_string()),
            Some(other) => Err(self.wrong(other.range(), format!("{key} is text"))),
            None => Err(self.wrong(object.range, format!("{key} is missing"))),
        };
        let number = |key: &str| match fields.get(key).map(|field| &field.value) {
            None => Ok(None),
            Some(value) => {
                let number = match value {
                    Value::NumberLit(number) => number.value.parse().ok(),
                    _ => None,
                };
                let wanted = || self.wrong(value.range(), format!("{key} is 0 to {}", u16::MAX));
                number.ok_or_else(wanted).map(Some)
            }
        };
        let mut written = Written {
            name: text("name")?,
            method: text("method")?,
            address: text("address")?,
            port: number("port")?,
            psm: number("psm")?,
            ..Written::default()
        };
        if let Some(options) = fields.get("options") {
            let Value::Object(options) = &options.value else {
                return Err(self.wrong(options.value.range(), "options is { \"key\": value }"));
            };
            for (key, field) in self.fields(options, &[])? {
                let value = match &field.value {
                    Value::StringLit(text) => text.value.to_string(),
                    Value::NumberLit(number) => number.value.to_owned(),
                    Value::BooleanLit(boolean) => boolean.value.to_string(),
                    other => {
                        let what = "an option is text, a number, true or false";
                        return Err(self.wrong(other.range(), what));
                    }
                };
                written.options.insert(key.to_owned(), value);
            }
        }
        let spec = Spec::of(written).map_err(|Wrong { field, what }| {
            let field = field.and_then(|field| fields.get(field));
            let range = field.map_or(object.range, |field| field.value.range());
            self.wrong(range, what)
        })?;
        Ok((spec, object.range))
    }

    /// The fields of an object, each once; `known`: the keys there may be, empty for any.
    fn fields<'o>(
        &self,
        object: &'o Object<'a>,
        known: &[&str],
    ) -> Result<HashMap<&'o str, &'o ObjectProp<'a>>, Mistake> {
        let mut fields = HashMap::new();
        for field in &object.properties {
            let key = field.name.as_str();
            if !known.is_empty() && !known.contains(&key) {
                let what = format!("`{key}` is unknown here; known are {}", known.join(", "));
                return Err(self.wrong(field.range, what));
            }
            if fields.insert(key, field).is_some() {
                return Err(self.wrong(field.range, format!("{key} is there twice")));
            }
        }
        Ok(fields)
    }

    fn wrong(&self, range: Range, what: impl Into<String>) -> Mistake {
        at(self.text, range.start, what.into())
    }

    fn place(&self, byte: usize) -> (usize, usize) {
        place(self.text, byte)
    }
}

fn at(text: &str, byte: usize, what: String) -> Mistake {
    let (line, column) = place(text, byte);
    Mistake { line, column, what }
}

/// Line and column of a byte.
fn place(text: &str, byte: usize) -> (usize, usize) {
    let before = text.get(..byte).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = before.matches('\n').count() + 1;
    (line, before[line_start..].chars().count() + 1)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    const MOST: usize = 3;

    fn mistake(text: &str) -> String {
        parse(text, MOST).expect_err("wrong").to_string()
    }

    /// Connections as a file of them, the first in line 2.
    fn file(connections: &[&str]) -> String {
        format!("{{\"connections\": [\n{}\n]}}", connections.join(",\n"))
    }

    const BASE: &str = r#"{"name": "base", "method": "tcp", "address": "10.0.0.1", "port": 7447}"#;

    #[test]
    fn comments_and_a_last_comma_are_fine() {
        let text = r#"// our robots
        {
          "$schema": "connections.schema.json",
          "connections": [
            /* by radio */
            { "name": "wombat-2", "method": "ble", "address": "wombat-2", "options": { "mtu": 500 } },
          ],
        }"#;
        let specs = parse(text, MOST).expect("valid");
        assert_eq!(specs[0].endpoint.to_string(), "ble/wombat-2#mtu=500");
        assert_eq!(parse(&file(&[]), MOST), Ok(Vec::new()));
    }

    #[test]
    fn each_mistake_has_its_place() {
        for (text, place) in [
            ("", "1:1: the file holds"),
            ("[]", "1:1: the file holds"),
            ("{}", "1:1: the file holds"),
            ("{\n  \"connections\": {}}", "2:18: connections is a list"),
            ("{\"connections\": [\n  1]}", "2:3: a connection is"),
            (
                "{\"connections\": [], \"more\": 1}",
                "1:21: `more` is unknown",
            ),
            ("{\"connections\": [\n", "1:17: "),
            ("{\"connections\": [\0]}", "1:18: "),
        ] {
            let mistake = mistake(text);
            assert!(mistake.starts_with(place), "{text}: {mistake}");
        }
        for (connection, place) in [
            (r#"{"name": "a"}"#, "2:1: method is missing"),
            (r#"{"name": 1}"#, "2:10: name is text"),
            (r#"{"name": "a", "name": "b"}"#, "2:15: name is there twice"),
            (
                r#"{"name": "a", "port": 70000, "method": "tcp", "address": "h"}"#,
                "2:23: port is",
            ),
            (
                r#"{"name": "a", "port": 1.5, "method": "tcp", "address": "h"}"#,
                "2:23: port is",
            ),
            (
                r#"{"name": "a b", "method": "ble", "address": "h"}"#,
                "2:10: a name has",
            ),
            (
                r#"{"name": "a", "method": "tcp", "address": "h"}"#,
                "2:1: tcp needs a port",
            ),
            (r#"{"name": "a", "prot": 1}"#, "2:15: `prot` is unknown"),
            (
                r#"{"name": "a", "method": "ble", "address": "b", "options": {"mtu": []}}"#,
                "2:67: an option is",
            ),
        ] {
            let mistake = mistake(&file(&[connection]));
            assert!(mistake.starts_with(place), "{connection}: {mistake}");
        }
    }

    #[test]
    fn a_name_or_a_target_twice_names_the_first() {
        assert!(mistake(&file(&[BASE, BASE])).starts_with("3:1: base is in line 2"));
        let other = BASE.replace("base", "other");
        assert!(mistake(&file(&[BASE, &other])).starts_with("3:1: other leads where"));
    }

    /// An editor that knows the schema and the router agree.
    #[test]
    fn the_schema_says_the_same() {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../config");
        let text = |name| std::fs::read_to_string(config.join(name)).expect("a file");
        let schema = serde_json::from_str(&text("connections.schema.json")).expect("JSON");
        let schema = jsonschema::validator_for(&schema).expect("a schema");
        let agree = |text: &str| {
            let document = jsonc_parser::parse_to_serde_value(text, &json_with_comments());
            let ours = parse(text, MOST);
            let theirs = schema.is_valid(&document.expect("JSON"));
            assert_eq!(ours.is_ok(), theirs, "{text}: {ours:?}");
            theirs
        };
        assert!(agree(&text("connections.json")));
        let one = |fields: &str| agree(&file(&[&format!("{{{fields}}}")]));
        assert!(one(
            r#""name": "a", "method": "ble", "address": "b", "psm": 128, "options": {"mtu": 500}"#
        ));
        assert!(one(
            r#""name": "a", "method": "udp", "address": "::1", "port": 1"#
        ));
        assert!(one(
            r#""name": "a", "method": "unixsock-stream", "address": "/run/a""#
        ));
        for wrong in [
            r#""name": "a", "method": "ble""#,
            r#""name": "", "method": "ble", "address": "b""#,
            r#""name": "a b", "method": "ble", "address": "b""#,
            r#""name": 1, "method": "ble", "address": "b""#,
            r#""name": "a", "method": "tpc", "address": "b", "port": 1"#,
            r#""name": "a", "method": "tcp", "address": "b""#,
            r#""name": "a", "method": "tcp", "address": "b", "port": 0"#,
            r#""name": "a", "method": "tcp", "address": "b", "port": 65536"#,
            r#""name": "a", "method": "tcp", "address": "b", "port": "1""#,
            r#""name": "a", "method": "tcp", "address": "b", "port": 1, "psm": 128"#,
            r#""name": "a", "method": "ble", "address": "b", "port": 1"#,
            r#""name": "a", "method": "ble", "address": "b", "psm": 127"#,
            r#""name": "a", "method": "ble", "address": "b c""#,
            r#""name": "a", "method": "ble", "address": """#,
            r#""name": "a", "method": "ble", "address": "b", "more": 1"#,
            r#""name": "a", "method": "ble", "address": "b", "options": []"#,
            r#""name": "a", "method": "ble", "address": "b", "options": {"mtu": null}"#,
        ] {
            assert!(!one(wrong), "{wrong}");
        }
        assert!(!agree("{}") && !agree("[]") && !agree(r#"{"connections": [], "more": 1}"#));
    }

    #[test]
    fn both_sides_of_the_limits() {
        let many: Vec<_> = (0..=MOST)
            .map(|n| format!(r#"{{"name": "r{n}", "method": "ble", "address": "r{n}"}}"#))
            .collect();
        let many: Vec<_> = many.iter().map(String::as_str).collect();
        assert_eq!(
            parse(&file(&many[..MOST]), MOST).expect("valid").len(),
            MOST
        );
        assert!(mistake(&file(&many)).starts_with("5:1: one connection too many"));

        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("connections.json");
        let written = |bytes: &[u8]| {
            File::create(&path)
                .and_then(|mut file| file.write_all(bytes))
                .expect("written");
            read(&path, MOST)
                .map(|specs| specs.len())
                .map_err(|error| error.to_string())
        };
        assert_eq!(written(file(&[BASE]).as_bytes()), Ok(1));
        assert!(written(b"{\n\xff").is_err_and(|e| e.ends_with(":2:1: this is no text (UTF-8)")));
        let blanks = vec![b' '; MAX_BYTES as usize + 1];
        assert!(written(&blanks).is_err_and(|e| e.contains("larger")));
        assert!(written(&blanks[1..]).is_err_and(|e| e.contains("the file holds")));
        let deep = "[".repeat(100_000);
        assert!(written(deep.as_bytes()).is_err_and(|e| e.contains("depth")));
        let nowhere = read(&folder.path().join("nowhere"), MOST).expect_err("not there");
        assert!(nowhere.to_string().contains("nowhere"));
    }
}

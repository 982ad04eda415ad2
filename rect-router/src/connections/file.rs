//! Owns the reading of `connections.json`: JSON with comments becomes connections that can be dialled and, if it has one, a
//! rule for the rest of the fleet; or the one mistake with its line and column. Half a file is never taken.
use std::{
    collections::HashMap,
    io::{self, Read},
    path::{Path, PathBuf},
    str::FromStr,
};

use jsonc_parser::{
    ast::{Object, ObjectProp, Value},
    common::{Range, Ranged},
    parse_to_ast, ParseOptions,
};

use super::spec::{Spec, Written, Wrong};
use crate::{
    config::{AutoConnect, MAX_AUTO_LINKS},
    regular_file,
};

/// The largest file that is read, in bytes: some ten thousand connections.
pub(super) const MAX_BYTES: u64 = 1 << 20;

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

/// What a file says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Of different names, and to different peers.
    pub connections: Vec<Spec>,
    /// Instead of the one of the settings.
    pub auto_connect: Option<AutoConnect>,
    /// Instead of the one of the settings.
    pub auto_links: Option<usize>,
}

/// What a file is held against.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Whose connections they are: none leads to this robot itself.
    pub robot: String,
    /// How many there may be.
    pub most: usize,
}

/// What a file says.
pub fn read(path: &Path, limits: &Limits) -> Result<Wanted, FileError> {
    let path = || path.to_owned();
    let mut bytes = Vec::new();
    regular_file::open(&path())
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
    parse(&text, limits).map_err(|mistake| FileError::Mistake {
        path: path(),
        mistake,
    })
}

/// What a text says.
pub fn parse(text: &str, limits: &Limits) -> Result<Wanted, Mistake> {
    if text.len() as u64 > MAX_BYTES {
        let what = format!("these are more than {MAX_BYTES} bytes");
        return Err(at(text, 0, what));
    }
    let reader = Reader { text, limits };
    let parsed = parse_to_ast(text, &Default::default(), &json_with_comments())
        .map_err(|error| reader.wrong(error.range(), error.kind().to_string()))?;
    reader.wanted(parsed.value)
}

/// Comments, and commas after the last one; nothing else that JSON has not.
pub(super) fn json_with_comments() -> ParseOptions {
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
    limits: &'a Limits,
}

impl<'a> Reader<'a> {
    fn wanted(&self, whole: Option<Value<'a>>) -> Result<Wanted, Mistake> {
        let wanted = "the file holds { \"connections\": [ ... ] }";
        let start = Range::new(0, 0);
        let whole = whole.ok_or_else(|| self.wrong(start, wanted))?;
        let Value::Object(whole) = whole else {
            return Err(self.wrong(whole.range(), wanted));
        };
        const KEYS: [&str; 4] = ["$schema", "auto_connect", "auto_links", "connections"];
        let fields = self.fields(&whole, &KEYS)?;
        let Some(list) = fields.get("connections") else {
            return Err(self.wrong(whole.range, wanted));
        };
        let auto_connect = fields.get("auto_connect").map(|field| {
            let rule = match &field.value {
                Value::StringLit(text) => AutoConnect::parse(&text.value),
                _ => None,
            };
            let what = "auto_connect is \"none\", \"listed\" or \"fleet\"";
            rule.ok_or_else(|| self.wrong(field.value.range(), what))
        });
        let auto_links = fields.get("auto_links").map(|field| {
            let number = number(&field.value);
            let number = number.filter(|number| (1..=MAX_AUTO_LINKS).contains(number));
            let what = format!("auto_links is 1 to {MAX_AUTO_LINKS}");
            number.ok_or_else(|| self.wrong(field.value.range(), what))
        });
        Ok(Wanted {
            auto_connect: auto_connect.transpose()?,
            auto_links: auto_links.transpose()?,
            connections: self.connections(list)?,
        })
    }

    fn connections(&self, list: &ObjectProp<'a>) -> Result<Vec<Spec>, Mistake> {
        let Value::Array(list) = &list.value else {
            return Err(self.wrong(list.value.range(), "connections is a list"));
        };
        let (mut names, mut targets, mut specs) = (HashMap::new(), HashMap::new(), Vec::new());
        for value in &list.elements {
            if specs.len() == self.limits.most {
                let what = format!(
                    "one connection too many: there may be {} (plugins/rect/max_connections)",
                    self.limits.most
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
            if spec.is_to(&self.limits.robot) {
                let what = format!("{} leads to this robot itself", spec.name);
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
        let number_of = |key: &str| match fields.get(key).map(|field| &field.value) {
            None => Ok(None),
            Some(value) => {
                let wanted = || self.wrong(value.range(), format!("{key} is 0 to {}", u16::MAX));
                number(value).ok_or_else(wanted).map(Some)
            }
        };
        let mut written = Written {
            name: text("name")?,
            method: text("method")?,
            address: text("address")?,
            port: number_of("port")?,
            psm: number_of("psm")?,
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

fn number<T: FromStr>(value: &Value) -> Option<T> {
    match value {
        Value::NumberLit(number) => number.value.parse().ok(),
        _ => None,
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
mod tests;

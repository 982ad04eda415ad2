//! Parses a connections file: JSON with comments that lists the connections to dial and may set the rule for automatic
//! connections. The result is either the whole file or its first mistake with line and column; a file is never applied in
//! part.
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

use rect_core::storage::regular_file;

use crate::{
    option_files,
    spec::{RawSpec, Spec, SpecError},
    AutoConnect, MAX_AUTO_LINKS,
};

/// Maximum size of a file in bytes; enough for about ten thousand connections.
pub const MAX_BYTES: u64 = 1 << 20;

/// The reason why a connections file was rejected.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file is missing or cannot be read.
    #[error("cannot read {path}", path = path.display())]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The file is larger than 1 MiB.
    #[error("{path} is larger than {MAX_BYTES} bytes, the limit of a connections file", path = path.display())]
    TooLarge {
        /// Path of the file.
        path: PathBuf,
    },
    /// The text of the file has a mistake.
    #[error("{path}:{mistake}", path = path.display())]
    Mistake {
        /// Path of the file.
        path: PathBuf,
        /// Position and description of the mistake.
        mistake: Mistake,
    },
}

/// The first mistake in a text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{line}:{column}: {problem}")]
pub struct Mistake {
    /// Line number, from 1.
    pub line: usize,
    /// Column in characters, from 1.
    pub column: usize,
    /// Description, with the values that are valid.
    pub problem: String,
}

/// The contents of a valid file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FileContents {
    /// The connections; no two have the same name, or the same method and address.
    pub connections: Vec<Spec>,
    /// Overrides `auto_connect` of the settings, if present.
    pub auto_connect: Option<AutoConnect>,
    /// Overrides `auto_links` of the settings, if present; 1 to 7.
    pub auto_links: Option<usize>,
}

/// The constraints that a file has to meet.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Name of the robot whose file it is: a connection to the robot itself is a mistake.
    pub robot: String,
    /// Maximum number of connections.
    pub max_connections: usize,
    /// Folders of the files that options may name.
    pub option_folders: Vec<PathBuf>,
}

/// Reads and parses a connections file.
///
/// # Errors
/// Fails if the file cannot be read, is larger than 1 MiB, or has a mistake.
pub fn read(path: &Path, limits: &Limits) -> Result<FileContents, FileError> {
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
        let problem = "this is not valid UTF-8 text".to_owned();
        let mistake = at(&before, before.len(), problem);
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

/// Parses the text of a connections file.
///
/// # Errors
/// The first mistake in the text.
pub fn parse(text: &str, limits: &Limits) -> Result<FileContents, Mistake> {
    if text.len() as u64 > MAX_BYTES {
        let problem = format!("the text has more than {MAX_BYTES} bytes");
        return Err(at(text, 0, problem));
    }
    let reader = Reader { text, limits };
    let parsed = parse_to_ast(text, &Default::default(), &json_with_comments())
        .map_err(|error| reader.mistake(error.range(), error.kind().to_string()))?;
    reader.contents(parsed.value)
}

/// Returns options for JSON with comments and trailing commas, but no other extensions.
pub fn json_with_comments() -> ParseOptions {
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
    fn contents(&self, whole: Option<Value<'a>>) -> Result<FileContents, Mistake> {
        let expected = "the file must contain { \"connections\": [ ... ] }";
        let start = Range::new(0, 0);
        let whole = whole.ok_or_else(|| self.mistake(start, expected))?;
        let Value::Object(whole) = whole else {
            return Err(self.mistake(whole.range(), expected));
        };
        const KEYS: [&str; 4] = ["$schema", "auto_connect", "auto_links", "connections"];
        let fields = self.fields(&whole, &KEYS)?;
        let Some(list) = fields.get("connections") else {
            return Err(self.mistake(whole.range, expected));
        };
        let auto_connect = fields.get("auto_connect").map(|field| {
            let rule = match &field.value {
                Value::StringLit(text) => AutoConnect::parse(&text.value),
                _ => None,
            };
            let problem = "auto_connect must be \"none\", \"listed\" or \"fleet\"";
            rule.ok_or_else(|| self.mistake(field.value.range(), problem))
        });
        let auto_links = fields.get("auto_links").map(|field| {
            let number = number(&field.value);
            let number = number.filter(|number| (1..=MAX_AUTO_LINKS).contains(number));
            let problem = format!("auto_links must be 1 to {MAX_AUTO_LINKS}");
            number.ok_or_else(|| self.mistake(field.value.range(), problem))
        });
        Ok(FileContents {
            auto_connect: auto_connect.transpose()?,
            auto_links: auto_links.transpose()?,
            connections: self.connections(list)?,
        })
    }

    fn connections(&self, list: &ObjectProp<'a>) -> Result<Vec<Spec>, Mistake> {
        let Value::Array(list) = &list.value else {
            return Err(self.mistake(list.value.range(), "connections must be a list"));
        };
        let (mut names, mut targets, mut specs) = (HashMap::new(), HashMap::new(), Vec::new());
        for value in &list.elements {
            if specs.len() == self.limits.max_connections {
                let problem = format!(
                    "too many connections: at most {} are allowed (plugins/rect/max_connections)",
                    self.limits.max_connections
                );
                return Err(self.mistake(value.range(), problem));
            }
            let (spec, range) = self.connection(value)?;
            let line = |range: &Range| self.place(range.start).0;
            if let Some(first) = names.insert(spec.name.clone(), range) {
                let problem = format!(
                    "the name {} is already used in line {}",
                    spec.name,
                    line(&first)
                );
                return Err(self.mistake(range, problem));
            }
            if let Some(first) = targets.insert(spec.target(), range) {
                let problem = format!(
                    "{} leads to the same peer as the connection in line {}",
                    spec.name,
                    line(&first)
                );
                return Err(self.mistake(range, problem));
            }
            if spec.is_to(&self.limits.robot) {
                let problem = format!("{} leads to this robot itself", spec.name);
                return Err(self.mistake(range, problem));
            }
            specs.push(spec);
        }
        Ok(specs)
    }

    fn connection(&self, value: &Value<'a>) -> Result<(Spec, Range), Mistake> {
        const KEYS: [&str; 6] = ["name", "method", "address", "port", "psm", "options"];
        let Value::Object(object) = value else {
            let problem =
                "a connection must be { \"name\": ..., \"method\": ..., \"address\": ... }";
            return Err(self.mistake(value.range(), problem));
        };
        let fields = self.fields(object, &KEYS)?;
        let text = |key: &str| match fields.get(key).map(|field| &field.value) {
            Some(Value::StringLit(text)) => Ok(text.value.to_string()),
            Some(other) => Err(self.mistake(other.range(), format!("{key} must be a string"))),
            None => Err(self.mistake(object.range, format!("{key} is missing"))),
        };
        let number_of = |key: &str| match fields.get(key).map(|field| &field.value) {
            None => Ok(None),
            Some(value) => {
                let problem = format!("{key} must be a whole number, 0 to {}", u16::MAX);
                let mistake = || self.mistake(value.range(), problem);
                number(value).ok_or_else(mistake).map(Some)
            }
        };
        let mut raw = RawSpec {
            name: text("name")?,
            method: text("method")?,
            address: text("address")?,
            port: number_of("port")?,
            psm: number_of("psm")?,
            ..RawSpec::default()
        };
        if let Some(options) = fields.get("options") {
            let Value::Object(options) = &options.value else {
                return Err(
                    self.mistake(options.value.range(), "options must be { \"key\": value }")
                );
            };
            for (key, field) in self.fields(options, &[])? {
                let value = match &field.value {
                    Value::StringLit(text) => text.value.to_string(),
                    Value::NumberLit(number) => number.value.to_owned(),
                    Value::BooleanLit(boolean) => boolean.value.to_string(),
                    other => {
                        let problem = "an option must be a string, a number, true or false";
                        return Err(self.mistake(other.range(), problem));
                    }
                };
                option_files::check_path(key, &value, &self.limits.option_folders)
                    .map_err(|problem| self.mistake(field.value.range(), problem))?;
                raw.options.insert(key.to_owned(), value);
            }
        }
        let spec = Spec::of(raw).map_err(|SpecError { field, problem }| {
            let field = field.and_then(|field| fields.get(field));
            let range = field.map_or(object.range, |field| field.value.range());
            self.mistake(range, problem)
        })?;
        Ok((spec, object.range))
    }

    /// Returns the fields of an object by key. A key outside `known` is a mistake, unless `known` is empty; so is a duplicate
    /// key.
    fn fields<'o>(
        &self,
        object: &'o Object<'a>,
        known: &[&str],
    ) -> Result<HashMap<&'o str, &'o ObjectProp<'a>>, Mistake> {
        let mut fields = HashMap::new();
        for field in &object.properties {
            let key = field.name.as_str();
            if !known.is_empty() && !known.contains(&key) {
                let problem = format!("`{key}` is unknown here; known are {}", known.join(", "));
                return Err(self.mistake(field.range, problem));
            }
            if fields.insert(key, field).is_some() {
                return Err(self.mistake(field.range, format!("{key} is given twice")));
            }
        }
        Ok(fields)
    }

    fn mistake(&self, range: Range, problem: impl Into<String>) -> Mistake {
        at(self.text, range.start, problem.into())
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

fn at(text: &str, byte: usize, problem: String) -> Mistake {
    let (line, column) = place(text, byte);
    Mistake {
        line,
        column,
        problem,
    }
}

/// Returns the line and the column of a byte, both from 1.
fn place(text: &str, byte: usize) -> (usize, usize) {
    let before = text.get(..byte).unwrap_or(text);
    let line_start = before.rfind('\n').map_or(0, |end| end + 1);
    let line = before.matches('\n').count() + 1;
    (line, before[line_start..].chars().count() + 1)
}

#[cfg(test)]
mod tests;

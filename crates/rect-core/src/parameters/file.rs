//! Reads and writes the file of a group: JSON with the values that are not the defaults, which people may edit while the program does
//! not run.
use std::{
    fmt, fs, io,
    path::{Path, PathBuf},
};

use serde::{
    de::{MapAccess, Visitor},
    Deserializer,
};
use serde_json::{Map, Value as Json};

use super::{Declaration, Value, Values, MAX_BYTES};
use crate::storage::{state_folder, ReplacedFile};

/// The maximum size of a file, in bytes.
const MAX_FILE: u64 = 4 * MAX_BYTES as u64;

/// The file of a group.
#[derive(Clone, Debug)]
pub struct ParametersFile {
    file: ReplacedFile,
    /// The contents as they were read or written last.
    last: Map<String, Json>,
    /// The values of the program at that time.
    written: Vec<Value>,
}

/// Returns the path of the file of a group of a robot: `<folder>/<robot>/<group>.json`. The folder is the one of the environment variable
/// `RECT_PARAMETERS`, or `rect/parameters` in that of the user's state (`XDG_STATE_HOME`, `~/.local/state`). `None` if none of these
/// variables is set. `variable` returns an environment variable.
pub fn path(
    robot: &str,
    group: &str,
    variable: impl Fn(&str) -> Option<std::ffi::OsString>,
) -> Option<PathBuf> {
    let folder = variable("RECT_PARAMETERS").filter(|value| !value.is_empty());
    let folder = folder.map(PathBuf::from);
    let state = || state_folder("parameters", variable);
    Some(
        folder
            .or_else(state)?
            .join(robot)
            .join(format!("{group}.json")),
    )
}

impl ParametersFile {
    /// Names the file.
    pub fn new(path: &Path) -> Self {
        Self {
            file: ReplacedFile::new(path),
            last: Map::new(),
            written: Vec::new(),
        }
    }

    /// Returns the path.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Reads the values that fit the declaration. Returns them, and what the program's user should know.
    pub fn load(&mut self, declaration: &Declaration) -> (Values, Vec<String>) {
        let path = self.path().display().to_string();
        let (mut values, mut warnings) = (Values::defaults(declaration), Vec::new());
        match self.read() {
            Ok((contents, twice)) => {
                for name in twice {
                    let warning = format!("{path}: {name} occurs twice, and the last value is used");
                    warnings.push(warning);
                }
                self.last = contents;
            }
            Err(error) => warnings.push(format!(
                "{path}: {error}. The parameters have their defaults; the next change keeps this file as {}",
                damaged(self.path()).display()
            )),
        }
        let mut unknown = Vec::new();
        for (name, json) in &self.last {
            let Ok(parameter) = declaration.find(name) else {
                unknown.push(name.as_str());
                continue;
            };
            let value = serde_json::from_value::<Value>(json.clone());
            let accepted = value
                .map_err(|error| format!("{name}: {error}"))
                .and_then(|value| parameter.accept(&value));
            match accepted {
                Ok(value) => values.replace(declaration, name, value),
                Err(reason) => warnings.push(format!(
                    "{path}: {reason}. It has its default, {}",
                    parameter.default
                )),
            }
        }
        if !unknown.is_empty() {
            let unknown = unknown.join(", ");
            let warning =
                format!("{path}: the program has no parameters {unknown}; the file keeps them");
            warnings.push(warning);
        }
        self.written = values.iter().cloned().collect();
        (values, warnings)
    }

    /// Writes the values that are not the defaults. Keeps what the file has in addition, and what somebody has edited there meanwhile
    /// unless the program has changed the same parameter. Returns a warning, if there is one.
    ///
    /// # Errors
    /// Returns why the file cannot be written.
    pub fn save(
        &mut self,
        declaration: &Declaration,
        values: &Values,
    ) -> Result<Option<String>, String> {
        let path = self.path().display().to_string();
        let failed = |error: io::Error| format!("{path}: cannot write the parameters: {error}");
        let (mut contents, moved) = match self.read() {
            Ok((contents, _)) => (contents, None),
            Err(_) => {
                let damaged = damaged(self.path());
                fs::rename(self.path(), &damaged).map_err(failed)?;
                self.written.clear();
                (Map::new(), Some(damaged))
            }
        };
        let before = contents.clone();
        let mut edited = Vec::new();
        for (at, (parameter, value)) in values.of(declaration).enumerate() {
            let name = &parameter.name;
            let written = self.written.get(at).unwrap_or(&parameter.default);
            if value == written {
                if contents.get(name) != self.last.get(name) {
                    edited.push(name.as_str());
                }
            } else if *value == parameter.default {
                contents.remove(name);
            } else {
                contents.insert(name.clone(), Json::from(value));
            }
        }
        if contents != before {
            let folder = self.path().parent().unwrap_or(Path::new("."));
            fs::create_dir_all(folder).map_err(failed)?;
            let text = serde_json::to_string_pretty(&contents).unwrap_or_default() + "\n";
            self.file.replace(text).map_err(failed)?;
        }
        let warning = match moved {
            Some(damaged) => Some(format!(
                "{path} was damaged: it is {} now",
                damaged.display()
            )),
            None if edited.is_empty() => None,
            None => Some(format!(
                "{path} was edited while the program runs: {} there is used from its next start on",
                edited.join(", ")
            )),
        };
        self.last = contents;
        self.written = values.iter().cloned().collect();
        Ok(warning)
    }

    /// Returns the contents of the file, empty if there is none, and the names that occur twice.
    fn read(&self) -> io::Result<(Map<String, Json>, Vec<String>)> {
        let text = self.file.read(MAX_FILE)?;
        if text.trim().is_empty() {
            return Ok(<_>::default());
        }
        let mut deserializer = serde_json::Deserializer::from_str(&text);
        let contents = deserializer.deserialize_map(Contents)?;
        deserializer.end()?;
        Ok(contents)
    }
}

/// Returns the path to which a damaged file is moved.
fn damaged(path: &Path) -> PathBuf {
    path.with_extension("damaged.json")
}

/// Reads an object, and which of its names occur twice.
struct Contents;

impl<'de> Visitor<'de> for Contents {
    type Value = (Map<String, Json>, Vec<String>);

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object with the values of the parameters")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut contents, mut twice) = (Map::new(), Vec::new());
        while let Some((name, value)) = map.next_entry::<String, Json>()? {
            if contents.insert(name.clone(), value).is_some() {
                twice.push(name);
            }
        }
        Ok((contents, twice))
    }
}

impl From<&Value> for Json {
    fn from(value: &Value) -> Self {
        serde_json::to_value(value).unwrap_or_default()
    }
}

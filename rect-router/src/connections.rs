//! Keeps the named connections of a router, and applies the changes of the connections file to them.
mod connection;
mod edit;
mod fleet;
mod observed;
mod revision;
mod watcher;

use std::{
    collections::BTreeMap,
    fmt, io,
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
    thread,
    time::Duration,
};

use parking_lot::Mutex;
use rect_connections::{
    file::{self, FileContents, FileError, Limits, MAX_BYTES},
    option_files,
    spec::Spec,
    AutoConnect, AutoConnectRule,
};
use rect_core::storage::ReplacedFile;
use serde::Serialize;
use zenoh_link_placeholder::Placeholders;

pub use self::{
    connection::{link, LastError, LinkEnds, Snapshot},
    edit::{Edit, EditError},
    fleet::FleetConnector,
    watcher::FileWatch,
};
use self::{
    connection::{ConnectionDialler, NamedConnection},
    revision::revision,
};
use crate::config::Settings;

/// Time between the reply to a change and the end of the links that the change closes: the reply may travel over one of
/// them.
///
/// Zenoh does not report when a reply has been sent. It passes the reply to the link within milliseconds, and a link still
/// delivers its queue when it is closed (over Bluetooth for its `linger` time), so that half a second is enough even for a
/// busy router. If the queue before the reply takes longer, the reply is lost and the requester has to read the file again.
const REPLY_GRACE: Duration = Duration::from_millis(500);

/// The named connections of one Zenoh runtime.
pub struct Connections {
    /// Path of the connections file.
    path: PathBuf,
    limits: Limits,
    /// The connections file; locked while it is read or replaced, so that changes are applied one after the other.
    store: Mutex<ReplacedFile>,
    placeholders: Arc<Placeholders>,
    by_name: Mutex<BTreeMap<String, Entry>>,
    fleet: Arc<FleetConnector>,
    /// The rule of the settings, for files without one.
    rule: AutoConnectRule,
    on_change: OnceLock<Box<dyn Fn() + Send + Sync>>,
}

/// A named connection and the number of its placeholder.
struct Entry {
    placeholder: usize,
    connection: Arc<NamedConnection>,
}

/// The differences between two sets of connections. Connections that are not named here keep their links.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Changes {
    /// Names of new connections.
    pub added: Vec<String>,
    /// Names of removed connections.
    pub removed: Vec<String>,
    /// Names of connections with another method, address or options.
    pub changed: Vec<String>,
    /// Whether the rule for automatic connections has changed.
    pub rule_changed: bool,
}

impl Connections {
    /// Creates an empty set of connections for the file at `path`. A rule in that file overrides the rule of `settings` and is
    /// passed to `fleet`.
    pub fn new(path: &Path, settings: &Settings, fleet: Arc<FleetConnector>) -> Arc<Self> {
        Arc::new(Self {
            path: path.to_owned(),
            limits: Limits {
                robot: settings.robot.clone(),
                max_connections: settings.max_connections,
                option_folders: option_files::folders(path, &settings.option_folders),
            },
            store: Mutex::new(ReplacedFile::new(path)),
            placeholders: Placeholders::new(settings.max_connections),
            by_name: Mutex::default(),
            fleet,
            rule: settings.rule(),
            on_change: OnceLock::new(),
        })
    }

    /// Returns the placeholder endpoints that Zenoh has to dial.
    pub fn endpoints(&self) -> impl Iterator<Item = String> + '_ {
        self.placeholders.endpoints()
    }

    /// Returns the path of the connections file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Reads the file and applies its connections.
    ///
    /// # Errors
    /// The first problem of the file; the connections are unchanged then.
    pub fn load(&self) -> Result<Changes, FileError> {
        let _others_wait = self.store.lock();
        let contents = file::read(&self.path, &self.limits)?;
        Ok(self.apply(contents))
    }

    /// Removes temporary files of a router that was killed while it changed the connections file.
    pub fn remove_leftovers(&self) {
        match self.store.lock().remove_leftovers() {
            Ok(0) => {}
            Ok(removed) => tracing::info!(
                "{}: removed {removed} temporary files of an interrupted change",
                self.path.display()
            ),
            Err(error) => tracing::debug!("{}: {error}", self.path.display()),
        }
    }

    /// Checks the file without applying it.
    ///
    /// # Errors
    /// The first problem of the file.
    pub fn check(&self) -> Result<(), FileError> {
        file::read(&self.path, &self.limits).map(drop)
    }

    /// Returns the text of the file and its revision; an empty text if there is no file.
    ///
    /// # Errors
    /// Fails if the file cannot be read.
    pub fn text(&self) -> io::Result<(String, String)> {
        let text = self.store.lock().read(MAX_BYTES)?;
        let revision = revision(&text);
        Ok((text, revision))
    }

    /// Applies `edit` to the file, and then the connections of the new file.
    ///
    /// Calls `answer` with the changes and the new revision once the file is written and before links are closed, because
    /// the requester may be connected over one of them. If links are to be closed, blocks for [`REPLY_GRACE`] in between.
    ///
    /// # Errors
    /// Fails if `expected` is given and is not the revision of the file, if the edit or its result is invalid, or if the file
    /// cannot be written. The connections are unchanged then, and so is the file, with the exception that
    /// [`ReplacedFile::replace`] describes.
    pub fn edit(
        &self,
        edit: &Edit,
        expected: Option<&str>,
        answer: impl FnOnce(&Changes, &str),
    ) -> Result<(), EditError> {
        let store = self.store.lock();
        if let Some(expected) = expected {
            let now = revision(&store.read(MAX_BYTES)?);
            if now != expected {
                return Err(EditError::Outdated { now });
            }
        }
        let text = edit.applied(|| store.read(MAX_BYTES), &self.limits)?;
        let contents = file::parse(&text, &self.limits)?;
        store.replace(text.as_bytes())?;
        let changes = self.difference(&self.rule_of(&contents), &contents.connections);
        answer(&changes, &revision(&text));
        if changes.closes_links() {
            thread::sleep(REPLY_GRACE);
        }
        self.apply(contents);
        Ok(())
    }

    /// Registers a function that is called after each change. Only the first registration has an effect.
    pub fn on_change(&self, on_change: impl Fn() + Send + Sync + 'static) {
        let _ = self.on_change.set(Box::new(on_change));
    }

    /// Applies the file again whenever it changes, until the returned watch is dropped.
    ///
    /// # Errors
    /// Fails if the system cannot watch the folder of the file.
    pub fn watch(self: &Arc<Self>) -> notify::Result<FileWatch> {
        FileWatch::start(Arc::clone(self))
    }

    /// Stops dialling; links that are open stay open.
    pub fn close(&self) {
        self.placeholders.close();
    }

    /// Returns the state of each connection, sorted by name.
    pub fn snapshots(&self) -> Vec<Snapshot> {
        let connections: Vec<_> = {
            let by_name = self.by_name.lock();
            by_name
                .values()
                .map(|entry| Arc::clone(&entry.connection))
                .collect()
        };
        connections
            .iter()
            .map(|connection| connection.snapshot())
            .collect()
    }

    /// Replaces the connections and the rule, and returns the differences.
    fn apply(&self, contents: FileContents) -> Changes {
        let rule = self.rule_of(&contents);
        let changes = self.difference(&rule, &contents.connections);
        self.end(&changes.removed);
        for spec in contents.connections {
            if changes.added.contains(&spec.name) || changes.changed.contains(&spec.name) {
                self.begin(spec);
            }
        }
        self.fleet.apply_rule(rule);
        if changes != Changes::default() {
            self.on_change.get().inspect(|on_change| on_change());
        }
        changes
    }

    /// Returns the rule of the file, with missing parts from the settings.
    fn rule_of(&self, contents: &FileContents) -> AutoConnectRule {
        AutoConnectRule {
            auto_connect: contents.auto_connect.unwrap_or(self.rule.auto_connect),
            auto_links: contents.auto_links.unwrap_or(self.rule.auto_links),
        }
    }

    /// Returns the differences to the current connections and rule.
    fn difference(&self, rule: &AutoConnectRule, listed: &[Spec]) -> Changes {
        let specs = match rule.auto_connect {
            AutoConnect::None => &[],
            AutoConnect::Listed | AutoConnect::Fleet => listed,
        };
        let mut changes = Changes {
            rule_changed: self.fleet.rule() != *rule,
            ..Changes::default()
        };
        let by_name = self.by_name.lock();
        let is_gone = |name: &&String| specs.iter().all(|spec| spec.name != **name);
        changes.removed = by_name.keys().filter(is_gone).cloned().collect();
        for spec in specs {
            match by_name.get(&spec.name) {
                Some(entry) if entry.connection.spec() == spec => {}
                Some(_) => changes.changed.push(spec.name.clone()),
                None => changes.added.push(spec.name.clone()),
            }
        }
        changes
    }

    /// Empties the placeholders of connections and closes their links.
    fn end(&self, names: &[String]) {
        let mut by_name = self.by_name.lock();
        for entry in names.iter().filter_map(|name| by_name.remove(name)) {
            self.placeholders.set(entry.placeholder, None);
            entry.connection.end();
        }
    }

    /// Starts dialling a connection, through the placeholder of the connection that had its name, or through a free one. (The
    /// limit of the file guarantees that there is one.)
    fn begin(&self, spec: Spec) {
        let mut by_name = self.by_name.lock();
        let is_free = |placeholder: &usize| {
            by_name
                .values()
                .all(|entry| entry.placeholder != *placeholder)
        };
        let placeholder = match by_name.get(&spec.name) {
            Some(before) => Some(before.placeholder),
            None => (0..self.placeholders.count()).find(is_free),
        };
        let Some(placeholder) = placeholder else {
            return;
        };
        let name = spec.name.clone();
        let connection = NamedConnection::new(spec);
        let dialled = ConnectionDialler(Arc::clone(&connection));
        self.placeholders.set(placeholder, Some(Arc::new(dialled)));
        if let Some(before) = by_name.insert(
            name,
            Entry {
                placeholder,
                connection,
            },
        ) {
            before.connection.end();
        }
    }
}

impl Changes {
    /// Returns whether the changes close links.
    fn closes_links(&self) -> bool {
        !self.removed.is_empty() || !self.changed.is_empty()
    }
}

impl fmt::Display for Changes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            ("added", &self.added),
            ("removed", &self.removed),
            ("changed", &self.changed),
        ];
        let mut texts: Vec<_> = parts
            .iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(verb, names)| format!("{verb} {}", names.join(", ")))
            .collect();
        if self.rule_changed {
            texts.push("another auto_connect or auto_links".to_owned());
        }
        match texts.is_empty() {
            true => f.write_str("no changes"),
            false => f.write_str(&texts.join("; ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use rect_connections::spec::RawSpec;
    use serde_json::json;

    use super::*;

    fn spec(name: &str, address: &str) -> Spec {
        let written = RawSpec {
            name: name.into(),
            method: "ble".into(),
            address: address.into(),
            ..RawSpec::default()
        };
        Spec::of(written).expect("valid")
    }

    #[test]
    fn reports_and_applies_only_the_differences() {
        let settings = json!({ "robot": "me", "max_connections": 3, "auto_links": 2 });
        let settings = Settings::parse(settings).expect("valid");
        let fleet = FleetConnector::new("lions", 7).expect("a name");
        let connections = Connections::new(Path::new("/nowhere"), &settings, Arc::clone(&fleet));
        let apply = |specs: &[Spec]| {
            connections.apply(FileContents {
                connections: specs.to_vec(),
                ..FileContents::default()
            })
        };
        let names = || -> Vec<_> {
            let snapshots = connections.snapshots();
            snapshots
                .iter()
                .map(|s| format!("{}>{}", s.spec.name, s.spec.endpoint))
                .collect()
        };
        let rule = "another auto_connect or auto_links";
        let changes = apply(&[spec("b", "two"), spec("a", "one")]);
        assert_eq!(changes.to_string(), format!("added b, a; {rule}"));
        let changes = apply(&[spec("a", "one"), spec("b", "two")]);
        assert_eq!(changes.to_string(), "no changes");
        let changes = apply(&[spec("b", "three"), spec("c", "four"), spec("d", "five")]);
        assert_eq!(changes.to_string(), "added c, d; removed a; changed b");
        assert_eq!(names(), ["b>ble/three", "c>ble/four", "d>ble/five"]);
        assert_eq!(apply(&[]).to_string(), "removed b, c, d");
        assert!(names().is_empty());

        // The rule of a file overrides the rule of the settings.
        let with_rule = |auto_connect| FileContents {
            connections: vec![spec("a", "one")],
            auto_connect: Some(auto_connect),
            auto_links: None,
        };
        let changes = connections.apply(with_rule(AutoConnect::Fleet));
        assert_eq!(changes.to_string(), format!("added a; {rule}"));
        assert_eq!(fleet.rule().dials(), 2);
        let changes = connections.apply(with_rule(AutoConnect::None));
        assert_eq!(changes.to_string(), format!("removed a; {rule}"));
        assert_eq!(fleet.rule().dials(), 0);
    }
}

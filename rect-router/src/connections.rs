//! Owns the named connections of a router: which are wanted, and what changes when others are.
mod connection;
mod edit;
pub mod file;
mod fleet;
mod observed;
pub mod spec;
mod store;
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
use serde::Serialize;
use zenoh_link_slot::Slots;

pub use self::{
    connection::{link, Ends, Snapshot, Trouble},
    edit::{Edit, EditError},
    file::FileError,
    fleet::Fleet,
    watcher::Watching,
};
use self::{
    connection::{Connection, Dialled},
    file::{Limits, Wanted},
    spec::Spec,
    store::{revision, Store},
};
use crate::config::{AutoConnect, Rule, Settings};

/// How long links that a change ends stay after who asked for it was answered. Zenoh does not tell when an answer has left.
/// It hands it to the link within milliseconds, and what a link was given it still delivers when it is closed (over
/// Bluetooth for its `linger`); half a second is enough for a router that is busy, too. Where more waits before the answer
/// than goes in that time, it is lost, and who asked can only read again.
const GRACE: Duration = Duration::from_millis(500);

/// The named connections of one Zenoh runtime.
pub struct Connections {
    /// The file they are from.
    path: PathBuf,
    limits: Limits,
    /// Held while it is read or replaced, so that one change follows the other.
    store: Mutex<Store>,
    slots: Arc<Slots>,
    by_name: Mutex<BTreeMap<String, Entry>>,
    fleet: Arc<Fleet>,
    /// Where the file has none.
    rule: Rule,
    on_change: OnceLock<Box<dyn Fn() + Send + Sync>>,
}

struct Entry {
    slot: usize,
    connection: Arc<Connection>,
}

/// What became different; all others keep their links.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Changes {
    /// New names.
    pub added: Vec<String>,
    /// Names that are gone.
    pub removed: Vec<String>,
    /// Names that lead elsewhere, or otherwise.
    pub changed: Vec<String>,
    /// Whether another rule says whom to connect to by itself.
    pub rule_changed: bool,
}

impl Connections {
    /// None yet; they are to come from the file `path`, and with them perhaps what `fleet` does instead of what the settings
    /// say.
    pub fn new(path: &Path, settings: &Settings, fleet: Arc<Fleet>) -> Arc<Self> {
        Arc::new(Self {
            path: path.to_owned(),
            limits: Limits {
                robot: settings.robot.clone(),
                most: settings.max_connections,
            },
            store: Mutex::new(Store::new(path)),
            slots: Slots::new(settings.max_connections),
            by_name: Mutex::default(),
            fleet,
            rule: settings.rule(),
            on_change: OnceLock::new(),
        })
    }

    /// What Zenoh has to dial for them.
    pub fn endpoints(&self) -> impl Iterator<Item = String> + '_ {
        self.slots.endpoints()
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Takes the connections of the file; on an error nothing changes.
    pub fn load(&self) -> Result<Changes, FileError> {
        let _others_wait = self.store.lock();
        let wanted = file::read(&self.path, &self.limits)?;
        Ok(self.apply(wanted))
    }

    /// Removes what a router left beside the file that was killed while it changed it.
    pub fn remove_leftovers(&self) {
        match self.store.lock().remove_leftovers() {
            Ok(0) => {}
            Ok(removed) => tracing::info!(
                "{}: removed what an interrupted change had left ({removed} files)",
                self.path.display()
            ),
            Err(error) => tracing::debug!("{}: {error}", self.path.display()),
        }
    }

    /// Reads the file; nothing changes.
    pub fn check(&self) -> Result<(), FileError> {
        file::read(&self.path, &self.limits).map(drop)
    }

    /// The file's text and its revision.
    pub fn text(&self) -> io::Result<(String, String)> {
        let text = self.store.lock().read()?;
        let revision = revision(&text);
        Ok((text, revision))
    }

    /// Puts what `edit` makes of it into the file and takes its connections, if `expected` is the revision of what is there.
    /// `answer` is told what changes and the new revision, once it is in the file and before links end: whoever asks may come
    /// over one of them. On an error nothing changes. Waits while links that are to end have their [`GRACE`].
    pub fn edit(
        &self,
        edit: &Edit,
        expected: Option<&str>,
        answer: impl FnOnce(&Changes, &str),
    ) -> Result<(), EditError> {
        let store = self.store.lock();
        if let Some(expected) = expected {
            let now = revision(&store.read()?);
            if now != expected {
                return Err(EditError::Outdated { now });
            }
        }
        let text = edit.applied(|| store.read(), &self.limits)?;
        let wanted = file::parse(&text, &self.limits)?;
        store.replace(&text)?;
        let changes = self.difference(&self.rule_of(&wanted), &wanted.connections);
        answer(&changes, &revision(&text));
        if changes.end_links() {
            thread::sleep(GRACE);
        }
        self.apply(wanted);
        Ok(())
    }

    /// Calls `on_change` whenever a file brought something new. One is told, the first that asks.
    pub fn on_change(&self, on_change: impl Fn() + Send + Sync + 'static) {
        let _ = self.on_change.set(Box::new(on_change));
    }

    /// Takes a file's connections again whenever it changes, until the watching is dropped.
    pub fn watch(self: &Arc<Self>) -> notify::Result<Watching> {
        Watching::start(Arc::clone(self))
    }

    /// Dials nobody any more; links that are there stay.
    pub fn close(&self) {
        self.slots.close();
    }

    /// What is known of each, by name.
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

    /// From now on these.
    fn apply(&self, wanted: Wanted) -> Changes {
        let rule = self.rule_of(&wanted);
        let changes = self.difference(&rule, &wanted.connections);
        self.end(&changes.removed);
        for spec in wanted.connections {
            if changes.added.contains(&spec.name) || changes.changed.contains(&spec.name) {
                self.begin(spec);
            }
        }
        self.fleet.follow(rule);
        if changes != Changes::default() {
            self.on_change.get().inspect(|on_change| on_change());
        }
        changes
    }

    /// What the file says, or else the settings.
    fn rule_of(&self, wanted: &Wanted) -> Rule {
        Rule {
            auto_connect: wanted.auto_connect.unwrap_or(self.rule.auto_connect),
            auto_links: wanted.auto_links.unwrap_or(self.rule.auto_links),
        }
    }

    /// What becomes different when that rule and these connections hold.
    fn difference(&self, rule: &Rule, listed: &[Spec]) -> Changes {
        let wanted = match rule.auto_connect {
            AutoConnect::None => &[],
            AutoConnect::Listed | AutoConnect::Fleet => listed,
        };
        let mut changes = Changes {
            rule_changed: self.fleet.rule() != *rule,
            ..Changes::default()
        };
        let by_name = self.by_name.lock();
        let is_gone = |name: &&String| wanted.iter().all(|spec| spec.name != **name);
        changes.removed = by_name.keys().filter(is_gone).cloned().collect();
        for spec in wanted {
            match by_name.get(&spec.name) {
                Some(entry) if entry.connection.spec() == spec => {}
                Some(_) => changes.changed.push(spec.name.clone()),
                None => changes.added.push(spec.name.clone()),
            }
        }
        changes
    }

    fn end(&self, names: &[String]) {
        let mut by_name = self.by_name.lock();
        for entry in names.iter().filter_map(|name| by_name.remove(name)) {
            self.slots.set(entry.slot, None);
            entry.connection.end();
        }
    }

    /// In the slot of the one that had its name, or a free one. (The file's limit is that there are enough.)
    fn begin(&self, spec: Spec) {
        let mut by_name = self.by_name.lock();
        let is_free = |slot: &usize| by_name.values().all(|entry| entry.slot != *slot);
        let slot = match by_name.get(&spec.name) {
            Some(before) => Some(before.slot),
            None => (0..self.slots.count()).find(is_free),
        };
        let Some(slot) = slot else { return };
        let name = spec.name.clone();
        let connection = Connection::new(spec);
        let dialled = Dialled(Arc::clone(&connection));
        self.slots.set(slot, Some(Arc::new(dialled)));
        if let Some(before) = by_name.insert(name, Entry { slot, connection }) {
            before.connection.end();
        }
    }
}

impl Changes {
    /// Whether somebody may lose the link that he comes over.
    fn end_links(&self) -> bool {
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
        let mut told: Vec<_> = parts
            .iter()
            .filter(|(_, names)| !names.is_empty())
            .map(|(what, names)| format!("{what} {}", names.join(", ")))
            .collect();
        if self.rule_changed {
            told.push("another auto_connect or auto_links".to_owned());
        }
        match told.is_empty() {
            true => f.write_str("as before"),
            false => f.write_str(&told.join("; ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::{spec::Written, *};

    fn spec(name: &str, address: &str) -> Spec {
        let written = Written {
            name: name.into(),
            method: "ble".into(),
            address: address.into(),
            ..Written::default()
        };
        Spec::of(written).expect("valid")
    }

    #[test]
    fn only_what_differs_changes() {
        let settings = json!({ "robot": "me", "max_connections": 3, "auto_links": 2 });
        let settings = Settings::parse(settings).expect("valid");
        let fleet = Fleet::new("lions", 7).expect("a name");
        let connections = Connections::new(Path::new("/nowhere"), &settings, Arc::clone(&fleet));
        let apply = |specs: &[Spec]| {
            connections.apply(Wanted {
                connections: specs.to_vec(),
                ..Wanted::default()
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
        assert_eq!(changes.to_string(), "as before");
        let changes = apply(&[spec("b", "three"), spec("c", "four"), spec("d", "five")]);
        assert_eq!(changes.to_string(), "added c, d; removed a; changed b");
        assert_eq!(names(), ["b>ble/three", "c>ble/four", "d>ble/five"]);
        assert_eq!(apply(&[]).to_string(), "removed b, c, d");
        assert!(names().is_empty());

        // And the rule of a file instead of the settings'.
        let with_rule = |auto_connect| Wanted {
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

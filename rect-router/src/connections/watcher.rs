//! Watches a connections file and applies its changes. A file with a mistake is logged and changes nothing.
use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::{
        mpsc::{self, Receiver, RecvTimeoutError},
        Arc,
    },
    thread,
    time::{Duration, Instant},
};

use notify::{Event, RecommendedWatcher, RecursiveMode, Watcher};
use rect_core::text::humanize;

use super::Connections;

/// Time without further changes after which the file is read: an editor writes it in several steps.
const QUIET_PERIOD: Duration = Duration::from_millis(100);
/// Time after the first change at which the file is read even if changes continue.
const MAX_DELAY: Duration = Duration::from_secs(1);

/// A watch over a connections file. Dropping it stops the watch.
pub struct FileWatch {
    /// Dropping the watcher closes the channel to the thread, which then ends.
    _watcher: RecommendedWatcher,
}

impl FileWatch {
    /// Starts a thread that watches the folder of the file, because editors and other careful programs replace a file by a
    /// new one.
    ///
    /// # Errors
    /// Fails if the system cannot watch the folder.
    pub(super) fn start(connections: Arc<Connections>) -> notify::Result<Self> {
        let path = std::path::absolute(connections.path())?;
        // The target of a symbolic link changes in a folder of its own.
        let mut paths = vec![path.clone()];
        paths.extend(path.canonicalize().ok().filter(|real| *real != path));
        let folders: BTreeSet<_> = paths
            .iter()
            .map(|path| path.parent().unwrap_or(Path::new("/")).to_owned())
            .collect();
        let (events, changed) = mpsc::channel();
        let mut watcher = notify::recommended_watcher(move |event: notify::Result<Event>| {
            let is_watched = |path: &PathBuf| paths.contains(path);
            let is_change = event
                .is_ok_and(|event| !event.kind.is_access() && event.paths.iter().any(is_watched));
            if is_change {
                let _ = events.send(());
            }
        })?;
        for folder in &folders {
            watcher.watch(folder, RecursiveMode::NonRecursive)?;
        }
        thread::Builder::new()
            .name("connections".to_owned())
            .spawn(move || follow(&connections, &changed))?;
        Ok(Self { _watcher: watcher })
    }
}

fn follow(connections: &Connections, changed: &Receiver<()>) {
    while changed.recv().is_ok() {
        let first = Instant::now();
        while first.elapsed() < MAX_DELAY {
            match changed.recv_timeout(QUIET_PERIOD) {
                Ok(()) => {}
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
        match connections.load() {
            Ok(changes) => tracing::info!("{}: {changes}", connections.path().display()),
            Err(error) => tracing::error!(
                "{}; the connections stay as they were until the file is corrected",
                humanize::with_causes(&error)
            ),
        }
    }
}

//! Owns the watch over a connections file: what changes in it takes effect, what is wrong in it is told and changes nothing.
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

use rect::core::wording;

use super::Connections;

/// An editor writes in several steps: the file is read when it has been left alone for so long,
const QUIET: Duration = Duration::from_millis(100);
/// or after so long all the same.
const LONGEST: Duration = Duration::from_secs(1);

/// Watches until it is dropped.
pub struct Watching {
    /// Its end is the end of the thread.
    _watcher: RecommendedWatcher,
}

impl Watching {
    /// Watches the folder: an editor, and whoever changes a file safely, puts a new file in its place.
    pub(super) fn start(connections: Arc<Connections>) -> notify::Result<Self> {
        let path = std::path::absolute(connections.path())?;
        // Where that is a symbolic link, the file that it leads to changes in its own folder.
        let mut paths = vec![path.clone()];
        paths.extend(path.canonicalize().ok().filter(|real| *real != path));
        let folders: BTreeSet<_> = paths
            .iter()
            .map(|path| path.parent().unwrap_or(Path::new("/")).to_owned())
            .collect();
        let (events, changed) = mpsc::channel();
        let mut watcher = notify::recommended_watcher(move |event: notify::Result<Event>| {
            let is_watched = |path: &PathBuf| paths.contains(path);
            let is_it = event
                .is_ok_and(|event| !event.kind.is_access() && event.paths.iter().any(is_watched));
            if is_it {
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
        while first.elapsed() < LONGEST {
            match changed.recv_timeout(QUIET) {
                Ok(()) => {}
                Err(RecvTimeoutError::Timeout) => break,
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
        match connections.load() {
            Ok(changes) => tracing::info!("{}: {changes}", connections.path().display()),
            Err(error) => tracing::error!(
                "{}; the connections stay as they were",
                wording::with_causes(&error)
            ),
        }
    }
}

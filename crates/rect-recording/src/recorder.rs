//! Writes messages to a recording on a thread of its own, because a disk may stand still for seconds.
mod lines;

use std::{
    io,
    path::PathBuf,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::{Duration, Instant, SystemTime},
};

use rect_core::{clock::unix::since_1970, message::Message, name::Name};

use crate::{
    backlog::Backlog,
    entry::Entry,
    file::About,
    parts::{PartPaths, Parts, Split},
    recorder_error::RecorderError,
    segments::{folder_of, Segments},
};

/// How many messages wait for the recorder at most.
pub const CAPACITY: usize = 4096;
/// How many bytes wait for the disk at most.
const BACKLOG_BYTES: usize = 8 * 1024 * 1024;
/// The pause after a failure of the disk.
const RETRY_AFTER: Duration = Duration::from_secs(1);
/// The interval at which the thread looks whether a chunk or a file is due.
const TICK: Duration = Duration::from_millis(250);
/// How long those who read a recording that runs wait for its newest messages.
const FLUSHED_WITHIN: Duration = Duration::from_secs(1);

/// The settings of a recorder.
#[derive(Clone, Debug)]
pub struct Settings {
    /// The file that the recording becomes when it stops.
    pub path: PathBuf,
    /// The description of the recording.
    pub about: About,
    /// How much of the past to keep; default: everything.
    pub keep: Option<Duration>,
    /// When the recording continues in another file, whose name has a number; default: never.
    pub split: Split,
}

/// How a recording goes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// How many messages are in the recording.
    pub written: u64,
    /// The bytes of their payloads.
    pub bytes: u64,
    /// How many messages were dropped, because the disk was too slow or full.
    pub dropped: u64,
    /// Why the disk does not take anything at the moment.
    pub problem: Option<String>,
}

/// Records messages. They are never waited for: what the disk cannot take is dropped and counted, urgent messages last.
pub struct Recorder {
    path: PathBuf,
    about: About,
    parts: PartPaths,
    shared: Arc<Shared>,
    /// `None` once it has stopped.
    thread: Mutex<Option<JoinHandle<Parts>>>,
    clock: Clock,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    /// Notified when a requested flush is done.
    flushed: Condvar,
}

struct State {
    backlog: Backlog,
    progress: Progress,
    is_stopped: bool,
    /// The number of flushes that were requested.
    requested_flushes: u64,
    /// The number of those that were done.
    done_flushes: u64,
}

/// The time since 1970, without the jumps of the computer's clock.
#[derive(Clone, Copy)]
struct Clock {
    started: Instant,
    since_1970: Duration,
}

impl Clock {
    fn now(&self) -> Duration {
        self.since_1970 + self.started.elapsed()
    }
}

impl Recorder {
    /// Starts a recording.
    ///
    /// # Errors
    /// Fails if there is a recording of that name, or the folder cannot be written.
    pub fn start(settings: Settings) -> Result<Self, RecorderError> {
        let Settings {
            path,
            about,
            keep,
            split,
        } = settings;
        let folder = folder_of(&path);
        if path.exists() {
            return Err(RecorderError::Exists(path));
        }
        let created = Segments::create(folder.clone(), about.clone(), keep);
        let segments = created.map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => RecorderError::Unfinished(folder.clone()),
            _ => RecorderError::Write {
                path: folder.clone(),
                source,
            },
        })?;
        let shared = Arc::new(Shared {
            state: Mutex::new(State {
                backlog: Backlog::new(BACKLOG_BYTES),
                progress: Progress::default(),
                is_stopped: false,
                requested_flushes: 0,
                done_flushes: 0,
            }),
            changed: Condvar::new(),
            flushed: Condvar::new(),
        });
        let clock = Clock {
            started: Instant::now(),
            since_1970: since_1970(SystemTime::now()),
        };
        let writing = shared.clone();
        let thread = std::thread::Builder::new().name("recorder".to_owned());
        let parts = Parts::new(path.clone(), about.clone(), split);
        let part_paths = parts.paths();
        let thread = thread.spawn(move || write(&writing, segments, parts, clock));
        let thread = thread.map_err(|source| RecorderError::Write {
            path: folder,
            source,
        })?;
        Ok(Self {
            path,
            about,
            parts: part_paths,
            shared,
            thread: Mutex::new(Some(thread)),
            clock,
        })
    }

    /// Returns the description of the recording.
    pub fn about(&self) -> &About {
        &self.about
    }

    /// Returns the time by which messages are recorded, since 1970.
    pub fn now(&self) -> Duration {
        self.clock.now()
    }

    /// Returns the files and folders of the recording in their order, after waiting until all messages can be read there, at
    /// most for a second.
    pub fn readable(&self) -> Vec<PathBuf> {
        let mut state = self.shared.state();
        state.requested_flushes += 1;
        let requested = state.requested_flushes;
        self.shared.changed.notify_one();
        let is_pending = |state: &mut State| state.done_flushes < requested;
        let waited = self
            .shared
            .flushed
            .wait_timeout_while(state, FLUSHED_WITHIN, is_pending);
        drop(waited);
        let parts = self.parts.lock().unwrap_or_else(PoisonError::into_inner);
        let mut paths: Vec<_> = parts
            .iter()
            // A part is a folder until it is a file.
            .map(|file| {
                if file.exists() {
                    file.clone()
                } else {
                    folder_of(file)
                }
            })
            .collect();
        paths.push(folder_of(&self.path));
        paths
    }

    /// Records a message, which arrived now. Never blocks for the disk.
    pub fn on_message(&self, message: Message) {
        self.add(Entry::of(message, self.clock.now()));
    }

    /// Records a report of `robot` about itself, such as the state of a link. It is a value in JSON.
    pub fn on_report(&self, robot: &Name, subject: &str, json: Vec<u8>) {
        self.add(Entry::of_report(robot, subject, json, self.clock.now()));
    }

    /// Records an entry.
    pub(crate) fn add(&self, entry: Entry) {
        self.shared.state().backlog.push(entry);
        self.shared.changed.notify_one();
    }

    /// Returns how the recording goes.
    pub fn progress(&self) -> Progress {
        let state = self.shared.state();
        let mut progress = state.progress.clone();
        progress.dropped += state.backlog.dropped();
        progress
    }

    /// Stops, and makes one file of the recording, or several if it is split; none if nothing was recorded. Its folder remains if
    /// there is no room for that.
    ///
    /// # Errors
    /// Fails if the disk does; then the folder remains, and can be read.
    pub fn finish(&self) -> Result<(Vec<PathBuf>, Progress), RecorderError> {
        let parts = self.stop();
        let files = parts.map_or(Ok(Vec::new()), Parts::finish)?;
        Ok((files, self.progress()))
    }

    /// Stops writing. Returns `None` if that was done before.
    fn stop(&self) -> Option<Parts> {
        self.shared.state().is_stopped = true;
        self.shared.changed.notify_one();
        let mut thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        let thread = thread.take()?;
        // It does not panic, and there is nothing to do if it did.
        thread.join().ok()
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for messages, at most for a tick. Returns them, whether the recorder was stopped, and the number of requested
    /// flushes.
    fn take(&self) -> (Vec<Entry>, bool, u64) {
        let state = self.state();
        let waited = self.changed.wait_timeout_while(state, TICK, |state| {
            state.backlog.is_empty()
                && !state.is_stopped
                && state.requested_flushes == state.done_flushes
        });
        let (mut state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let entries = std::iter::from_fn(|| state.backlog.pop()).collect();
        (entries, state.is_stopped, state.requested_flushes)
    }
}

/// Writes until the recorder is stopped. Returns what is to be made files of.
fn write(shared: &Shared, mut segments: Segments, mut parts: Parts, clock: Clock) -> Parts {
    let mut flushed = 0;
    loop {
        let (entries, is_stopped, requested_flushes) = shared.take();
        let mut entries = entries.into_iter();
        let (mut count, mut bytes) = (0, 0);
        let written = entries.by_ref().try_for_each(|entry| {
            if !entry.is_report() {
                count += 1;
                bytes += entry.payload.bytes.len() as u64;
            }
            let logged = entry.logged;
            segments.write(entry)?;
            // A long series does not make a file too long.
            segments.on_time(logged)?;
            parts.on_time(&mut segments)
        });
        let written = written.and_then(|()| {
            if is_stopped {
                return segments.finish(clock.now());
            }
            segments.on_time(clock.now())?;
            if flushed < requested_flushes {
                segments.flush()?;
            }
            parts.on_time(&mut segments)
        });
        let mut state = shared.state();
        if flushed < requested_flushes {
            flushed = requested_flushes;
            state.done_flushes = flushed;
            shared.flushed.notify_all();
        }
        state.progress.written += count;
        state.progress.bytes += bytes;
        let Err(error) = written else {
            state.progress.problem = None;
            if is_stopped {
                return parts;
            }
            continue;
        };
        state.progress.problem = Some(error.to_string());
        let returned = segments.abandon();
        for entry in returned.iter().filter(|entry| !entry.is_report()) {
            state.progress.written -= 1;
            state.progress.bytes -= entry.payload.bytes.len() as u64;
        }
        // Everything waits again, in its order, where the oldest ones are dropped if there are too many.
        let newer: Vec<_> = std::iter::from_fn(|| state.backlog.pop()).collect();
        for entry in returned.into_iter().chain(entries).chain(newer) {
            state.backlog.push(entry);
        }
        if is_stopped {
            let left = std::iter::from_fn(|| state.backlog.pop()).count();
            state.progress.dropped += left as u64;
            return parts;
        }
        let until_stopped = |state: &mut State| !state.is_stopped;
        drop((shared.changed).wait_timeout_while(state, RETRY_AFTER, until_stopped));
    }
}

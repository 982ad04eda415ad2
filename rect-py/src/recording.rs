//! Writes and reads recordings.
use std::{
    path::PathBuf,
    sync::{Arc, Mutex},
    time::{Duration, Instant, UNIX_EPOCH},
};

use bytes::Bytes;
use pyo3::{prelude::*, types::PyBytes};
use rect_core::{
    message::{encoding::Encoding, payload::Payload, Message},
    name::{key, topic::Pattern, Name},
    registry::connection::Connection,
};
use rect_recording::{
    self as recording,
    answer::{self, Answer},
    file::about,
    key_frames::KeyFrames,
    log_recorder::LogRecorder,
    report::EventReport,
    Entry, EntryPattern, ReadError, Reader, RecorderError, Selection, Settings, Split,
};

use crate::{
    clock::Clock,
    codec::{parts, Parts},
    driver::{lock, Driver},
    errors::{raised, OrRaise, Raised},
    key_space::{self, KeySpace},
    message::MessageMetadata,
};

/// Records messages to a file, on a thread of its own.
#[pyclass(frozen, module = "rect._rect")]
pub struct Recorder {
    /// `None` once it has been stopped. It is locked for a moment only, because it may be locked while Python's lock is held.
    recorder: Mutex<Option<Arc<recording::Recorder>>>,
    place: key::KeySpace,
    patterns: Vec<Pattern>,
    videos: Mutex<KeyFrames>,
}

/// The fields of an `Event` of Python.
type EventFields = (
    String,
    Option<String>,
    Option<String>,
    Option<String>,
    Option<String>,
    Option<String>,
    Option<String>,
);

/// The replies to a query for the recording, and an error that follows them.
type Answered<'py> = (
    Vec<(String, Parts<'py>, Option<(u64, u32)>)>,
    Option<Parts<'py>>,
);

/// The number of messages in a recording, and of those that were dropped.
type Counts = (u64, u64);

#[pymethods]
impl Recorder {
    /// Starts a recording by a program of the robot of `place`. `keep`: only about this much of the past is kept, in seconds. The recording
    /// continues in another file after `split_after` seconds, or when a file has `split_bytes`.
    #[new]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        place: &KeySpace,
        patterns: Vec<String>,
        keep: Option<f64>,
        split_after: Option<f64>,
        split_bytes: Option<u64>,
    ) -> PyResult<Self> {
        let duration = |name: &'static str, s: Option<f64>| {
            let duration = s.map(Duration::try_from_secs_f64).transpose();
            duration.map_err(|error| raised(py, "OptionError", (name, s, error.to_string())))
        };
        let patterns = key_space::patterns(&patterns)?;
        let settings = Settings {
            path,
            about: about(&place.0, &patterns),
            keep: duration("keep", keep)?,
            split: Split {
                after: duration("split_after", split_after)?,
                bytes: split_bytes,
            },
        };
        let recorder = py.detach(|| recording::Recorder::start(settings));
        Ok(Self {
            recorder: Mutex::new(Some(Arc::new(recorder.or_raise()?))),
            place: place.0.clone(),
            patterns,
            videos: Mutex::new(KeyFrames::new(place.0.clone())),
        })
    }

    /// Records a message, which has arrived now. Returns the key and the bytes of a request to the sender of a video, if one is to be
    /// sent.
    fn add(
        &self,
        metadata: &MessageMetadata,
        payload: &[u8],
        encoding: String,
    ) -> Option<(String, Vec<u8>)> {
        let message = Message {
            payload: Payload::new(Bytes::copy_from_slice(payload), Encoding::new(encoding)),
            ..metadata.message()
        };
        let request = lock(&self.videos).on_message(&message, Instant::now());
        if let Some(recorder) = self.recorder() {
            recorder.on_message(message);
        }
        request.map(|request| (request.key, request.bytes))
    }

    /// Returns the drivers that read the logs of the recorded robots, and record their lines.
    fn logs(&self) -> Vec<Driver> {
        let logs = self.recorder().map_or_else(Vec::new, |recorder| {
            LogRecorder::of_recording(&self.place, &self.patterns, &recorder)
        });
        let drivers = logs.into_iter().map(|log| Driver::new(log, &Clock::new()));
        drivers.collect()
    }

    /// Records an event that a program of `robot` has received.
    fn add_event(&self, robot: &str, event: EventFields) -> PyResult<()> {
        let robot = Name::new(robot).or_raise()?;
        let (kind, peer, method, address, path, reason, program) = &event;
        if let Some(recorder) = self.recorder() {
            let event = EventReport {
                kind,
                robot: peer.as_deref(),
                method: method.as_deref(),
                address: address.as_deref(),
                path: path.as_deref(),
                reason: reason.as_deref(),
                program: program.as_deref(),
            };
            recorder.on_event(&robot, event);
        }
        Ok(())
    }

    /// Records the state of the links of `robot`, given the connections of its router in JSON. Another router's report that is not
    /// one of connections is ignored.
    fn add_connections(&self, robot: &str, json: &[u8]) -> PyResult<()> {
        let robot = Name::new(robot).or_raise()?;
        let connections: Vec<Connection> = serde_json::from_slice(json).unwrap_or_default();
        if let Some(recorder) = self.recorder() {
            recorder.on_connections(&robot, &connections);
        }
        Ok(())
    }

    /// Returns the counts, and why the disk takes nothing at the moment. `None` after the end.
    fn progress(&self) -> Option<(Counts, Option<String>)> {
        let progress = self.recorder()?.progress();
        Some(((progress.written, progress.dropped), progress.problem))
    }

    /// Returns the key expression of the requests that it records.
    #[getter]
    fn services(&self) -> String {
        self.place.services()
    }

    /// Records a request to the service with this key.
    fn add_request(&self, key: &str, attachment: Option<&[u8]>, payload: &[u8], encoding: String) {
        if let Some(recorder) = self.recorder() {
            let payload = Payload::new(Bytes::copy_from_slice(payload), Encoding::new(encoding));
            recorder.on_request(&self.place, key, attachment, &payload);
        }
    }

    /// Returns the key expression of the queries that it answers.
    #[getter]
    fn queries(&self) -> String {
        format!("{}/**", answer::key(&self.place, &self.place.robot))
    }

    /// Returns the answer to a query: the keys, payloads and times of the replies (seconds and nanoseconds since 1970), and the
    /// payload of an error that follows them. `None` after the end. May take a second.
    fn answer<'py>(&self, py: Python<'py>, asked: &str, parameters: &str) -> Option<Answered<'py>> {
        let recorder = self.recorder()?;
        let answer = py.detach(|| Answer::to(asked, parameters, &recorder, &self.place));
        let replies = answer.replies.into_iter().map(|reply| {
            let recorded = reply
                .recorded
                .map(|time| (time.as_secs(), time.subsec_nanos()));
            (reply.key, parts(py, &reply.payload), recorded)
        });
        let error = answer.error.as_ref().map(|error| parts(py, error));
        Some((replies.collect(), error))
    }

    /// Returns the payload of the error for a query that finds too many others waiting.
    fn busy<'py>(&self, py: Python<'py>) -> Parts<'py> {
        parts(py, &answer::busy(&self.place))
    }

    /// Stops, and makes one file of the recording. Returns the counts. `None` if it had been stopped before.
    fn finish(&self, py: Python<'_>) -> PyResult<Option<Counts>> {
        let Some(recorder) = lock(&self.recorder).take() else {
            return Ok(None);
        };
        let (_, progress) = py.detach(|| recorder.finish()).or_raise()?;
        Ok(Some((progress.written, progress.dropped)))
    }
}

impl Recorder {
    fn recorder(&self) -> Option<Arc<recording::Recorder>> {
        lock(&self.recorder).clone()
    }
}

/// Reads a recording.
#[pyclass(frozen, module = "rect._rect")]
pub struct RecordingReader {
    reader: Mutex<Reader>,
    selection: Selection,
}

/// A message without its payload, the payload and its encoding, and the time of recording in seconds since 1970.
type Recorded<'py> = (MessageMetadata, Bound<'py, PyBytes>, String, f64);

#[pymethods]
impl RecordingReader {
    /// Opens a file, or the folder of a recording that runs or was interrupted. Without patterns, all messages are read.
    #[new]
    fn new(path: PathBuf, patterns: Vec<String>) -> PyResult<Self> {
        let patterns = patterns
            .iter()
            .map(|pattern| pattern.parse::<EntryPattern>());
        let patterns = patterns.collect::<Result<_, _>>().or_raise()?;
        let selection = Selection {
            patterns,
            ..Selection::default()
        };
        let reader = Mutex::new(Reader::open(&path).or_raise()?);
        Ok(Self { reader, selection })
    }

    /// Returns when the first message of a robot or the first report was recorded, in seconds since 1970; `None` if there is neither.
    fn started(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        let found = py.detach(|| {
            let mut reader = lock(&self.reader);
            reader.find(|entry| {
                let entry = entry.as_ref();
                entry.map_or(true, |entry| entry.is_report() || entry.address().is_some())
            })
        });
        let first = found.transpose().or_raise()?;
        Ok(first.map(|entry| entry.logged.as_secs_f64()))
    }

    /// Returns the next report of a robot about itself: its topic, its value in JSON, and the time of recording in seconds since 1970.
    /// `None` at the end. Messages are skipped.
    fn next_report(&self, py: Python<'_>) -> PyResult<Option<(String, String, f64)>> {
        let found = py.detach(|| {
            let mut reader = lock(&self.reader);
            reader.find(|entry| entry.as_ref().map_or(true, Entry::is_report))
        });
        Ok(found.transpose().or_raise()?.map(|entry| {
            let json = String::from_utf8_lossy(&entry.payload.bytes).into_owned();
            (entry.topic, json, entry.logged.as_secs_f64())
        }))
    }

    /// Returns the next message; `None` at the end. Messages of other programs, whose topics have no robot, are skipped.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<Recorded<'py>>> {
        let found = py.detach(|| {
            let mut reader = lock(&self.reader);
            reader.find_map(|entry| match entry {
                Ok(entry) if !self.selection.matches(&entry) => None,
                Ok(entry) => message(&entry).map(|message| Ok((message, entry))),
                Err(error) => Some(Err(error)),
            })
        });
        let Some((message, entry)) = found.transpose().or_raise()? else {
            return Ok(None);
        };
        let payload = PyBytes::new(py, &entry.payload.bytes);
        let encoding = entry.payload.encoding.as_str().to_owned();
        let recorded_s = entry.logged.as_secs_f64();
        Ok(Some((
            MessageMetadata::of(message),
            payload,
            encoding,
            recorded_s,
        )))
    }
}

/// Returns the recorded message without its payload; `None` if its topic has no robot.
fn message(entry: &Entry) -> Option<Message> {
    let (sender, topic) = entry.address()?;
    let recipient = entry.recipient.as_deref();
    Some(Message {
        recipient: recipient.and_then(|name| Name::new(name).ok()),
        urgency: entry.urgency,
        sent_at: UNIX_EPOCH.checked_add(entry.sent),
        sequence: Some(entry.sequence),
        publisher: entry.publisher,
        ..Message::new(sender, topic, Payload::new(Bytes::new(), Encoding::BYTES))
    })
}

impl Raised for RecorderError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "RecordingError", (self.to_string(),)))
    }
}

impl Raised for ReadError {
    fn raised(self) -> PyErr {
        Python::attach(|py| raised(py, "RecordingError", (self.to_string(),)))
    }
}

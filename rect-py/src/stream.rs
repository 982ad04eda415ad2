//! Wraps the core's sending and receiving ends of a stream, and supplies them with the time of the monotonic clock.
use std::{
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use pyo3::{prelude::*, pybacked::PyBackedBytes, types::PyBytes};
use rect::core::{
    attachment::Attachment,
    stream::{
        feedback::Feedback,
        feedback_from,
        ladder::Coding,
        notice::Notice,
        picture::{encode, LossyFormat},
        receiver::Receiver,
        sender::{self, Options, Sender},
        Group,
    },
};

use crate::{
    codec::{parts, Parts},
    detached::detached,
    errors::{raised, OrRaise},
    key_space::{name, KeySpace},
    picture::picture_of,
};

/// Maximum feedback interval, in seconds.
const MAX_FEEDBACK_INTERVAL_S: f64 = 3600.0;

/// The sending end of a stream.
#[pyclass(frozen, module = "rect._rect")]
pub struct StreamSender {
    core: Mutex<Sender>,
    lossy_format: LossyFormat,
}

/// A frame to encode for one group of receivers.
#[pyclass(frozen, module = "rect._rect")]
pub struct Job(sender::Job);

/// The receiving end of a stream.
#[pyclass(frozen, module = "rect._rect")]
pub struct StreamReceiver(Mutex<Receiver>);

#[pymethods]
impl StreamSender {
    /// Creates a sender. `mode` is `adaptive`, `fixed` or `sensor`; options that are `None` have the defaults of the
    /// mode. Raises `OptionError`.
    #[new]
    #[pyo3(signature = (mode, source, unix_ms, *, max_frames_per_s=None, min_frames_per_s=None, max_bytes_per_s=None,
        feedback_interval_s=None, webp=false))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        mode: &str,
        source: u16,
        unix_ms: u64,
        max_frames_per_s: Option<f64>,
        min_frames_per_s: Option<f64>,
        max_bytes_per_s: Option<f64>,
        feedback_interval_s: Option<f64>,
        webp: bool,
    ) -> PyResult<Self> {
        let option_error = |option: &str, value: String, expected: &str| {
            raised(py, "OptionError", (option, value, expected))
        };
        let positive = |option: &str, number: Option<f64>| match number {
            Some(number) if !(number.is_finite() && number > 0.0) => Err(option_error(
                option,
                number.to_string(),
                "it must be a number above 0",
            )),
            number => Ok(number),
        };
        let mut options = match mode {
            "adaptive" => Options::default(),
            "fixed" => Options::fixed(Options::default().max_frames_per_s),
            "sensor" => Options::sensor(),
            _ => {
                let expected = "it must be \"adaptive\", \"fixed\" or \"sensor\"";
                return Err(option_error("mode", mode.to_owned(), expected));
            }
        };
        if let Some(max) = positive("max_frames_per_s", max_frames_per_s)? {
            options.max_frames_per_s = max;
        }
        if let Some(min) = positive("min_frames_per_s", min_frames_per_s)? {
            options.min_frames_per_s = min;
        }
        if let Some(max) = positive("max_bytes_per_s", max_bytes_per_s)? {
            options.rates.max_bytes_per_s = max;
            options.rates.initial_bytes_per_s = options.rates.initial_bytes_per_s.min(max);
            options.rates.min_bytes_per_s = options.rates.min_bytes_per_s.min(max);
        }
        match feedback_interval_s {
            Some(seconds) if !(0.0..=MAX_FEEDBACK_INTERVAL_S).contains(&seconds) => {
                let expected = "it must be 0 (never) to 3600 seconds";
                return Err(option_error(
                    "feedback_interval",
                    seconds.to_string(),
                    expected,
                ));
            }
            Some(seconds) => options.feedback_interval = Duration::from_secs_f64(seconds),
            None => {}
        }
        if webp {
            options.lossy_format = LossyFormat::Webp;
        }
        let lossy_format = options.lossy_format;
        let core = Mutex::new(Sender::new(options, source, unix_ms, Instant::now()));
        Ok(Self { core, lossy_format })
    }

    /// Offers a frame of `pixels` pixels (or bytes, if it is not a picture). Returns a job for each group of receivers
    /// that is due for a frame.
    fn offer(&self, pixels: usize) -> Vec<Job> {
        let jobs = self.core().offer(pixels, Instant::now());
        jobs.into_iter().map(Job).collect()
    }

    /// Encodes a picture for a job.
    fn encode_picture<'py>(
        &self,
        py: Python<'py>,
        job: &Job,
        size: (u32, u32, String),
        pixels: PyBackedBytes,
    ) -> PyResult<Parts<'py>> {
        let (width, height, format) = size;
        let picture = picture_of(width, height, &format, pixels)?;
        let encoded = detached(py, || encode(&picture, job.0.step, self.lossy_format));
        Ok(parts(py, &encoded.or_raise()?))
    }

    /// Handles a frame that was encoded into `bytes` bytes, and returns its attachment.
    fn on_encoded<'py>(&self, py: Python<'py>, job: &Job, bytes: usize) -> Bound<'py, PyBytes> {
        let attachment = self.core().on_encoded(job.0, bytes, Instant::now());
        PyBytes::new(py, &attachment.encode())
    }

    /// Handles Zenoh's report whether a group's key has subscribers.
    fn on_subscribers(&self, group: usize, has_subscribers: bool) {
        if let Some(group) = Group::ALL.get(group) {
            self.core().on_subscribers(*group, has_subscribers);
        }
    }

    /// Handles the feedback of a receiver. Invalid feedback changes nothing.
    fn on_feedback(&self, key_space: &KeySpace, key: &str, bytes: &[u8]) {
        let decoded = (feedback_from(&key_space.0, key), Feedback::decode(bytes));
        if let (Some(robot), Ok(feedback)) = decoded {
            self.core().on_feedback(&robot, &feedback, Instant::now());
        }
    }

    /// Returns the notice to publish now, if there is one.
    fn poll_notice<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        let notice = self.core().poll_notice(Instant::now())?;
        Some(PyBytes::new(py, &notice.encode()))
    }

    /// Returns the current notice, for a receiver that queries it.
    fn notice<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let notice = self.core().notice(Instant::now());
        PyBytes::new(py, &notice.encode())
    }

    /// Returns the state of the stream, as JSON.
    fn status<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let status = self.core().status();
        // It contains only numbers and names, so encoding it as JSON cannot fail.
        PyBytes::new(py, &serde_json::to_vec(&status).unwrap_or_default())
    }
}

impl StreamSender {
    fn core(&self) -> MutexGuard<'_, Sender> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Job {
    /// The group of receivers: 0 is the main group, 1 the slow one.
    #[getter]
    fn group(&self) -> usize {
        Group::ALL
            .iter()
            .position(|group| *group == self.0.group)
            .unwrap_or_default()
    }

    /// The quality, 1 to 100. `None` if the picture is to be lossless, or if the stream is not adaptive.
    #[getter]
    fn quality(&self) -> Option<u8> {
        match self.0.step?.coding {
            Coding::Lossy(quality) => Some(quality),
            Coding::Lossless => None,
        }
    }

    /// The factor by which width and height are scaled, at most 1. `None` if the stream is not adaptive.
    #[getter]
    fn scale(&self) -> Option<f64> {
        Some(f64::from(self.0.step?.quarters) / 4.0)
    }
}

#[pymethods]
impl StreamReceiver {
    #[new]
    fn new(robot: &str, id: u16) -> PyResult<Self> {
        let receiver = Receiver::new(name(robot)?, id, Instant::now());
        Ok(Self(Mutex::new(receiver)))
    }

    /// Handles a frame, and returns its number, its age in seconds if it is known, and the number of frames directly
    /// before it that did not arrive. Returns `None` if the frame is older than one that has already arrived.
    fn on_frame(&self, attachment: Option<&[u8]>, bytes: usize) -> Option<(u32, Option<f64>, u32)> {
        let attachment = attachment.and_then(Attachment::decode);
        let seen = self.core().on_frame(attachment, bytes, Instant::now())?;
        let age = seen.age.map(|age| age.as_secs_f64());
        Some((seen.number, age, seen.skipped))
    }

    /// Handles the reply to a query for the notice that was sent `asked_s_ago` seconds ago.
    fn on_answer(&self, notice: &[u8], asked_s_ago: f64) {
        let now = Instant::now();
        let ago = Duration::try_from_secs_f64(asked_s_ago).unwrap_or_default();
        let asked = now.checked_sub(ago).unwrap_or(now);
        if let Ok(notice) = Notice::decode(notice) {
            self.core().on_reply(&notice, asked, now);
        }
    }

    /// Handles a notice that the sender published.
    fn on_notice(&self, notice: &[u8]) {
        if let Ok(notice) = Notice::decode(notice) {
            self.core().on_notice(&notice);
        }
    }

    /// Returns the group whose frames to subscribe to, once it is known.
    fn poll_group(&self) -> Option<usize> {
        let group = self.core().poll_group(Instant::now())?;
        Group::ALL.iter().position(|known| *known == group)
    }

    /// Returns whether to query the notice of the sender now.
    fn poll_question(&self) -> bool {
        self.core().poll_query(Instant::now())
    }

    /// Returns the feedback to send now, if there is any.
    fn poll_feedback<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        let feedback = self.core().poll_feedback(Instant::now())?;
        Some(PyBytes::new(py, &feedback.encode()))
    }

    /// Returns the time until the next poll, in seconds. A poll is due at once after a notice has arrived.
    fn poll_in(&self) -> f64 {
        let now = Instant::now();
        let at = self.core().poll_at(now);
        at.saturating_duration_since(now).as_secs_f64()
    }

    /// Returns the round trip of a small message to the sender, in seconds, once it is known.
    fn round_trip(&self) -> Option<f64> {
        let round_trip = self.core().round_trip();
        round_trip.map(|time| time.as_secs_f64())
    }
}

impl StreamReceiver {
    fn core(&self) -> MutexGuard<'_, Receiver> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

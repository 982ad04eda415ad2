//! Owns the two ends of a stream, as the core has them; the time is this computer's clock that does not jump.
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
        picture::{encode, Photographs},
        receiver::Receiver,
        sender::{self, Options, Sender},
        Group,
    },
};

use crate::{
    codec::{parts, Parts},
    detached::detached,
    errors::{raised, OrRaise},
    picture::picture_of,
    place::{name, Place},
};

/// The longest between two words of a receiver, in seconds.
const MAX_FEEDBACK_S: f64 = 3600.0;

/// The sending end of a stream.
#[pyclass(frozen, module = "rect._rect")]
pub struct StreamSender {
    core: Mutex<Sender>,
    photographs: Photographs,
}

/// A frame that is wanted.
#[pyclass(frozen, module = "rect._rect")]
pub struct Job(sender::Job);

/// The receiving end of a stream.
#[pyclass(frozen, module = "rect._rect")]
pub struct StreamReceiver(Mutex<Receiver>);

#[pymethods]
impl StreamSender {
    /// `mode`: `adaptive`, `fixed` or `sensor`; `None`: as the core has it.
    #[new]
    #[pyo3(signature = (mode, source, unix_ms, *, frames_per_s=None, least_frames_per_s=None, most_bytes_per_s=None,
        feedback_s=None, webp=false))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        mode: &str,
        source: u16,
        unix_ms: u64,
        frames_per_s: Option<f64>,
        least_frames_per_s: Option<f64>,
        most_bytes_per_s: Option<f64>,
        feedback_s: Option<f64>,
        webp: bool,
    ) -> PyResult<Self> {
        let refused = |what: &str, value: String, known: &str| {
            raised(py, "OptionError", (what, value, known))
        };
        let positive = |what: &str, number: Option<f64>| match number {
            Some(number) if !(number.is_finite() && number > 0.0) => {
                Err(refused(what, number.to_string(), "it is a number above 0"))
            }
            number => Ok(number),
        };
        let mut options = match mode {
            "adaptive" => Options::default(),
            "fixed" => Options::fixed(Options::default().most_frames_per_s),
            "sensor" => Options::sensor(),
            _ => {
                let known = "it is \"adaptive\", \"fixed\" or \"sensor\"";
                return Err(refused("mode", mode.to_owned(), known));
            }
        };
        if let Some(most) = positive("frames_per_s", frames_per_s)? {
            options.most_frames_per_s = most;
        }
        if let Some(least) = positive("least_frames_per_s", least_frames_per_s)? {
            options.least_frames_per_s = least;
        }
        if let Some(most) = positive("most_bytes_per_s", most_bytes_per_s)? {
            options.rates.most = most;
            options.rates.first = options.rates.first.min(most);
            options.rates.least = options.rates.least.min(most);
        }
        match feedback_s {
            Some(seconds) if !(0.0..=MAX_FEEDBACK_S).contains(&seconds) => {
                let known = "it is 0 (never) to 3600 seconds";
                return Err(refused("feedback", seconds.to_string(), known));
            }
            Some(seconds) => options.feedback = Duration::from_secs_f64(seconds),
            None => {}
        }
        if webp {
            options.photographs = Photographs::Webp;
        }
        let photographs = options.photographs;
        let core = Mutex::new(Sender::new(options, source, unix_ms, Instant::now()));
        Ok(Self { core, photographs })
    }

    /// There is a frame of so many pixels: what is to be made of it.
    fn offer(&self, pixels: usize) -> Vec<Job> {
        let jobs = self.core().offer(pixels, Instant::now());
        jobs.into_iter().map(Job).collect()
    }

    /// The picture as a job wants it.
    fn encode_picture<'py>(
        &self,
        py: Python<'py>,
        job: &Job,
        size: (u32, u32, String),
        pixels: PyBackedBytes,
    ) -> PyResult<Parts<'py>> {
        let (width, height, format) = size;
        let picture = picture_of(width, height, &format, pixels)?;
        let encoded = detached(py, || encode(&picture, job.0.level, self.photographs));
        Ok(parts(py, &encoded.or_raise()?))
    }

    /// The frame has become so many bytes; what goes with it.
    fn on_encoded<'py>(&self, py: Python<'py>, job: &Job, bytes: usize) -> Bound<'py, PyBytes> {
        let attachment = self.core().on_encoded(job.0, bytes, Instant::now());
        PyBytes::new(py, &attachment.encode())
    }

    /// Zenoh says whether anyone subscribes to a group's key.
    fn on_subscribers(&self, group: usize, has_subscribers: bool) {
        if let Some(group) = Group::ALL.get(group) {
            self.core().on_subscribers(*group, has_subscribers);
        }
    }

    /// A receiver says what it gets; what is no such word changes nothing.
    fn on_feedback(&self, place: &Place, key: &str, bytes: &[u8]) {
        let told = (feedback_from(&place.0, key), Feedback::decode(bytes));
        if let (Some(robot), Ok(feedback)) = told {
            self.core().on_feedback(&robot, &feedback, Instant::now());
        }
    }

    /// What to put for all to know, if anything.
    fn poll_notice<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        let notice = self.core().poll_notice(Instant::now())?;
        Some(PyBytes::new(py, &notice.encode()))
    }

    /// The answer to whoever asks.
    fn notice<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let notice = self.core().notice(Instant::now());
        PyBytes::new(py, &notice.encode())
    }

    /// What is known of it, as JSON.
    fn status<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let status = self.core().status();
        // Numbers and names only: there is nothing in it that JSON can't say.
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
    /// For which group: 0, those that keep up; 1, the slow ones.
    #[getter]
    fn group(&self) -> usize {
        Group::ALL
            .iter()
            .position(|group| *group == self.0.group)
            .unwrap_or_default()
    }

    /// The quality that is wanted, 1 to 100; `None`: lossless, or as the program likes.
    #[getter]
    fn quality(&self) -> Option<u8> {
        match self.0.level?.coding {
            Coding::Lossy(quality) => Some(quality),
            Coding::Lossless => None,
        }
    }

    /// How large: 1 is the whole; `None`: as the program likes.
    #[getter]
    fn scale(&self) -> Option<f64> {
        Some(f64::from(self.0.level?.quarters) / 4.0)
    }
}

#[pymethods]
impl StreamReceiver {
    #[new]
    fn new(robot: &str, id: u16) -> PyResult<Self> {
        let receiver = Receiver::new(name(robot)?, id, Instant::now());
        Ok(Self(Mutex::new(receiver)))
    }

    /// A frame: its number, its age in seconds where known, and how many are missing before it. `None`: an older one than the last.
    fn on_frame(&self, attachment: Option<&[u8]>, bytes: usize) -> Option<(u32, Option<f64>, u32)> {
        let attachment = attachment.and_then(Attachment::decode);
        let seen = self.core().on_frame(attachment, bytes, Instant::now())?;
        let age = seen.age.map(|age| age.as_secs_f64());
        Some((seen.number, age, seen.skipped))
    }

    /// The sender answers what was asked so many seconds ago.
    fn on_answer(&self, notice: &[u8], asked_s_ago: f64) {
        let now = Instant::now();
        let ago = Duration::try_from_secs_f64(asked_s_ago).unwrap_or_default();
        let asked = now.checked_sub(ago).unwrap_or(now);
        if let Ok(notice) = Notice::decode(notice) {
            self.core().on_answer(&notice, asked, now);
        }
    }

    /// The sender says so to all.
    fn on_notice(&self, notice: &[u8]) {
        if let Ok(notice) = Notice::decode(notice) {
            self.core().on_notice(&notice);
        }
    }

    /// To which group's key to listen, once that is known.
    fn poll_group(&self) -> Option<usize> {
        let group = self.core().poll_group(Instant::now())?;
        Group::ALL.iter().position(|known| *known == group)
    }

    /// Whether to ask the sender now.
    fn poll_question(&self) -> bool {
        self.core().poll_question(Instant::now())
    }

    /// What to tell the sender, if anything.
    fn poll_feedback<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        let feedback = self.core().poll_feedback(Instant::now())?;
        Some(PyBytes::new(py, &feedback.encode()))
    }

    /// In how many seconds to poll again, unless the sender says something before.
    fn poll_in(&self) -> f64 {
        let now = Instant::now();
        let at = self.core().poll_at(now);
        at.saturating_duration_since(now).as_secs_f64()
    }

    /// What a small message takes to the sender and back, in seconds, once it is known.
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

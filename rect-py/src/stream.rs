//! Wraps the core's sending and receiving ends of a stream.
use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant, SystemTime},
};

use pyo3::{
    prelude::*,
    pybacked::PyBackedBytes,
    types::{PyBytes, PyTuple},
};
use rect_core::{
    clock::unix::ms_since_1970,
    name::topic::RobotTopic,
    stream::{
        frame, job,
        ladder::Coding,
        options::{OptionError, PartialOptions},
        picture::{LossyFormat, PictureEncoder},
        publish, read, watch,
    },
};

use crate::{
    clock::Clock,
    codec::{parts, payload, Parts},
    detached::detached,
    driver::{act, lock, Driver},
    errors::{raised, OrRaise, Raised},
    key_space::{topic, KeySpace},
    picture::picture_of,
    urgency,
};

/// The sending end of a stream.
#[pyclass(frozen, module = "rect._rect")]
pub struct StreamPublish {
    core: Arc<Mutex<publish::StreamPublish>>,
    clock: Clock,
    encoder: Mutex<PictureEncoder>,
}

/// A frame to encode for one group of receivers.
#[pyclass(frozen, module = "rect._rect")]
pub struct Job(job::Job);

/// The receiving end of a stream.
#[pyclass(frozen, module = "rect._rect")]
pub struct StreamWatch {
    core: Arc<Mutex<watch::StreamWatch>>,
    clock: Clock,
}

/// Reads the frames of a stream: decodes video, and counts what the program has not read.
#[pyclass(frozen, module = "rect._rect")]
pub struct FrameReader(Mutex<read::FrameReader>);

#[pymethods]
impl StreamPublish {
    /// Creates a sender. `unix_ms` is the time in milliseconds since 1970; default: the time of the clock. `mode` is `adaptive`, `video`, `fixed` or `sensor`; options that are `None` have the defaults of the
    /// mode. Raises `OptionError`.
    #[new]
    #[pyo3(signature = (key_space, topic, urgency, mode, source, *, max_frames_per_s=None, min_frames_per_s=None, max_bytes_per_s=None,
        feedback_interval_s=None, webp=false, unix_ms=None))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        key_space: &KeySpace,
        topic: &str,
        urgency: &str,
        mode: &str,
        source: u16,
        max_frames_per_s: Option<f64>,
        min_frames_per_s: Option<f64>,
        max_bytes_per_s: Option<f64>,
        feedback_interval_s: Option<f64>,
        webp: bool,
        unix_ms: Option<u64>,
    ) -> PyResult<Self> {
        let partial = PartialOptions {
            preset: mode.parse().or_raise()?,
            max_frames_per_s,
            min_frames_per_s,
            max_bytes_per_s,
            feedback_interval_s,
            lossy_format: if webp {
                LossyFormat::Webp
            } else {
                LossyFormat::Jpeg
            },
        };
        let options = partial.complete().or_raise()?;
        let encoder = Mutex::new(PictureEncoder::new(options.lossy_format));
        let clock = Clock::new();
        let now = clock.created_at();
        let stream = publish::StreamPublish::new(
            &key_space.0,
            &self::topic(topic)?,
            options,
            urgency::parse(py, urgency)?,
            source,
            unix_ms.unwrap_or_else(|| ms_since_1970(SystemTime::now())),
            now,
        );
        Ok(Self {
            core: Arc::new(Mutex::new(stream)),
            clock,
            encoder,
        })
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Offers a frame of `pixels` pixels (or bytes, if it is not a picture). Returns a job for each group of receivers
    /// that is due for a frame.
    fn offer(&self, pixels: usize) -> Vec<Job> {
        let jobs = lock(&self.core).offer(pixels, self.clock.now());
        jobs.into_iter().map(Job).collect()
    }

    /// Offers a picture of that size, which a video stream sends as video. Returns a job for each group of receivers that is due
    /// for a frame.
    fn offer_picture(&self, width: u32, height: u32) -> Vec<Job> {
        let jobs = lock(&self.core).offer_picture(width, height, self.clock.now());
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
        let encoded = detached(py, || {
            lock(&self.encoder).encode(&picture, job.0, Instant::now())
        });
        Ok(parts(py, &encoded.or_raise()?))
    }

    /// Returns the step that sends the frame that was encoded for a job.
    fn frame<'py>(
        &self,
        py: Python<'py>,
        job: &Job,
        bytes: PyBackedBytes,
        encoding: &str,
    ) -> PyResult<Bound<'py, PyTuple>> {
        let payload = payload(bytes, encoding);
        let action = lock(&self.core).frame(job.0, payload, self.clock.now());
        act(py, action)
    }

    /// The key that identifies the stream.
    #[getter]
    fn key(&self) -> String {
        lock(&self.core).notice_key().to_owned()
    }

    /// Returns the state of the stream, as JSON.
    fn status<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let status = lock(&self.core).status();
        // It contains only numbers and names, so encoding it as JSON cannot fail.
        PyBytes::new(py, &serde_json::to_vec(&status).unwrap_or_default())
    }
}

impl Raised for OptionError {
    fn raised(self) -> PyErr {
        let reason = self.reason();
        Python::attach(|py| match self.value.parse::<f64>() {
            Ok(number) => raised(py, "OptionError", (self.option, number, reason)),
            Err(_) => raised(py, "OptionError", (self.option, self.value, reason)),
        })
    }
}

#[pymethods]
impl Job {
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
impl StreamWatch {
    /// Creates the receiving end of a stream of a robot. `id` is a random number of 16 bits.
    #[new]
    fn new(key_space: &KeySpace, stream: &str, id: u16) -> PyResult<Self> {
        let RobotTopic { robot, topic } = RobotTopic::new(stream).or_raise()?;
        let clock = Clock::new();
        let core = watch::StreamWatch::new(&key_space.0, robot, topic, id, clock.created_at());
        Ok(Self {
            core: Arc::new(Mutex::new(core)),
            clock,
        })
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Returns the reader of the frames that arrive.
    fn reader(&self) -> FrameReader {
        FrameReader(Mutex::new(lock(&self.core).reader()))
    }

    /// Asks the sender for a key frame.
    fn ask_for_key(&self) {
        lock(&self.core).ask_for_key();
    }

    /// Leaves the decoding of video to the program.
    fn leave_undecoded(&self) {
        lock(&self.core).leave_undecoded();
    }

    /// Returns the round trip of a small message to the sender, in seconds, once it is known.
    fn round_trip(&self) -> Option<f64> {
        let round_trip = lock(&self.core).round_trip();
        round_trip.map(|time| time.as_secs_f64())
    }
}

#[pymethods]
impl FrameReader {
    /// Reads a frame that the driver has delivered. Returns the payload, the number of frames since the previous one that was
    /// read, how many of them did not arrive, and the length of the frame as it was sent; `None` if there is nothing to show.
    fn read<'py>(
        &self,
        py: Python<'py>,
        frame: (u64, u64, u32, Option<f64>, PyBackedBytes, String),
    ) -> Option<(Parts<'py>, u32, u32, usize)> {
        let (ordinal, lost, number, age_s, bytes, encoding) = frame;
        let received = frame::ReceivedFrame {
            payload: payload(bytes, &encoding),
            number,
            age: age_s.map(Duration::from_secs_f64),
            ordinal,
            lost,
        };
        let frame = detached(py, || lock(&self.0).read(received))?;
        let payload = parts(py, &frame.payload);
        Some((payload, frame.skipped, frame.lost, frame.sent_bytes))
    }
}

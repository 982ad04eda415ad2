//! Sends streams of frames and pictures.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
};

use rect_core::stream::{
    options::{PartialOptions, Preset},
    picture::LossyFormat,
};

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut, Out},
    cancellable::FOREVER,
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    picture,
    robot::RobotHandle,
    text::{choice, string_into_c, StringView},
};

/// A stream that this program sends, of which only the newest frame matters. `rect_drop(&stream.id, ..)` ends it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct StreamSender {
    /// The handle.
    pub id: u64,
}

/// How a stream adapts to the links.
#[repr(C)]
pub enum StreamMode {
    /// Pictures are scaled and compressed automatically so that they fit what the links can carry.
    Adaptive = 0,
    /// Frames are sent unchanged, at a limited rate.
    Fixed = 1,
    /// Values of a sensor: frames are sent unchanged, as often as they come, and receivers send no feedback.
    Sensor = 2,
    /// Pictures are sent as video: each frame contains only what differs from the one before.
    Video = 3,
}

/// The options of a stream. Fields that are 0 keep their defaults, so `rect_stream_options options = {0};` is an adaptive
/// stream, and so is NULL.
#[repr(C)]
pub struct StreamOptions {
    /// The mode: a `rect_stream_mode`.
    pub mode: u32,
    /// Whether to compress pictures as WebP instead of JPEG. WebP is smaller, but takes several times as long.
    pub webp: bool,
    /// Maximum frame rate, 0.01 to 1,000,000 frames per second. Default: 15, or no limit for a sensor.
    pub max_frames_per_s: f64,
    /// Minimum frame rate that an adaptive stream aims for with its smallest pictures, 0.01 to 1,000,000 frames per second.
    /// Default: 5.
    pub min_frames_per_s: f64,
    /// Maximum data rate of an adaptive stream, 1 or more bytes per second. Default: 20,000,000.
    pub max_bytes_per_s: f64,
    /// Interval at which receivers report what arrives, 200 to 10,000 ms; `RECT_FOREVER` for no reports. Default: 500 for an
    /// adaptive stream or a video, 2000 for a fixed one, and no reports for a sensor.
    pub feedback_interval_ms: u32,
}

struct OwnedStream(rect::StreamSender);

impl Object for OwnedStream {
    const KIND: &'static str = "stream";
}

/// Returns the value of an option, or `None` if it is 0, which stands for the default.
fn unless_0<T: Default + PartialEq>(value: T) -> Option<T> {
    (value != T::default()).then_some(value)
}

fn read_options(given: Option<&StreamOptions>) -> Result<rect::StreamOptions, Failure> {
    let Some(given) = given else {
        return Ok(rect::StreamOptions::default());
    };
    let presets = [
        (StreamMode::Adaptive as u32, Preset::Adaptive),
        (StreamMode::Fixed as u32, Preset::Fixed),
        (StreamMode::Sensor as u32, Preset::Sensor),
        (StreamMode::Video as u32, Preset::Video),
    ];
    let feedback_interval_s = match given.feedback_interval_ms {
        0 => None,
        FOREVER => Some(0.0),
        ms => Some(f64::from(ms) / 1000.0),
    };
    let options = PartialOptions {
        preset: choice("options.mode", &presets, given.mode)?,
        max_frames_per_s: unless_0(given.max_frames_per_s),
        min_frames_per_s: unless_0(given.min_frames_per_s),
        max_bytes_per_s: unless_0(given.max_bytes_per_s),
        feedback_interval_s,
        lossy_format: match given.webp {
            true => LossyFormat::Webp,
            false => LossyFormat::Jpeg,
        },
    };
    Ok(options.complete().map_err(rect::Error::from)?)
}

/// Creates a stream of which only the newest frame matters (a slow link drops older ones), and writes it to `stream`.
/// `options` may be NULL for the defaults.
///
/// Returns `RECT_CODE_TOPIC` if the topic is invalid, and `RECT_CODE_OPTION` if an option is out of range. May be called on
/// any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_stream(
    robot: RobotHandle,
    topic: *const c_char,
    options: Option<&StreamOptions>,
    stream: Option<&mut MaybeUninit<StreamSender>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("stream", &stream)?;
        // SAFETY: the caller follows the rules of rect.h.
        let topic = unsafe { text("topic", topic) }?;
        let (program, options) = (robot.resolve()?, read_options(options)?);
        let declared = program.wait(program.robot.stream(topic, options))?;
        let id = handle::insert(OwnedStream(declared));
        write_out("stream", stream, StreamSender { id })
    })
}

/// Sends a frame unchanged, if any receiver needs one now. Does not wait for the link.
///
/// Writes the number of groups of receivers that the frame is sent to, 0 to 2, to `sent`, which may be NULL.
///
/// May be called on any thread; calls of several threads run one after another.
#[no_mangle]
pub unsafe extern "C" fn rect_stream_sender_send(
    stream: StreamSender,
    frame: Option<&PayloadView>,
    sent: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let frame = unsafe { require("frame", frame)?.read() }?;
        let count = handle::get::<OwnedStream>(stream.id)?.0.send(frame)?;
        write_count(sent, count)
    })
}

/// Sends a picture: rows of pixels without padding, from the top left. An adaptive stream scales and compresses it as the
/// links require, and a video stream sends it as video; other streams send it uncompressed. If no receiver needs a frame now, nothing is compressed or sent.
///
/// `format` is a `rect_format`; `len` is the size of `pixels` in bytes; `sent` is the same as for `rect_stream_sender_send`.
///
/// May be called on any thread; calls of several threads run one after another. Takes as long as compressing the picture.
#[no_mangle]
pub unsafe extern "C" fn rect_stream_sender_send_picture(
    stream: StreamSender,
    width: u32,
    height: u32,
    format: u32,
    pixels: *const c_void,
    len: usize,
    sent: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let picture = unsafe { picture::read(width, height, format, pixels, len) }?;
        let count = handle::get::<OwnedStream>(stream.id)?
            .0
            .send_picture(&picture)?;
        write_count(sent, count)
    })
}

fn write_count(sent: Out<'_, u32>, count: usize) -> Result<(), Failure> {
    if let Some(sent) = sent {
        sent.write(u32::try_from(count).unwrap_or(u32::MAX));
    }
    Ok(())
}

/// Writes the state of a stream to `status`: what is sent, what arrives, and why the current quality was chosen. It is JSON
/// with `groups` and `receivers` (docs/concepts/streams.md). May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_stream_sender_status(
    stream: StreamSender,
    status: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("status", &status)?;
        let current = handle::get::<OwnedStream>(stream.id)?.0.status();
        let text = serde_json::to_string(&current)
            .map_err(|error| Failure::Internal(error.to_string()))?;
        write_out("status", status, string_into_c(text))
    })
}

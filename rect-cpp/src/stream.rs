//! Owns streams that this program sends.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
};

use rect::{core::stream::picture::Photographs, core::stream::sender::Mode, StreamOptions};

use crate::{
    argument::{text, there},
    boundary::{call, give, wanted, ErrorOut, Out},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    picture,
    robot::Robot,
    text::{choice, hold_string, StringView},
};

/// A stream that this program sends, of which the newest frame counts. `rect_drop(&stream.id, ..)` ends it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Stream {
    /// Its handle.
    pub id: u64,
}

/// How a stream is sent.
#[repr(C)]
pub enum StreamMode {
    /// Frames are as good as what gets through allows: pictures become smaller and coarser by themselves.
    Adaptive = 0,
    /// Frames go as they are given, at most so often.
    Fixed = 1,
    /// A sensor's values: as they are, as often as they come, and nothing comes back.
    Sensor = 2,
}

/// How a stream is sent. `rect_stream_options options = {0};` is adaptive, and so is NULL; what is 0 is left at its default.
#[repr(C)]
pub struct StreamSettings {
    /// A `rect_stream_mode`.
    pub mode: u32,
    /// Pictures with a quality are written as WebP instead of JPEG: smaller, and several times as long to write.
    pub webp: bool,
    /// Not more frames per second than that; default 15. For a fixed one it has to be given.
    pub most_frames_per_s: f64,
    /// Frames per second that are wanted even of the smallest; default 5.
    pub least_frames_per_s: f64,
}

struct Held(rect::Stream);

impl Object for Held {
    const KIND: &'static str = "stream";
}

fn per_s(name: &'static str, given: f64) -> Result<Option<f64>, Failure> {
    match given {
        0.0 => Ok(None),
        rate if rate.is_finite() && rate > 0.0 => Ok(Some(rate)),
        rate => Err(Failure::argument(
            name,
            format!("is {rate}, which is no rate"),
        )),
    }
}

fn options(given: Option<&StreamSettings>) -> Result<StreamOptions, Failure> {
    let Some(given) = given else {
        return Ok(StreamOptions::default());
    };
    let most = per_s("options.most_frames_per_s", given.most_frames_per_s)?;
    let least = per_s("options.least_frames_per_s", given.least_frames_per_s)?;
    let modes = [
        (StreamMode::Adaptive as u32, Some(Mode::Adaptive)),
        (StreamMode::Fixed as u32, Some(Mode::Fixed)),
        (StreamMode::Sensor as u32, None),
    ];
    let mut options = match choice("options.mode", &modes, given.mode)? {
        Some(Mode::Adaptive) => StreamOptions::default(),
        Some(Mode::Fixed) => StreamOptions::fixed(most.ok_or_else(|| {
            Failure::argument(
                "options.most_frames_per_s",
                "is 0, and a fixed stream has to have one",
            )
        })?),
        None => StreamOptions::sensor(),
    };
    if given.webp {
        options.photographs = Photographs::Webp;
    }
    options.most_frames_per_s = most.unwrap_or(options.most_frames_per_s);
    options.least_frames_per_s = least.unwrap_or(options.least_frames_per_s);
    Ok(options)
}

/// A stream of which the newest frame counts: what is old, a slow link drops.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_stream(
    robot: Robot,
    topic: *const c_char,
    settings: Option<&StreamSettings>,
    stream: Option<&mut MaybeUninit<Stream>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("stream", &stream)?;
        // SAFETY: as rect.h asks.
        let topic = unsafe { text("topic", topic) }?;
        let (program, options) = (robot.live()?, options(settings)?);
        let declared = program.wait(program.robot.stream(topic, options))?;
        let id = handle::insert(Held(declared));
        give("stream", stream, Stream { id })
    })
}

/// Sends a frame as it is, if anyone wants one now. Does not wait for the link. `sent`: to how many groups of receivers it
/// went, 0 to 2; may be NULL.
///
/// Thread: any; of several threads' frames one goes out after another.
#[no_mangle]
pub unsafe extern "C" fn rect_stream_send(
    stream: Stream,
    frame: Option<&PayloadView>,
    sent: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let frame = unsafe { there("frame", frame)?.read() }?;
        let count = handle::get::<Held>(stream.id)?.0.send(frame)?;
        tell(sent, count)
    })
}

/// Sends a picture, at the size and quality that get through: rows of pixels without gaps, from the upper left. Nothing is
/// written while nobody wants one. `format`: a `rect_format`; `len`: of the pixels, in bytes; `sent`: as `rect_stream_send`.
///
/// Thread: any; of several threads' frames one goes out after another. Takes as long as writing the picture.
#[no_mangle]
pub unsafe extern "C" fn rect_stream_send_picture(
    stream: Stream,
    width: u32,
    height: u32,
    format: u32,
    pixels: *const c_void,
    len: usize,
    sent: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let picture = unsafe { picture::read(width, height, format, pixels, len) }?;
        let count = handle::get::<Held>(stream.id)?.0.send_picture(&picture)?;
        tell(sent, count)
    })
}

fn tell(sent: Out<'_, u32>, count: usize) -> Result<(), Failure> {
    if let Some(sent) = sent {
        sent.write(u32::try_from(count).unwrap_or(u32::MAX));
    }
    Ok(())
}

/// What goes out, what gets through, and why it is as it is: JSON, with `groups` and `receivers` (docs/streams.md).
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_stream_status(
    stream: Stream,
    status: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("status", &status)?;
        let told = handle::get::<Held>(stream.id)?.0.status();
        let text =
            serde_json::to_string(&told).map_err(|error| Failure::Fault(error.to_string()))?;
        give("status", status, hold_string(text))
    })
}

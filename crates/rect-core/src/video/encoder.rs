//! Encodes pictures as video.
use std::{fmt, time::Instant};

#[cfg(feature = "video")]
use openh264::{
    encoder::{
        BitRate, Complexity, EncoderConfig, FrameRate, IntraFramePeriod, QpRange, RateControlMode,
        UsageType,
    },
    formats::{RgbSliceU8, YUVBuffer},
    OpenH264API, Timestamp,
};

#[cfg(feature = "video")]
use super::FORMAT;
#[cfg(feature = "video")]
use crate::{cause::Cause, codec::picture::Format, message::encoding::Encoding};
use crate::{
    codec::picture::Picture,
    message::{codec_error::CodecError, payload::Payload},
};

/// The coarsest quantiser. Beyond it, pictures are hard to recognise; [`Settings::quarters`] or the rate has to be smaller
/// then.
#[cfg(feature = "video")]
const MAX_QUANTISER: u8 = 44;
/// The finest quantiser. Below it, more bytes do not show.
#[cfg(feature = "video")]
const MIN_QUANTISER: u8 = 12;
/// A change of the rate by a smaller share than this is not passed to the encoder.
#[cfg(feature = "video")]
const TOLERANCE: f64 = 0.05;

/// The settings of the next frame.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// The rate of the video, in bytes per second.
    pub bytes_per_s: f64,
    /// The largest number of frames per second.
    pub frames_per_s: f64,
    /// Width and height in quarters of the picture's.
    pub quarters: u8,
    /// Whether the frame must be a key frame.
    pub is_key: bool,
}

/// Encodes the pictures of one video.
#[derive(Default)]
pub struct Encoder {
    #[cfg(feature = "video")]
    running: Option<Running>,
}

#[cfg(feature = "video")]
struct Running {
    encoder: openh264::encoder::Encoder,
    size: (u32, u32),
    frames_per_s: f64,
    bytes_per_s: f64,
    began_at: Instant,
}

#[cfg(not(feature = "video"))]
impl Encoder {
    /// Fails: this program was built without video.
    ///
    /// # Errors
    /// Always returns [`CodecError::Unknown`].
    pub fn encode(&mut self, _: &Picture, _: Settings, _: Instant) -> Result<Payload, CodecError> {
        Err(super::decoder::unavailable())
    }
}

#[cfg(feature = "video")]
impl Encoder {
    /// Encodes the next picture. If its size differs from the previous one's, the frame is a key frame. A row or column that
    /// makes a side odd is left out.
    ///
    /// # Errors
    /// Returns [`CodecError::Failed`] if the picture is too small or too large (see [`fits`](super::fits)).
    pub fn encode(
        &mut self,
        picture: &Picture,
        settings: Settings,
        now: Instant,
    ) -> Result<Payload, CodecError> {
        let side = |side: u32| (side * u32::from(settings.quarters) / 4).max(super::MIN_SIDE);
        let scaled = picture.scaled(side(picture.width()), side(picture.height()))?;
        let size = (scaled.width() & !1, scaled.height() & !1);
        let can_continue = |running: &Running| {
            running.size == size && running.frames_per_s == settings.frames_per_s
        };
        let running = match self.running.take().filter(can_continue) {
            Some(running) => running,
            None => Running::start(size, settings, now).map_err(failed)?,
        };
        let running = self.running.insert(running);
        let bytes = running.encode(&scaled, settings, now).map_err(failed)?;
        Ok(Payload::new(bytes, Encoding::H264))
    }
}

#[cfg(feature = "video")]
impl Running {
    fn start(size: (u32, u32), settings: Settings, now: Instant) -> Result<Self, openh264::Error> {
        let config = EncoderConfig::new()
            .usage_type(UsageType::CameraVideoRealTime)
            .complexity(Complexity::Medium)
            .num_threads(1)
            .bitrate(BitRate::from_bps(bits(settings.bytes_per_s)))
            .max_frame_rate(FrameRate::from_hz(settings.frames_per_s as f32))
            // By the time between the pictures, because the sender skips some before they are encoded.
            .rate_control_mode(RateControlMode::Timestamp)
            .skip_frames(false)
            .qp(QpRange::new(MIN_QUANTISER, MAX_QUANTISER))
            // Key frames only when the sender asks for one.
            .intra_frame_period(IntraFramePeriod::from_num_frames(0))
            .scene_change_detect(false);
        let mut encoder =
            openh264::encoder::Encoder::with_api_config(OpenH264API::from_source(), config)?;
        quiet(&mut encoder);
        Ok(Self {
            encoder,
            size,
            frames_per_s: settings.frames_per_s,
            bytes_per_s: settings.bytes_per_s,
            began_at: now,
        })
    }

    fn encode(
        &mut self,
        picture: &Picture,
        settings: Settings,
        now: Instant,
    ) -> Result<Vec<u8>, openh264::Error> {
        if (settings.bytes_per_s / self.bytes_per_s - 1.0).abs() > TOLERANCE {
            self.bytes_per_s = settings.bytes_per_s;
            set_rate(&mut self.encoder, bits(settings.bytes_per_s));
        }
        if settings.is_key {
            self.encoder.force_intra_frame();
        }
        let (width, height) = (self.size.0 as usize, self.size.1 as usize);
        let pixels = rgb(picture, width, height);
        let source = YUVBuffer::from_rgb8_source(RgbSliceU8::new(&pixels, (width, height)));
        let passed = now.saturating_duration_since(self.began_at).as_millis();
        let at = Timestamp::from_millis(u64::try_from(passed).unwrap_or(0));
        Ok(self.encoder.encode_at(&source, at)?.to_vec())
    }
}

#[cfg(feature = "video")]
fn bits(bytes_per_s: f64) -> u32 {
    (bytes_per_s * 8.0).clamp(8_000.0, 240e6) as u32
}

/// Returns the first `width` pixels of the first `height` rows, as red, green and blue.
#[cfg(feature = "video")]
fn rgb(picture: &Picture, width: usize, height: usize) -> std::borrow::Cow<'_, [u8]> {
    let channels = picture.format().channels();
    let row = picture.width() as usize * channels;
    if picture.format() == Format::Rgb8 && row == width * channels {
        return picture.pixels()[..row * height].into();
    }
    let rows = picture.pixels().chunks_exact(row).take(height);
    let pixels = rows.flat_map(|row| row[..width * channels].chunks_exact(channels));
    match picture.format() {
        Format::Grey8 => pixels.flat_map(|grey| [grey[0]; 3]).collect(),
        Format::Rgb8 | Format::Rgba8 => pixels.flat_map(|p| [p[0], p[1], p[2]]).collect(),
    }
}

/// Changes the rate. If the encoder refuses, which no version of it does for a valid number, the rate stays as it is.
#[cfg(feature = "video")]
fn set_rate(encoder: &mut openh264::encoder::Encoder, bits_per_s: u32) {
    let mut rate = openh264_sys2::SBitrateInfo {
        iLayer: openh264_sys2::SPATIAL_LAYER_ALL,
        iBitrate: bits_per_s.try_into().unwrap_or(i32::MAX),
    };
    for option in [
        openh264_sys2::ENCODER_OPTION_MAX_BITRATE,
        openh264_sys2::ENCODER_OPTION_BITRATE,
    ] {
        // SAFETY: the option expects a pointer to this structure, and copies it.
        unsafe {
            encoder.raw_api().set_option(option, (&raw mut rate).cast());
        }
    }
}

/// Keeps OpenH264 from writing to the standard error stream, before it begins.
#[cfg(feature = "video")]
fn quiet(encoder: &mut openh264::encoder::Encoder) {
    let mut level = openh264_sys2::WELS_LOG_QUIET;
    // SAFETY: the option expects a pointer to a number, and copies it.
    unsafe {
        encoder.raw_api().set_option(
            openh264_sys2::ENCODER_OPTION_TRACE_LEVEL,
            (&raw mut level).cast(),
        );
    }
}

#[cfg(feature = "video")]
fn failed(error: openh264::Error) -> CodecError {
    CodecError::Failed {
        codec: FORMAT,
        reason: Cause::new(error),
    }
}

impl fmt::Debug for Encoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Encoder").finish_non_exhaustive()
    }
}

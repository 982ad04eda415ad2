//! Defines the options of a stream. All languages check them here, so that the ranges and messages are the same.
use std::{fmt, ops::RangeInclusive, str::FromStr, time::Duration};

use super::{ladder::Step, picture::LossyFormat, rate::RateLimits};

/// The frame rates that a program may choose. The pacer uses no others.
pub(super) const FRAMES_PER_S: RangeInclusive<f64> = 0.01..=1e6;
/// The feedback intervals that a program may choose. Receivers clamp other ones.
pub(super) const FEEDBACK_INTERVAL: RangeInclusive<Duration> =
    Duration::from_millis(200)..=Duration::from_secs(10);

const ALLOWED_FRAMES_PER_S: &str = "0.01 to 1000000 frames per second";

/// The options of a stream.
///
/// ```
/// use rect_core::stream::sender::Options;
/// let options = Options {
///     max_frames_per_s: 30.0,
///     ..Options::default()
/// };
/// assert_eq!(options.min_frames_per_s, 5.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Whether quality, size and rate adapt to the links. Default: adaptive.
    pub mode: Mode,
    /// Minimum frame rate in frames per second, 0.01 to 1,000,000: the target of the smallest step. If a link is too slow even
    /// for that step, the rate is lower. If this exceeds the maximum, the maximum is used. Default: 5.
    pub min_frames_per_s: f64,
    /// Maximum frame rate in frames per second, 0.01 to 1,000,000. Default: 15.
    pub max_frames_per_s: f64,
    /// Limits of the data rate.
    pub rates: RateLimits,
    /// Format of pictures that are compressed with a quality. Default: JPEG.
    pub lossy_format: LossyFormat,
    /// Steps of the ladder, best first. Empty (the default) for [`super::ladder::PICTURES`].
    pub steps: Vec<Step>,
    /// Interval at which receivers send feedback (20 to 30 bytes), 0.2 to 10 s; zero for no feedback. Default: 500 ms.
    pub feedback_interval: Duration,
}

/// Whether frames adapt to the links.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Frames are sent as the program supplies them.
    Fixed,
    /// Frames have the best quality that the links permit. The default.
    #[default]
    Adaptive,
    /// Pictures are encoded as video. Frames that are not pictures adapt to the links as in the other mode.
    Video,
}

impl Mode {
    /// Returns whether frames adapt to the links.
    pub fn is_adaptive(self) -> bool {
        self != Self::Fixed
    }
}

/// A named set of options, from which a program starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// [`Options::default`]: pictures adapt to the links. The default.
    #[default]
    Adaptive,
    /// [`Options::video`]: pictures are sent as video.
    Video,
    /// [`Options::fixed`]: frames are sent unchanged, at a limited rate.
    Fixed,
    /// [`Options::sensor`]: values are sent unchanged, as often as they come.
    Sensor,
}

/// The options as the programs of other languages specify them: a preset, and the options that differ from it.
///
/// ```
/// use rect_core::stream::options::{PartialOptions, Preset};
/// let options = PartialOptions { preset: Preset::Fixed, max_bytes_per_s: Some(50e3), ..PartialOptions::default() };
/// assert_eq!(options.complete()?.rates.max_bytes_per_s, 50e3);
/// let options = PartialOptions { max_frames_per_s: Some(-1.0), ..options };
/// assert_eq!(
///     options.complete().unwrap_err().to_string(),
///     "the option max_frames_per_s cannot be -1: it must be 0.01 to 1000000 frames per second",
/// );
/// # Ok::<(), rect_core::stream::options::OptionError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartialOptions {
    /// The preset that supplies all other options.
    pub preset: Preset,
    /// [`Options::max_frames_per_s`].
    pub max_frames_per_s: Option<f64>,
    /// [`Options::min_frames_per_s`].
    pub min_frames_per_s: Option<f64>,
    /// [`RateLimits::max_bytes_per_s`].
    pub max_bytes_per_s: Option<f64>,
    /// [`Options::feedback_interval`], in seconds.
    pub feedback_interval_s: Option<f64>,
    /// [`Options::lossy_format`].
    pub lossy_format: LossyFormat,
}

/// An option of a stream that has a value outside its range. Choose one of the allowed values.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the option {option} cannot be {value}: it must be {allowed}")]
pub struct OptionError {
    /// The name of the option, such as `max_frames_per_s`.
    pub option: &'static str,
    /// The rejected value.
    pub value: String,
    /// The values that are allowed, such as "0.01 to 1000000 frames per second".
    pub allowed: &'static str,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            mode: Mode::Adaptive,
            min_frames_per_s: 5.0,
            max_frames_per_s: 15.0,
            rates: RateLimits::default(),
            lossy_format: LossyFormat::default(),
            steps: Vec::new(),
            feedback_interval: Duration::from_millis(500),
        }
    }
}

impl Options {
    /// Returns the options for pictures that are sent as video: each frame contains only what differs from the one before.
    /// Receivers without a decoder get pictures as in an adaptive stream.
    pub fn video() -> Self {
        Self {
            mode: Mode::Video,
            ..Self::default()
        }
    }

    /// Returns the options for frames that are sent unchanged, at most `max_frames_per_s` per second.
    pub fn fixed(max_frames_per_s: f64) -> Self {
        Self {
            mode: Mode::Fixed,
            max_frames_per_s,
            feedback_interval: Duration::from_secs(2),
            ..Self::default()
        }
    }

    /// Returns the options for sensor values: sent unchanged, without a maximum rate, and without feedback.
    pub fn sensor() -> Self {
        Self {
            feedback_interval: Duration::ZERO,
            ..Self::fixed(1e6)
        }
    }
    /// Checks that each value is in its range.
    ///
    /// # Errors
    /// Returns the first option that is out of range, with its value and the values that are allowed.
    pub fn check(&self) -> Result<(), OptionError> {
        let rates = &self.rates;
        for (option, frames_per_s) in [
            ("max_frames_per_s", self.max_frames_per_s),
            ("min_frames_per_s", self.min_frames_per_s),
        ] {
            if !FRAMES_PER_S.contains(&frames_per_s) {
                return Err(OptionError::new(option, frames_per_s, ALLOWED_FRAMES_PER_S));
            }
        }
        for (option, bytes_per_s) in [
            ("max_bytes_per_s", rates.max_bytes_per_s),
            ("initial_bytes_per_s", rates.initial_bytes_per_s),
            ("min_bytes_per_s", rates.min_bytes_per_s),
        ] {
            if !(bytes_per_s.is_finite() && bytes_per_s >= 1.0) {
                let allowed = "a number of bytes per second, 1 or more";
                return Err(OptionError::new(option, bytes_per_s, allowed));
            }
        }
        let interval = self.feedback_interval;
        if !interval.is_zero() && !FEEDBACK_INTERVAL.contains(&interval) {
            return Err(interval_error(interval.as_secs_f64()));
        }
        Ok(())
    }
}

impl PartialOptions {
    /// Completes the options with those of the preset, and checks them.
    ///
    /// # Errors
    /// Returns the same errors as [`Options::check`].
    pub fn complete(&self) -> Result<Options, OptionError> {
        let preset = match self.preset {
            Preset::Adaptive => Options::default(),
            Preset::Video => Options::video(),
            Preset::Fixed => Options::fixed(Options::default().max_frames_per_s),
            Preset::Sensor => Options::sensor(),
        };
        let max_bytes_per_s = self.max_bytes_per_s.unwrap_or(preset.rates.max_bytes_per_s);
        let feedback_interval = match self.feedback_interval_s {
            Some(seconds) => {
                Duration::try_from_secs_f64(seconds).map_err(|_| interval_error(seconds))?
            }
            None => preset.feedback_interval,
        };
        let options = Options {
            max_frames_per_s: self.max_frames_per_s.unwrap_or(preset.max_frames_per_s),
            min_frames_per_s: self.min_frames_per_s.unwrap_or(preset.min_frames_per_s),
            rates: RateLimits {
                max_bytes_per_s,
                ..preset.rates
            },
            feedback_interval,
            lossy_format: self.lossy_format,
            ..preset
        };
        options.check()?;
        Ok(options)
    }
}

impl FromStr for Preset {
    type Err = OptionError;

    fn from_str(name: &str) -> Result<Self, OptionError> {
        match name {
            "adaptive" => Ok(Self::Adaptive),
            "video" => Ok(Self::Video),
            "fixed" => Ok(Self::Fixed),
            "sensor" => Ok(Self::Sensor),
            _ => {
                let allowed = "\"adaptive\", \"video\", \"fixed\" or \"sensor\"";
                Err(OptionError::new("mode", name, allowed))
            }
        }
    }
}

impl OptionError {
    fn new(option: &'static str, value: impl fmt::Display, allowed: &'static str) -> Self {
        let value = value.to_string();
        Self {
            option,
            value,
            allowed,
        }
    }

    /// Returns the reason why the value is rejected: "it must be ...".
    pub fn reason(&self) -> String {
        format!("it must be {}", self.allowed)
    }
}

fn interval_error(seconds: f64) -> OptionError {
    let allowed = "0 (no feedback), or 0.2 to 10 seconds";
    OptionError::new("feedback_interval", seconds, allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rejected(options: PartialOptions) -> (&'static str, String) {
        let error = options.complete().expect_err("an option out of range");
        (error.option, error.value)
    }

    #[test]
    fn rejects_values_out_of_range_and_names_the_option() {
        let none = PartialOptions::default();
        for number in [0.0, -1.0, 2e6, f64::NAN, f64::INFINITY] {
            let value = number.to_string();
            let max_frames_per_s = Some(number);
            let max = PartialOptions {
                max_frames_per_s,
                ..none
            };
            assert_eq!(rejected(max), ("max_frames_per_s", value.clone()));
            let min_frames_per_s = Some(number);
            let min = PartialOptions {
                min_frames_per_s,
                ..none
            };
            assert_eq!(rejected(min), ("min_frames_per_s", value));
        }
        for number in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let max_bytes_per_s = Some(number);
            let max = PartialOptions {
                max_bytes_per_s,
                ..none
            };
            assert_eq!(rejected(max), ("max_bytes_per_s", number.to_string()));
        }
        for seconds in [0.1, -1.0, 10.5, 1e300, f64::NAN, f64::INFINITY] {
            let feedback_interval_s = Some(seconds);
            let interval = PartialOptions {
                feedback_interval_s,
                ..none
            };
            assert_eq!(
                rejected(interval),
                ("feedback_interval", seconds.to_string())
            );
        }
    }

    #[test]
    fn options_that_are_not_specified_are_those_of_the_preset() {
        for (preset, options) in [
            (Preset::Adaptive, Options::default()),
            (Preset::Video, Options::video()),
            (Preset::Fixed, Options::fixed(15.0)),
            (Preset::Sensor, Options::sensor()),
        ] {
            let none = PartialOptions {
                preset,
                ..PartialOptions::default()
            };
            assert_eq!(none.complete(), Ok(options.clone()));
            let all = PartialOptions {
                preset,
                max_frames_per_s: Some(2.0),
                min_frames_per_s: Some(1.0),
                max_bytes_per_s: Some(1000.0),
                feedback_interval_s: Some(0.0),
                lossy_format: LossyFormat::Webp,
            };
            let rates = RateLimits {
                max_bytes_per_s: 1000.0,
                ..RateLimits::default()
            };
            let expected = Options {
                max_frames_per_s: 2.0,
                min_frames_per_s: 1.0,
                rates,
                feedback_interval: Duration::ZERO,
                lossy_format: LossyFormat::Webp,
                ..options
            };
            assert_eq!(all.complete(), Ok(expected));
        }
    }

    #[test]
    fn presets_have_names() {
        assert_eq!("sensor".parse(), Ok(Preset::Sensor));
        assert_eq!(
            "film"
                .parse::<Preset>()
                .expect_err("no preset")
                .to_string(),
            "the option mode cannot be film: it must be \"adaptive\", \"video\", \"fixed\" or \"sensor\""
        );
    }
}

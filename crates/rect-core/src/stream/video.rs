//! Decides how a group's pictures are encoded as video: at which rate and size, and when there is a key frame.
use std::time::{Duration, Instant};

use crate::video::Settings;

/// The share of the group's rate that the video uses. The rest is for frames that turn out larger.
const SHARE: f64 = 0.9;
/// The rate for a pixel, in bytes, below which a smaller picture looks better, and above which a larger one does.
const SMALLER_BELOW: f64 = 0.0025;
/// See [`SMALLER_BELOW`].
const LARGER_ABOVE: f64 = 0.0035;
/// How long the rate must allow a larger picture. Doubled each time that a larger one did not last.
const LARGER_AFTER: Duration = Duration::from_secs(3);
const MAX_LARGER_AFTER: Duration = Duration::from_secs(60);
/// Frames that exceed their share by this factor, for this long, show that the scene does not fit.
const OVERSIZE: f64 = 1.4;
const OVERSIZE_FOR: Duration = Duration::from_secs(1);
/// The weight of a new frame in the mean size.
const WEIGHT: f64 = 0.1;
/// The shortest time between two key frames, however many receivers ask for one.
const KEY_PAUSE: Duration = Duration::from_millis(500);
/// The longest one: for programs that cannot ask, such as recorders and stock Zenoh programs.
const KEY_INTERVAL: Duration = Duration::from_secs(10);

/// The video of one group.
#[derive(Clone, Debug)]
pub struct Video {
    quarters: u8,
    mean_bytes: Option<f64>,
    oversize_since: Option<Instant>,
    room_since: Option<Instant>,
    larger_after: Duration,
    enlarged_at: Option<Instant>,
    wants_key: bool,
    key_at: Option<Instant>,
    key_frames: u64,
    settings: Option<Settings>,
}

impl Default for Video {
    fn default() -> Self {
        Self {
            quarters: 4,
            mean_bytes: None,
            oversize_since: None,
            room_since: None,
            larger_after: LARGER_AFTER,
            enlarged_at: None,
            wants_key: true,
            key_at: None,
            key_frames: 0,
            settings: None,
        }
    }
}

impl Video {
    /// Handles that a receiver needs a key frame.
    pub fn ask_for_key(&mut self) {
        self.wants_key = true;
    }

    /// Handles that nobody receives the video, or that it was sent in another form: it begins again with a key frame.
    pub fn pause(&mut self) {
        self.settings = None;
        self.wants_key = true;
        self.oversize_since = None;
        self.room_since = None;
    }

    /// Returns the settings of the last frame, and how many key frames there were.
    pub fn status(&self) -> Option<(Settings, u64)> {
        Some((self.settings?, self.key_frames))
    }

    /// Returns the settings of the next frame, of `pixels` pixels, for a rate of the group in bytes per second.
    pub fn next(
        &mut self,
        pixels: usize,
        bytes_per_s: f64,
        frames_per_s: f64,
        now: Instant,
    ) -> Settings {
        let bytes_per_s = bytes_per_s * SHARE;
        self.fit(pixels as f64, bytes_per_s, frames_per_s, now);
        let since_key = self.key_at.map(|at| now.saturating_duration_since(at));
        let is_key = match since_key {
            None => true,
            Some(passed) => passed >= KEY_INTERVAL || (self.wants_key && passed >= KEY_PAUSE),
        };
        Settings {
            bytes_per_s,
            frames_per_s,
            quarters: self.quarters,
            is_key,
        }
    }

    /// Handles a frame that was encoded.
    pub fn on_encoded(&mut self, settings: Settings, bytes: usize, is_key: bool, now: Instant) {
        self.settings = Some(settings);
        if is_key {
            self.wants_key = false;
            self.key_at = Some(now);
            self.key_frames += 1;
            return;
        }
        let bytes = bytes as f64;
        let mean = self
            .mean_bytes
            .map_or(bytes, |mean| mean + (bytes - mean) * WEIGHT);
        self.mean_bytes = Some(mean);
        let share = settings.bytes_per_s / settings.frames_per_s;
        self.oversize_since = match mean > share * OVERSIZE {
            true => self.oversize_since.or(Some(now)),
            false => None,
        };
    }

    /// Chooses the size.
    fn fit(&mut self, pixels: f64, bytes_per_s: f64, frames_per_s: f64, now: Instant) {
        let for_pixel = |quarters: u8| {
            let share = (f64::from(quarters) / 4.0).powi(2);
            bytes_per_s / frames_per_s / (pixels * share).max(1.0)
        };
        let lasts = |since: Option<Instant>, time| {
            since.is_some_and(|since| now.saturating_duration_since(since) >= time)
        };
        let is_oversize = lasts(self.oversize_since, OVERSIZE_FOR);
        if self.quarters > 1 && (for_pixel(self.quarters) < SMALLER_BELOW || is_oversize) {
            let lasted = lasts(self.enlarged_at, self.larger_after * 2);
            self.larger_after = match self.enlarged_at {
                Some(_) if !lasted => (self.larger_after * 2).min(MAX_LARGER_AFTER),
                _ if is_oversize => self.larger_after.max(LARGER_AFTER * 2),
                _ => LARGER_AFTER,
            };
            self.resize(self.quarters - 1);
            return;
        }
        let has_room = self.quarters < 4
            && for_pixel(self.quarters + 1) > LARGER_ABOVE
            && self.oversize_since.is_none();
        self.room_since = has_room.then(|| self.room_since.unwrap_or(now));
        if lasts(self.room_since, self.larger_after) {
            self.resize(self.quarters + 1);
            self.enlarged_at = Some(now);
        }
    }

    fn resize(&mut self, quarters: u8) {
        self.quarters = quarters;
        self.mean_bytes = None;
        self.oversize_since = None;
        self.room_since = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VGA: usize = 640 * 480;

    /// Encodes 15 frames per second, whose size is the given multiple of their share, and returns the sizes of the picture and
    /// the number of key frames.
    fn run(
        video: &mut Video,
        now: &mut Instant,
        seconds: u32,
        bytes_per_s: f64,
        size: impl Fn(Settings) -> f64,
    ) -> (Vec<u8>, usize) {
        let (mut quarters, mut keys) = (Vec::new(), 0);
        for _ in 0..seconds * 15 {
            *now += Duration::from_secs(1) / 15;
            let next = video.next(VGA, bytes_per_s, 15.0, *now);
            keys += usize::from(next.is_key);
            let bytes = next.bytes_per_s / 15.0 * size(next);
            video.on_encoded(next, bytes as usize, next.is_key, *now);
            if quarters.last() != Some(&next.quarters) {
                quarters.push(next.quarters);
            }
        }
        (quarters, keys)
    }

    #[test]
    fn the_size_follows_the_rate() {
        let (mut video, mut now) = (Video::default(), Instant::now());
        let fits = |_: Settings| 1.0;
        assert_eq!(run(&mut video, &mut now, 20, 28e3, fits).0, [4]);
        assert_eq!(run(&mut video, &mut now, 20, 8e3, fits).0, [3]);
        assert_eq!(run(&mut video, &mut now, 20, 2e3, fits).0, [2, 1]);
        assert_eq!(run(&mut video, &mut now, 20, 28e3, fits).0, [1, 2, 3, 4]);
    }

    #[test]
    fn a_scene_that_does_not_fit_gets_smaller_and_is_tried_again_less_and_less_often() {
        let (mut video, mut now) = (Video::default(), Instant::now());
        // Only half of the width and height fits.
        let complex = |settings: Settings| if settings.quarters > 2 { 2.0 } else { 1.0 };
        let (first, _) = run(&mut video, &mut now, 60, 28e3, complex);
        assert!(first.starts_with(&[4, 3, 2]), "{first:?}");
        run(&mut video, &mut now, 120, 28e3, complex);
        let (later, _) = run(&mut video, &mut now, 60, 28e3, complex);
        assert!(later.len() <= 4, "{later:?}");
    }

    #[test]
    fn key_frames_come_on_request_and_every_ten_seconds() {
        let (mut video, mut now) = (Video::default(), Instant::now());
        let fits = |_: Settings| 1.0;
        assert_eq!(run(&mut video, &mut now, 21, 28e3, fits).1, 3);
        let mut keys = 0;
        for _ in 0..30 {
            // Ten receivers ask again and again.
            for _ in 0..10 {
                video.ask_for_key();
            }
            keys += run(&mut video, &mut now, 1, 28e3, fits).1;
        }
        assert!((28..=60).contains(&keys), "{keys}");
        video.pause();
        now += KEY_PAUSE;
        assert!(video.next(VGA, 28e3, 15.0, now).is_key);
    }
}

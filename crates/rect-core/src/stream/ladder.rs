//! Chooses the step for a rate. The steps form a ladder from a lossless picture down to a small one of low quality.
//!
//! The size of a step's frames is measured while the step is in use, and remembered for 30 s. The sizes of the other
//! steps are extrapolated. The step changes only for a lasting reason: see [`Reason`].
use std::{
    fmt,
    time::{Duration, Instant},
};

/// How long a measured size is remembered. Pictures change.
const MEMORY: Duration = Duration::from_secs(30);
/// The weight of a new frame in the measured size.
const WEIGHT: f64 = 0.3;
/// A better step is taken if the rate has exceeded its needs by this factor, for this long.
const HEADROOM: f64 = 1.2;
const HEADROOM_FOR: Duration = Duration::from_secs(2);
/// A step is left if its needs have exceeded the rate by this factor, for this long.
const CONGESTION: f64 = 1.15;
const CONGESTION_FOR: Duration = Duration::from_millis(700);

/// The compression of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Coding {
    /// Lossless compression.
    Lossless,
    /// Lossy compression with a quality of 1 to 100.
    Lossy(u8),
}

/// A step of the ladder: the compression of a frame, and its size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Step {
    /// Compression.
    pub coding: Coding,
    /// Width and height in quarters of the original: 4 for full size, 2 for half of the width and half of the height.
    pub quarters: u8,
}

impl Step {
    const fn new(coding: Coding, quarters: u8) -> Self {
        Self { coding, quarters }
    }

    /// Returns the typical size for photographs, in bytes per pixel of the original picture.
    pub(super) fn guess(self) -> f64 {
        let share = (f64::from(self.quarters) / 4.0).powi(2);
        let per_pixel = match self.coding {
            Coding::Lossless => 1.6,
            Coding::Lossy(quality) => {
                let quality = f64::from(quality.clamp(1, 100));
                // Like JPEG's quantisation tables: half the step size at 75, twice at 25.
                let coarse = if quality < 50.0 {
                    50.0 / quality
                } else {
                    (100.0 - quality).max(2.0) / 50.0
                };
                0.11 * coarse.powf(-0.6)
            }
        };
        // Small pictures have as many edges in fewer pixels.
        per_pixel * share * share.powf(-0.15)
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.coding {
            Coding::Lossless => f.write_str("lossless")?,
            Coding::Lossy(quality) => write!(f, "quality {quality}")?,
        }
        match self.quarters {
            4 => Ok(()),
            2 => f.write_str(" at 1/2"),
            quarters => write!(f, " at {quarters}/4"),
        }
    }
}

/// The default steps, best first. Each takes about three quarters of the bytes of the one before. According to
/// measurements on photographs (SSIM by bytes, `benches/stream.py`), below a quality of 25 the next smaller size looks
/// better for the same number of bytes.
pub const PICTURES: [Step; 16] = [
    Step::new(Coding::Lossless, 4),
    Step::new(Coding::Lossy(92), 4),
    Step::new(Coding::Lossy(85), 4),
    Step::new(Coding::Lossy(75), 4),
    Step::new(Coding::Lossy(60), 4),
    Step::new(Coding::Lossy(45), 4),
    Step::new(Coding::Lossy(32), 4),
    Step::new(Coding::Lossy(25), 4),
    Step::new(Coding::Lossy(32), 3),
    Step::new(Coding::Lossy(22), 3),
    Step::new(Coding::Lossy(45), 2),
    Step::new(Coding::Lossy(30), 2),
    Step::new(Coding::Lossy(20), 2),
    Step::new(Coding::Lossy(60), 1),
    Step::new(Coding::Lossy(35), 1),
    Step::new(Coding::Lossy(18), 1),
];

/// The reason for a change of step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// The first frame of a group that had no receivers.
    Start,
    /// The rate is higher than the step requires.
    Headroom,
    /// The rate is lower than the step requires.
    Congestion,
}

/// A change of step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Previous step.
    pub from: Step,
    /// New step.
    pub to: Step,
    /// Reason for the change.
    pub reason: Reason,
    /// Rate at that time, in bytes per second.
    pub bytes_per_s: f64,
    /// Time of the change.
    pub at: Instant,
}

#[derive(Clone, Copy, Debug)]
struct Measure {
    at: Instant,
    bytes_per_pixel: f64,
}

/// The ladder of one group.
#[derive(Clone, Debug)]
pub struct Ladder {
    steps: Vec<(Step, Option<Measure>)>,
    at: usize,
    min_frames_per_s: f64,
    max_frames_per_s: f64,
    pixels: f64,
    room_since: Option<Instant>,
    congested_since: Option<Instant>,
    last: Option<Change>,
}

impl Ladder {
    /// Creates a ladder. `steps` are ordered best first; if empty, the defaults are used. The target frame rate is
    /// `max_frames_per_s` at the best step, and decreases to `min_frames_per_s` at the last.
    pub fn new(steps: &[Step], min_frames_per_s: f64, max_frames_per_s: f64) -> Self {
        let steps = if steps.is_empty() { &PICTURES } else { steps };
        Self {
            steps: steps.iter().map(|&step| (step, None)).collect(),
            at: 0,
            min_frames_per_s: min_frames_per_s.min(max_frames_per_s),
            max_frames_per_s,
            pixels: 0.0,
            room_since: None,
            congested_since: None,
            last: None,
        }
    }

    /// Returns the step for a frame of `pixels` pixels at a rate of `bytes_per_s`.
    pub fn step(&mut self, pixels: usize, bytes_per_s: f64, now: Instant) -> Step {
        let pixels = pixels.max(1) as f64;
        if pixels != self.pixels {
            self.pixels = pixels;
            self.steps
                .iter_mut()
                .for_each(|(_, measure)| *measure = None);
            self.go(self.best(bytes_per_s, 1.0), Reason::Start, bytes_per_s, now);
        } else {
            self.reconsider(bytes_per_s, now);
        }
        self.steps[self.at].0
    }

    /// Handles the size of an encoded frame.
    pub fn on_encoded(&mut self, step: Step, bytes: usize, now: Instant) {
        let bytes_per_pixel = bytes as f64 / self.pixels.max(1.0);
        if let Some((_, measure)) = self.steps.iter_mut().find(|(known, _)| *known == step) {
            let known = measure
                .filter(|known| now.saturating_duration_since(known.at) < MEMORY)
                .map_or(bytes_per_pixel, |known| known.bytes_per_pixel);
            *measure = Some(Measure {
                at: now,
                bytes_per_pixel: known + (bytes_per_pixel - known) * WEIGHT,
            });
        }
    }

    /// Resets the ladder, because the group has no receivers any more.
    pub fn forget(&mut self) {
        self.pixels = 0.0;
    }

    /// Returns the last change.
    pub fn last_change(&self) -> Option<&Change> {
        self.last.as_ref()
    }

    /// Returns the estimated size of a frame at the current step, in bytes.
    pub fn frame_bytes(&self) -> f64 {
        self.bytes_of(self.at)
    }

    /// Returns the rate in bytes per second that suffices for the best step, so that a higher one is of no use.
    /// Infinite before the first frame.
    pub fn max_useful_bytes_per_s(&self) -> f64 {
        if self.pixels > 0.0 {
            self.needs(0) * HEADROOM
        } else {
            f64::INFINITY
        }
    }

    fn reconsider(&mut self, bytes_per_s: f64, now: Instant) {
        let better = self.best(bytes_per_s, HEADROOM);
        let is_congested =
            self.needs(self.at) > bytes_per_s * CONGESTION && self.at + 1 < self.steps.len();
        self.room_since = (better < self.at).then(|| self.room_since.unwrap_or(now));
        self.congested_since = is_congested.then(|| self.congested_since.unwrap_or(now));
        let lasts = |since: Option<Instant>, duration: Duration| {
            since.is_some_and(|since| now.saturating_duration_since(since) >= duration)
        };
        if lasts(self.congested_since, CONGESTION_FOR) {
            let worse = self.best(bytes_per_s, 1.0).max(self.at + 1);
            self.go(worse, Reason::Congestion, bytes_per_s, now);
        } else if lasts(self.room_since, HEADROOM_FOR) {
            self.go(better, Reason::Headroom, bytes_per_s, now);
        }
    }

    fn go(&mut self, to: usize, reason: Reason, bytes_per_s: f64, now: Instant) {
        self.last = Some(Change {
            from: self.steps[self.at].0,
            to: self.steps[to].0,
            reason,
            bytes_per_s,
            at: now,
        });
        self.at = to;
        self.room_since = None;
        self.congested_since = None;
    }

    /// Returns the best step whose needs, multiplied by `room`, do not exceed the rate.
    fn best(&self, bytes_per_s: f64, room: f64) -> usize {
        (0..self.steps.len())
            .find(|&index| self.needs(index) * room <= bytes_per_s)
            .unwrap_or(self.steps.len() - 1)
    }

    /// Returns the rate that a step requires at its target frame rate.
    fn needs(&self, index: usize) -> f64 {
        let down = index as f64 / (self.steps.len() - 1).max(1) as f64;
        let share = (self.min_frames_per_s / self.max_frames_per_s).powf(down);
        self.bytes_of(index) * self.max_frames_per_s * share
    }

    fn bytes_of(&self, index: usize) -> f64 {
        let (step, measure) = self.steps[index];
        let is_known = |measure: &&Measure| match self.steps[self.at].1 {
            Some(newest) => newest.at.saturating_duration_since(measure.at) < MEMORY,
            None => true,
        };
        if let Some(measure) = measure.as_ref().filter(is_known) {
            return measure.bytes_per_pixel * self.pixels;
        }
        let (here, measured) = self.steps[self.at];
        let scene = measured.map_or(1.0, |measure| measure.bytes_per_pixel / here.guess());
        step.guess() * scene * self.pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 320 * 240;

    fn ladder() -> Ladder {
        Ladder::new(&[], 5.0, 15.0)
    }

    /// Encodes frames for some time, each `times` the estimated size, and returns the steps that were used.
    fn run(
        ladder: &mut Ladder,
        now: &mut Instant,
        seconds: u32,
        times: f64,
        bytes_per_s: f64,
    ) -> Vec<Step> {
        let mut taken = Vec::new();
        for _ in 0..seconds * 10 {
            *now += Duration::from_millis(100);
            let step = ladder.step(PIXELS, bytes_per_s, *now);
            if taken.last() != Some(&step) {
                taken.push(step);
            }
            let bytes = step.guess() * PIXELS as f64 * times;
            ladder.on_encoded(step, bytes as usize, *now);
        }
        taken
    }

    #[test]
    fn each_step_needs_less_than_the_one_above() {
        let guesses = PICTURES.map(Step::guess);
        assert!(guesses.is_sorted_by(|a, b| a > b), "{guesses:?}");
    }

    #[test]
    fn fast_links_get_lossless_frames_and_slow_ones_small_frames() {
        let mut now = Instant::now();
        let (mut fast, mut slow) = (ladder(), ladder());
        assert_eq!(run(&mut fast, &mut now, 5, 1.0, 5e6), [PICTURES[0]]);
        let taken = run(&mut slow, &mut now, 5, 1.0, 29e3);
        assert!(taken.len() == 1 && taken[0].quarters < 4, "{taken:?}");
        let tiny = run(&mut ladder(), &mut now, 5, 1.0, 100.0);
        assert_eq!(tiny, [PICTURES[15]]);
    }

    #[test]
    fn learns_the_size_of_a_step_and_then_keeps_the_step() {
        for times in [0.3, 0.6, 1.5, 3.0] {
            let (mut ladder, mut now) = (ladder(), Instant::now());
            let taken = run(&mut ladder, &mut now, 20, times, 60e3);
            assert!(taken.len() <= 4, "{times}: {taken:?}");
            assert_eq!(
                run(&mut ladder, &mut now, 120, times, 60e3).len(),
                1,
                "{times}"
            );
            let needs = ladder.needs(ladder.at);
            assert!(needs <= 60e3 * CONGESTION, "{times}: {needs}");
        }
    }

    #[test]
    fn small_variations_of_the_rate_do_not_change_the_step() {
        let (mut ladder, mut now) = (ladder(), Instant::now());
        run(&mut ladder, &mut now, 20, 1.0, 60e3);
        for _ in 0..20 {
            assert_eq!(run(&mut ladder, &mut now, 3, 1.0, 57e3).len(), 1);
            assert_eq!(run(&mut ladder, &mut now, 3, 1.0, 63e3).len(), 1);
        }
    }

    #[test]
    fn the_step_changes_only_for_a_lasting_reason() {
        let (mut ladder, mut now) = (ladder(), Instant::now());
        run(&mut ladder, &mut now, 20, 1.0, 60e3);
        let before = ladder.at;
        ladder.step(PIXELS, 20e3, now);
        run(&mut ladder, &mut now, 5, 1.0, 60e3);
        assert_eq!(ladder.at, before, "a short drop");
        run(&mut ladder, &mut now, 1, 1.0, 20e3);
        let change = ladder.last_change().copied().expect("a change");
        assert_eq!(
            (change.reason, ladder.at > before),
            (Reason::Congestion, true)
        );
        run(&mut ladder, &mut now, 3, 1.0, 80e3);
        assert_eq!(
            ladder.last_change().map(|change| change.reason),
            Some(Reason::Headroom)
        );
    }
}

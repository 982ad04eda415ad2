//! Owns the steps from a lossless picture down to a small coarse one, and which of them is for a rate.
//!
//! What a step's frames take is measured while it is in use, and remembered for half a minute; of the others it is guessed
//! from those that are measured. A step is left only for a reason that lasts: see [`Why`].
use std::{
    fmt,
    time::{Duration, Instant},
};

/// How long what a step took is remembered: the picture changes.
const MEMORY: Duration = Duration::from_secs(30);
/// How much of a step's measure one frame makes.
const WEIGHT: f64 = 0.3;
/// A better step is taken when it needs so much less than there is, for so long.
const ROOM: f64 = 1.2;
const ROOM_FOR: Duration = Duration::from_secs(2);
/// A step is left when it needs so much more than there is, for so long.
const TIGHT: f64 = 1.15;
const TIGHT_FOR: Duration = Duration::from_millis(700);

/// How a frame is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Coding {
    /// Nothing is lost.
    Lossless,
    /// As a photograph, with a quality of 1 to 100.
    Lossy(u8),
}

/// A step: how a frame is written, and how large.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Level {
    /// How.
    pub coding: Coding,
    /// Of its width and its height, in quarters: 4 is the whole, 2 half as wide and half as high.
    pub quarters: u8,
}

impl Level {
    const fn new(coding: Coding, quarters: u8) -> Self {
        Self { coding, quarters }
    }

    /// About as much as photographs take, in bytes per pixel of the whole picture.
    pub(super) fn guess(self) -> f64 {
        let share = (f64::from(self.quarters) / 4.0).powi(2);
        let per_pixel = match self.coding {
            Coding::Lossless => 1.6,
            Coding::Lossy(quality) => {
                let quality = f64::from(quality.clamp(1, 100));
                // As JPEG's tables go: half the steps at 75, twice at 25.
                let coarse = if quality < 50.0 {
                    50.0 / quality
                } else {
                    (100.0 - quality).max(2.0) / 50.0
                };
                0.11 * coarse.powf(-0.6)
            }
        };
        // Small pictures have as many edges on fewer pixels.
        per_pixel * share * share.powf(-0.15)
    }
}

impl fmt::Display for Level {
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

/// The usual steps, from best to least; each needs about three quarters of the one above. Measured on photographs
/// (SSIM by bytes, `benches/stream.py`): below a quality of 25, the next smaller size looks better for the same bytes.
pub const PICTURES: [Level; 16] = [
    Level::new(Coding::Lossless, 4),
    Level::new(Coding::Lossy(92), 4),
    Level::new(Coding::Lossy(85), 4),
    Level::new(Coding::Lossy(75), 4),
    Level::new(Coding::Lossy(60), 4),
    Level::new(Coding::Lossy(45), 4),
    Level::new(Coding::Lossy(32), 4),
    Level::new(Coding::Lossy(25), 4),
    Level::new(Coding::Lossy(32), 3),
    Level::new(Coding::Lossy(22), 3),
    Level::new(Coding::Lossy(45), 2),
    Level::new(Coding::Lossy(30), 2),
    Level::new(Coding::Lossy(20), 2),
    Level::new(Coding::Lossy(60), 1),
    Level::new(Coding::Lossy(35), 1),
    Level::new(Coding::Lossy(18), 1),
];

/// Why another step was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Why {
    /// Frames begin, of a group that had none.
    Begins,
    /// More gets through than the step needs.
    Room,
    /// Less gets through than the step needs.
    Tight,
}

/// A change of step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// From.
    pub from: Level,
    /// To.
    pub to: Level,
    /// The reason.
    pub why: Why,
    /// What there was then, in bytes per second.
    pub bytes_per_s: f64,
    /// When.
    pub at: Instant,
}

#[derive(Clone, Copy, Debug)]
struct Measure {
    at: Instant,
    bytes_per_pixel: f64,
}

/// One group's.
#[derive(Clone, Debug)]
pub struct Ladder {
    steps: Vec<(Level, Option<Measure>)>,
    at: usize,
    least_frames_per_s: f64,
    most_frames_per_s: f64,
    pixels: f64,
    room_since: Option<Instant>,
    tight_since: Option<Instant>,
    last: Option<Change>,
}

impl Ladder {
    /// With these steps, best first; at the top as many frames are wanted as `most_frames_per_s`, and fewer further down.
    /// Without steps, the usual.
    pub fn new(steps: &[Level], least_frames_per_s: f64, most_frames_per_s: f64) -> Self {
        let steps = if steps.is_empty() { &PICTURES } else { steps };
        Self {
            steps: steps.iter().map(|&level| (level, None)).collect(),
            at: 0,
            least_frames_per_s: least_frames_per_s.min(most_frames_per_s),
            most_frames_per_s,
            pixels: 0.0,
            room_since: None,
            tight_since: None,
            last: None,
        }
    }

    /// The step for a frame of so many pixels, when there is so much to send with.
    pub fn level(&mut self, pixels: usize, bytes_per_s: f64, now: Instant) -> Level {
        let pixels = pixels.max(1) as f64;
        if pixels != self.pixels {
            self.pixels = pixels;
            self.steps
                .iter_mut()
                .for_each(|(_, measure)| *measure = None);
            self.go(self.best(bytes_per_s, 1.0), Why::Begins, bytes_per_s, now);
        } else {
            self.reconsider(bytes_per_s, now);
        }
        self.steps[self.at].0
    }

    /// What the frame became.
    pub fn on_encoded(&mut self, level: Level, bytes: usize, now: Instant) {
        let bytes_per_pixel = bytes as f64 / self.pixels.max(1.0);
        if let Some((_, measure)) = self.steps.iter_mut().find(|(step, _)| *step == level) {
            let known = measure
                .filter(|known| now.saturating_duration_since(known.at) < MEMORY)
                .map_or(bytes_per_pixel, |known| known.bytes_per_pixel);
            *measure = Some(Measure {
                at: now,
                bytes_per_pixel: known + (bytes_per_pixel - known) * WEIGHT,
            });
        }
    }

    /// The group has nobody any more: the next frame begins anew.
    pub fn forget(&mut self) {
        self.pixels = 0.0;
    }

    /// The last change.
    pub fn last_change(&self) -> Option<&Change> {
        self.last.as_ref()
    }

    /// About what a frame takes now, in bytes.
    pub fn frame_bytes(&self) -> f64 {
        self.bytes_of(self.at)
    }

    /// What the best step needs, in bytes per second: more is of no use.
    pub fn most_bytes_per_s(&self) -> f64 {
        if self.pixels > 0.0 {
            self.needs(0) * ROOM
        } else {
            f64::INFINITY
        }
    }

    fn reconsider(&mut self, bytes_per_s: f64, now: Instant) {
        let better = self.best(bytes_per_s, ROOM);
        let is_tight = self.needs(self.at) > bytes_per_s * TIGHT && self.at + 1 < self.steps.len();
        self.room_since = (better < self.at).then(|| self.room_since.unwrap_or(now));
        self.tight_since = is_tight.then(|| self.tight_since.unwrap_or(now));
        let lasts = |since: Option<Instant>, so_long: Duration| {
            since.is_some_and(|since| now.saturating_duration_since(since) >= so_long)
        };
        if lasts(self.tight_since, TIGHT_FOR) {
            let worse = self.best(bytes_per_s, 1.0).max(self.at + 1);
            self.go(worse, Why::Tight, bytes_per_s, now);
        } else if lasts(self.room_since, ROOM_FOR) {
            self.go(better, Why::Room, bytes_per_s, now);
        }
    }

    fn go(&mut self, to: usize, why: Why, bytes_per_s: f64, now: Instant) {
        self.last = Some(Change {
            from: self.steps[self.at].0,
            to: self.steps[to].0,
            why,
            bytes_per_s,
            at: now,
        });
        self.at = to;
        self.room_since = None;
        self.tight_since = None;
    }

    /// The best step that needs less than there is, `room` times.
    fn best(&self, bytes_per_s: f64, room: f64) -> usize {
        (0..self.steps.len())
            .find(|&step| self.needs(step) * room <= bytes_per_s)
            .unwrap_or(self.steps.len() - 1)
    }

    /// Bytes per second of a step with as many frames as are wanted of it.
    fn needs(&self, step: usize) -> f64 {
        let down = step as f64 / (self.steps.len() - 1).max(1) as f64;
        let few = (self.least_frames_per_s / self.most_frames_per_s).powf(down);
        self.bytes_of(step) * self.most_frames_per_s * few
    }

    fn bytes_of(&self, step: usize) -> f64 {
        let (level, measure) = self.steps[step];
        let is_known = |measure: &&Measure| match self.steps[self.at].1 {
            Some(newest) => newest.at.saturating_duration_since(measure.at) < MEMORY,
            None => true,
        };
        if let Some(measure) = measure.as_ref().filter(is_known) {
            return measure.bytes_per_pixel * self.pixels;
        }
        let (here, measured) = self.steps[self.at];
        let scene = measured.map_or(1.0, |measure| measure.bytes_per_pixel / here.guess());
        level.guess() * scene * self.pixels
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXELS: usize = 320 * 240;

    fn ladder() -> Ladder {
        Ladder::new(&[], 5.0, 15.0)
    }

    /// Frames for so long, each of `times` what is guessed; the steps that were taken.
    fn run(
        ladder: &mut Ladder,
        now: &mut Instant,
        seconds: u32,
        times: f64,
        bytes_per_s: f64,
    ) -> Vec<Level> {
        let mut taken = Vec::new();
        for _ in 0..seconds * 10 {
            *now += Duration::from_millis(100);
            let level = ladder.level(PIXELS, bytes_per_s, *now);
            if taken.last() != Some(&level) {
                taken.push(level);
            }
            let bytes = level.guess() * PIXELS as f64 * times;
            ladder.on_encoded(level, bytes as usize, *now);
        }
        taken
    }

    #[test]
    fn each_step_needs_less_than_the_one_above() {
        let guesses = PICTURES.map(Level::guess);
        assert!(guesses.is_sorted_by(|a, b| a > b), "{guesses:?}");
    }

    #[test]
    fn a_fast_link_gets_it_lossless_and_a_slow_one_small() {
        let mut now = Instant::now();
        let (mut fast, mut slow) = (ladder(), ladder());
        assert_eq!(run(&mut fast, &mut now, 5, 1.0, 5e6), [PICTURES[0]]);
        let taken = run(&mut slow, &mut now, 5, 1.0, 29e3);
        assert!(taken.len() == 1 && taken[0].quarters < 4, "{taken:?}");
        let tiny = run(&mut ladder(), &mut now, 5, 1.0, 100.0);
        assert_eq!(tiny, [PICTURES[15]]);
    }

    #[test]
    fn what_a_step_really_takes_is_learnt_and_then_it_stays() {
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
            assert!(needs <= 60e3 * TIGHT, "{times}: {needs}");
        }
    }

    #[test]
    fn a_rate_that_sways_by_a_tenth_changes_nothing() {
        let (mut ladder, mut now) = (ladder(), Instant::now());
        run(&mut ladder, &mut now, 20, 1.0, 60e3);
        for _ in 0..20 {
            assert_eq!(run(&mut ladder, &mut now, 3, 1.0, 57e3).len(), 1);
            assert_eq!(run(&mut ladder, &mut now, 3, 1.0, 63e3).len(), 1);
        }
    }

    #[test]
    fn a_step_is_left_for_a_reason_that_lasts() {
        let (mut ladder, mut now) = (ladder(), Instant::now());
        run(&mut ladder, &mut now, 20, 1.0, 60e3);
        let before = ladder.at;
        ladder.level(PIXELS, 20e3, now);
        run(&mut ladder, &mut now, 5, 1.0, 60e3);
        assert_eq!(ladder.at, before, "a moment");
        run(&mut ladder, &mut now, 1, 1.0, 20e3);
        let change = ladder.last_change().copied().expect("one");
        assert_eq!((change.why, ladder.at > before), (Why::Tight, true));
        run(&mut ladder, &mut now, 3, 1.0, 80e3);
        assert_eq!(
            ladder.last_change().map(|change| change.why),
            Some(Why::Room)
        );
    }
}

//! Owns when the next frame may go: frames are as far apart as their bytes take at the rate, and no closer than wanted.
use std::time::{Duration, Instant};

/// One group's.
#[derive(Clone, Debug, Default)]
pub struct Pacer {
    due: Option<Instant>,
}

impl Pacer {
    /// Whether a frame may go. A little before its time it may, too: cameras are not exact.
    pub fn is_due(&self, frames_per_s: f64, now: Instant) -> bool {
        self.due
            .is_none_or(|due| now + gap(frames_per_s) / 8 >= due)
    }

    /// One went.
    pub fn on_sent(&mut self, bytes: usize, bytes_per_s: f64, frames_per_s: f64, now: Instant) {
        let takes = Duration::from_secs_f64((bytes as f64 / bytes_per_s.max(1.0)).min(60.0));
        let gap = gap(frames_per_s);
        // It counts from when it was due, so that a camera's own spacing costs nothing; but what was not used is gone.
        let from = self.due.map_or(now, |due| due.max(now - gap.min(SLACK)));
        self.due = Some(from + takes.max(gap));
    }
}

const SLACK: Duration = Duration::from_millis(100);

fn gap(frames_per_s: f64) -> Duration {
    Duration::from_secs_f64(1.0 / frames_per_s.clamp(0.01, 1e6))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames and bytes per second of a camera at 30 Hz.
    fn run(bytes: usize, bytes_per_s: f64, frames_per_s: f64) -> (f64, f64) {
        let start = Instant::now();
        let (mut pacer, mut frames) = (Pacer::default(), 0);
        for n in 0..900u32 {
            let now = start + Duration::from_secs(1) * n / 30;
            if pacer.is_due(frames_per_s, now) {
                pacer.on_sent(bytes, bytes_per_s, frames_per_s, now);
                frames += 1;
            }
        }
        let per_s = f64::from(frames) / 30.0;
        (per_s, per_s * bytes as f64)
    }

    #[test]
    fn the_rate_is_used_and_not_passed_whatever_the_camera_does() {
        for bytes in [500, 1000, 3000, 10_000] {
            let (_, sent) = run(bytes, 30e3, 100.0);
            let possible = 30e3_f64.min(30.0 * bytes as f64);
            assert!((0.95..1.02).contains(&(sent / possible)), "{bytes}: {sent}");
        }
    }

    #[test]
    fn there_are_no_more_frames_than_wanted() {
        for wanted in [1.0, 5.0, 12.5, 20.0, 30.0] {
            let (frames, _) = run(100, 1e9, wanted);
            assert!(
                (0.95..1.05).contains(&(frames / wanted)),
                "{wanted}: {frames}"
            );
        }
    }
}

//! Decides when the next frame may be sent: the interval between frames follows from their size and the rate, and from
//! the maximum frame rate.
use std::time::{Duration, Instant};

use super::options::FRAMES_PER_S;

/// The pacer of one group.
#[derive(Clone, Debug, Default)]
pub struct Pacer {
    due: Option<Instant>,
}

impl Pacer {
    /// Returns whether a frame may be sent. A small tolerance accommodates cameras with an irregular rate.
    pub fn is_due(&self, frames_per_s: f64, now: Instant) -> bool {
        self.due
            .is_none_or(|due| now + gap(frames_per_s) / 8 >= due)
    }

    /// Handles a frame that was sent.
    pub fn on_sent(&mut self, bytes: usize, bytes_per_s: f64, frames_per_s: f64, now: Instant) {
        let takes = Duration::from_secs_f64((bytes as f64 / bytes_per_s.max(1.0)).min(60.0));
        let gap = gap(frames_per_s);
        // The interval begins when the frame was due, so that irregular cameras do not lower the rate. Unused time is
        // lost, however.
        let from = self.due.map_or(now, |due| due.max(now - gap.min(SLACK)));
        self.due = Some(from + takes.max(gap));
    }

    /// Makes the next frame due at once: its time was computed from a rate that does not apply any more.
    pub fn forget(&mut self) {
        self.due = None;
    }
}

/// How late a frame may be, compared with the maximum frame rate, without delaying the next ones.
const SLACK: Duration = Duration::from_millis(100);

fn gap(frames_per_s: f64) -> Duration {
    Duration::from_secs_f64(1.0 / frames_per_s.clamp(*FRAMES_PER_S.start(), *FRAMES_PER_S.end()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the frames and bytes per second that are sent if a camera takes 30 pictures per second.
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
    fn uses_the_rate_without_exceeding_it() {
        for bytes in [500, 1000, 3000, 10_000] {
            let (_, sent) = run(bytes, 30e3, 100.0);
            let possible = 30e3_f64.min(30.0 * bytes as f64);
            assert!((0.95..1.02).contains(&(sent / possible)), "{bytes}: {sent}");
        }
    }

    #[test]
    fn does_not_exceed_the_frame_rate() {
        for limit in [1.0, 5.0, 12.5, 20.0, 30.0] {
            let (frames, _) = run(100, 1e9, limit);
            assert!(
                (0.95..1.05).contains(&(frames / limit)),
                "{limit}: {frames}"
            );
        }
    }
}

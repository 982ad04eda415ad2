//! Decides whether a program that has ended is started again, and when.
use std::time::Duration;

use clap::ValueEnum;

/// The pause before the first restart; each further one takes twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(60);
/// A program that has run for this long counts as sound.
pub const SOUND_AFTER: Duration = Duration::from_secs(10);

/// When a program is started again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Restart {
    /// Never
    Never,
    /// If it has failed: with another exit status than 0, or by a signal
    OnFailure,
    /// Whenever it has ended
    Always,
}

/// The pauses between restarts.
#[derive(Debug, Default)]
pub struct Pauses {
    /// The number of restarts since the program ran for long enough.
    count: u32,
}

impl Restart {
    /// Returns whether to start a program again that has ended.
    pub fn applies(self, has_failed: bool) -> bool {
        match self {
            Self::Never => false,
            Self::OnFailure => has_failed,
            Self::Always => true,
        }
    }
}

impl Pauses {
    /// Returns the pause after a program that has run for that long.
    pub fn after(&mut self, ran: Duration) -> Duration {
        if ran >= SOUND_AFTER {
            self.count = 0;
        }
        let factor = 2_u32.saturating_pow(self.count);
        self.count = self.count.saturating_add(1);
        FIRST_PAUSE.saturating_mul(factor).min(LONGEST_PAUSE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_up_to_a_minute_and_begin_anew_after_a_sound_run() {
        let mut pauses = Pauses::default();
        let mut after = |seconds| pauses.after(Duration::from_secs(seconds)).as_secs();
        let growing: Vec<_> = (0..8).map(|_| after(0)).collect();
        assert_eq!(growing, [1, 2, 4, 8, 16, 32, 60, 60]);
        assert_eq!(after(10), 1);
    }

    #[test]
    fn rules_distinguish_failures() {
        assert!(!Restart::Never.applies(true));
        assert!(Restart::OnFailure.applies(true) && !Restart::OnFailure.applies(false));
        assert!(Restart::Always.applies(false));
    }
}

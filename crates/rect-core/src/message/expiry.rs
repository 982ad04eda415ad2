//! Decides which messages have expired, although the clocks of two robots are not synchronised.
//!
//! A message contains the time of sending by its sender's clock. The receiver's clock minus that time is the sum of the
//! clocks' offset and the time in transit. The smallest such difference of a source belongs to its fastest message; what
//! another message took longer is its age, except for the time that the fastest one took. Both clocks are those of processes:
//! no clock is compared with that of another robot. A difference counts only when a second message confirms it, so that one
//! message with a wrong clock, which other programs of the robot may send, affects no other message.
use std::time::{Duration, Instant};

use crate::clock::{fastest::Fastest, MillisecondClock};

/// Number of parts of the window in which messages have arrived. After a step of the sender's clock that was not noticed, the
/// estimate is correct again when as many new ones have passed. A time would be wrong: the fastest message from before a cut is
/// what those that waited during it are compared with.
const PARTS: usize = 6;

/// The ages of the messages of one source.
#[derive(Debug, Default)]
pub struct Ages {
    fastest: Fastest,
    /// When the last message was sent, in milliseconds of the sender's clock.
    last_sent_ms: u64,
}

impl Ages {
    /// Returns the age of a message that has arrived, less the time that the fastest message took: zero for the first one. `own` is
    /// the receiver's clock. `is_late`: a message that was sent later has arrived before.
    pub fn on_message(
        &mut self,
        sent_ms: u64,
        is_late: bool,
        own: MillisecondClock,
        now: Instant,
    ) -> Duration {
        if !is_late {
            if sent_ms < self.last_sent_ms {
                // Messages are sent one after another, so the sender's clock was set.
                self.fastest.clear();
            }
            self.last_sent_ms = sent_ms;
        }
        let difference = (own.at(now) as i64).wrapping_sub(sent_ms as i64);
        self.fastest.add(difference, now);
        self.fastest.keep_last(PARTS);
        let smallest = self.fastest.smallest().unwrap_or(difference);
        Duration::from_millis(u64::try_from(difference.saturating_sub(smallest)).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENT_MS: u64 = 1_795_000_000_000;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    struct Messages {
        ages: Ages,
        start: Instant,
    }

    impl Messages {
        fn new() -> Self {
            Self {
                ages: Ages::default(),
                start: Instant::now(),
            }
        }

        /// Returns the age of a message by the time of the test, whose sender's clock is `clock_ms` ahead.
        fn age(&mut self, sent: u64, arrived: u64, clock_ms: i64) -> Duration {
            let sent_ms = SENT_MS.wrapping_add_signed(clock_ms) + sent;
            let own = MillisecondClock::new(self.start, 0);
            (self.ages).on_message(sent_ms, false, own, self.start + ms(arrived))
        }
    }

    #[test]
    fn age_is_what_a_message_took_longer_than_the_fastest_one() {
        let mut messages = Messages::new();
        assert_eq!(messages.age(0, 50, 0), ms(0), "nothing is known yet");
        assert_eq!(messages.age(100, 110, 0), ms(0), "the fastest one");
        assert_eq!(messages.age(150, 160, 0), ms(0), "as fast");
        assert_eq!(messages.age(200, 230, 0), ms(20));
        // A cut of an hour, during which messages wait.
        assert_eq!(messages.age(300, 3_600_310, 0), ms(3_600_000));
        for n in 0..100 {
            let waited = messages.age(400 + n, 3_600_320 + n, 0);
            assert!(waited > ms(3_500_000), "{waited:?}");
        }
        assert_eq!(messages.age(3_600_500, 3_600_511, 0), ms(1));
    }

    #[test]
    fn step_of_the_senders_clock_is_noticed_or_forgotten() {
        let mut messages = Messages::new();
        messages.age(0, 10, 0);
        // Forwards by years, and back again.
        assert_eq!(messages.age(100, 110, 100_000_000_000), ms(0));
        assert_eq!(messages.age(200, 210, 0), ms(0));
        // Back by less than the time between two messages: as if they were old, for a minute.
        let mut ages: Vec<_> = (1..100)
            .map(|n| messages.age(n * 1000, n * 1000 + 10, -500))
            .collect();
        assert_eq!(ages[0], ms(500));
        assert_eq!(ages.pop(), Some(ms(0)));
    }
}

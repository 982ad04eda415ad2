//! Decides when a lane takes another message: the time that the messages on a lane wait to be sent is bounded, so that a
//! flood of small messages does not delay the next message of its priority for minutes.
//!
//! A message of more than [`LARGE_MESSAGE_BYTES`] that must arrive is exempt: all its pieces are taken at once, because
//! Zenoh closes a link that does not take a message within `wait_before_close`. What the lanes hold altogether has a bound
//! in bytes besides (`scheduler`).
use std::time::{Duration, Instant};

use super::piece::Piece;

/// Size above which a message is large, in bytes.
pub const LARGE_MESSAGE_BYTES: usize = 65_536;
/// Bytes that may wait on a lane however slow the link is: enough to keep the radio busy.
pub const LEAST_BYTES: usize = 8_192;
/// The rate of a link that has not been measured yet, in bytes per second: that of a slow radio.
pub const UNMEASURED_BYTES_PER_S: f64 = 34_000.0;
/// Time after which a lane on which nothing moves takes one more batch of whole messages. Without it a message behind a
/// large one, or on a lane that the peer has stopped, would wait longer than Zenoh's `wait_before_close`, and Zenoh would
/// close the link.
pub const BATCH_PATIENCE: Duration = Duration::from_secs(2);
/// The same for a message of several batches, which may bring up to [`LARGE_MESSAGE_BYTES`].
pub const MESSAGE_PATIENCE: Duration = Duration::from_secs(20);

/// Returns how many bytes may wait on a lane so that a link of that rate sends them within `time`.
pub fn limit_bytes(rate_bytes_per_s: Option<f64>, time: Duration) -> usize {
    let rate = rate_bytes_per_s.unwrap_or(UNMEASURED_BYTES_PER_S);
    ((rate * time.as_secs_f64()) as usize).max(LEAST_BYTES)
}

/// The message whose pieces a lane takes at the moment.
#[derive(Clone, Copy, Debug, Default)]
struct Message {
    bytes: usize,
    is_droppable: bool,
}

impl Message {
    fn is_exempt(self) -> bool {
        !self.is_droppable && self.bytes > LARGE_MESSAGE_BYTES
    }
}

/// How a piece that was taken counts towards the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counting {
    /// It counts until it is sent.
    Counts,
    /// It does not count, and neither do the earlier pieces of its message any more: the message has just become large.
    ExemptsMessage,
    /// It does not count: its message is large.
    Exempt,
}

/// The bytes that wait on a lane and count towards its limit.
#[derive(Debug, Default)]
pub struct Backlog {
    bytes: usize,
    message: Message,
    /// When the lane last took a piece, or sent one that counts.
    moved: Option<Instant>,
}

impl Backlog {
    /// Bytes that wait and count.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns whether a message that must arrive may begin.
    pub fn has_room(&self, limit_bytes: usize) -> bool {
        self.bytes < limit_bytes
    }

    /// Returns when the lane takes that piece although it has no room for it.
    pub fn overdue_at(&self, piece: Piece) -> Option<Instant> {
        let patience = match piece {
            Piece::Whole { .. } => BATCH_PATIENCE,
            Piece::First { .. } => MESSAGE_PATIENCE,
            Piece::Next => Duration::ZERO,
        };
        self.moved.map(|moved| moved + patience)
    }

    /// Counts a piece of that many bytes that the lane has taken.
    pub fn on_taken(&mut self, piece: Piece, bytes: usize, now: Instant) -> Counting {
        self.moved = Some(now);
        let was_exempt = match piece {
            Piece::Next => self.message.is_exempt(),
            Piece::Whole { is_droppable } | Piece::First { is_droppable } => {
                self.message = Message {
                    bytes: 0,
                    is_droppable,
                };
                false
            }
        };
        self.message.bytes += bytes;
        // Several whole messages in one batch are small ones.
        let is_exempt = self.message.is_exempt() && !matches!(piece, Piece::Whole { .. });
        match (was_exempt, is_exempt) {
            (false, false) => {
                self.bytes += bytes;
                Counting::Counts
            }
            (false, true) => Counting::ExemptsMessage,
            (true, _) => Counting::Exempt,
        }
    }

    /// Stops counting a piece that has become part of a large message, or was taken back.
    pub fn on_discounted(&mut self, bytes: usize) {
        self.bytes = self.bytes.saturating_sub(bytes);
    }

    /// Stops counting a piece that was sent.
    pub fn on_sent(&mut self, bytes: usize, now: Instant) {
        self.on_discounted(bytes);
        self.moved = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: Piece = Piece::Whole {
        is_droppable: false,
    };
    const FIRST: Piece = Piece::First {
        is_droppable: false,
    };

    #[test]
    fn limit_is_time_at_the_measured_rate_with_a_floor() {
        let half = Duration::from_millis(500);
        assert_eq!(limit_bytes(Some(34_000.0), half), 17_000);
        assert_eq!(limit_bytes(Some(1_000_000.0), half), 500_000);
        assert_eq!(limit_bytes(Some(2_000.0), half), LEAST_BYTES);
        assert_eq!(limit_bytes(Some(0.0), half), LEAST_BYTES);
        assert_eq!(limit_bytes(None, half), 17_000);
    }

    #[test]
    fn message_counts_until_it_becomes_large() {
        let (mut backlog, now) = (Backlog::default(), Instant::now());
        assert_eq!(backlog.on_taken(FIRST, 40_000, now), Counting::Counts);
        assert_eq!(backlog.on_taken(Piece::Next, 25_536, now), Counting::Counts);
        assert_eq!(backlog.bytes(), LARGE_MESSAGE_BYTES);
        let crossing = backlog.on_taken(Piece::Next, 1, now);
        assert_eq!(crossing, Counting::ExemptsMessage);
        backlog.on_discounted(LARGE_MESSAGE_BYTES);
        assert_eq!(backlog.on_taken(Piece::Next, 700, now), Counting::Exempt);
        assert_eq!(backlog.bytes(), 0);
        assert_eq!(backlog.on_taken(WHOLE, 700, now), Counting::Counts);
    }

    #[test]
    fn large_droppable_message_counts() {
        let (mut backlog, now) = (Backlog::default(), Instant::now());
        let is_droppable = true;
        let first = Piece::First { is_droppable };
        assert_eq!(backlog.on_taken(first, 60_000, now), Counting::Counts);
        assert_eq!(backlog.on_taken(Piece::Next, 60_000, now), Counting::Counts);
    }

    #[test]
    fn piece_is_overdue_some_time_after_the_last_movement() {
        let (mut backlog, start) = (Backlog::default(), Instant::now());
        assert_eq!(backlog.overdue_at(WHOLE), None, "nothing has waited yet");
        backlog.on_taken(WHOLE, 700, start);
        assert_eq!(backlog.overdue_at(WHOLE), Some(start + BATCH_PATIENCE));
        assert_eq!(backlog.overdue_at(FIRST), Some(start + MESSAGE_PATIENCE));
        let later = start + Duration::from_secs(1);
        backlog.on_sent(700, later);
        assert_eq!(backlog.overdue_at(WHOLE), Some(later + BATCH_PATIENCE));
    }
}

//! Decides when a lane accepts another message. The time that the messages on a lane wait to be sent is bounded, so that a
//! flood of small messages does not delay the next message of the same priority for minutes.
//!
//! A message of more than [`LARGE_MESSAGE_BYTES`] that must arrive does not count: all its fragments are accepted at once,
//! because Zenoh closes a link that does not accept a message within `wait_before_close`. The next message of several fragments
//! begins when nearly all of it was sent, so there is at most one such message on a lane. In addition, `scheduler` bounds the number
//! of bytes on all lanes together.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use super::batch_kind::BatchKind;

/// Size above which a message is large, in bytes.
pub const LARGE_MESSAGE_BYTES: usize = 65_536;
/// Number of bytes that may wait on a lane even if the link is slow: enough to keep the radio busy.
pub const MIN_LIMIT_BYTES: usize = 8_192;
/// Assumed rate of a link that has not been measured yet, in bytes per second: that of a slow radio.
pub const DEFAULT_RATE_BYTES_PER_S: f64 = 34_000.0;
/// Time after which a lane without progress accepts one more batch of whole messages. Without this limit, a message behind
/// a large one, or on a lane that the peer has stopped, would wait longer than Zenoh's `wait_before_close`, and Zenoh
/// would close the link.
pub const BATCH_STALL_TIMEOUT: Duration = Duration::from_secs(2);
/// Time after which a lane without progress accepts a message of several fragments, which may add up to
/// [`LARGE_MESSAGE_BYTES`].
pub const MESSAGE_STALL_TIMEOUT: Duration = Duration::from_secs(20);

/// Returns how many bytes may wait on a lane so that a link with that rate sends them within `time`; at least
/// [`MIN_LIMIT_BYTES`].
pub fn limit_bytes(rate_bytes_per_s: Option<f64>, time: Duration) -> usize {
    let rate = rate_bytes_per_s.unwrap_or(DEFAULT_RATE_BYTES_PER_S);
    ((rate * time.as_secs_f64()) as usize).max(MIN_LIMIT_BYTES)
}

/// The message whose fragments a lane is accepting.
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

/// How many bytes may wait on a lane before it accepts another message.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Before a message that may be dropped, of all messages.
    pub droppable_bytes: usize,
    /// Before any message, without large ones that must arrive.
    pub backlog_bytes: usize,
}

/// A batch in the queue of a lane.
pub trait Queued {
    /// Returns which part of a message it carries.
    fn kind(&self) -> BatchKind;

    /// Returns the number of bytes with which it counts.
    fn cost(&self) -> usize;

    /// Returns whether it counts.
    fn counts(&mut self) -> &mut bool;
}

/// How an accepted batch counts towards the limit of its lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Counting {
    /// The batch counts until it is sent.
    Counts,
    /// The batch does not count. Its message has just become large, so that its earlier fragments do not count any more
    /// either.
    ExemptsMessage,
    /// The batch does not count, because its message is large.
    Exempt,
}

/// Counts the bytes that wait on a lane and count towards its limit.
#[derive(Debug, Default)]
pub struct Backlog {
    bytes: usize,
    message: Message,
    /// When the lane last accepted a batch, or sent one that counts.
    last_progress: Option<Instant>,
}

impl Backlog {
    /// Returns the number of waiting bytes that count.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns whether the lane accepts a batch of that kind behind `waiting_bytes` bytes of any kind that were not sent.
    pub fn accepts(
        &self,
        kind: BatchKind,
        waiting_bytes: usize,
        limits: Limits,
        now: Instant,
    ) -> bool {
        let has_room = match kind {
            BatchKind::NextFragment => true,
            BatchKind::Whole { is_droppable } | BatchKind::FirstFragment { is_droppable } => {
                match is_droppable {
                    true => {
                        waiting_bytes <= limits.droppable_bytes && self.bytes < limits.backlog_bytes
                    }
                    false => self.has_room(kind, waiting_bytes, limits.backlog_bytes),
                }
            }
        };
        let is_overdue = || self.overdue_at(kind).is_some_and(|at| at <= now);
        has_room || is_overdue()
    }

    /// Queues a batch that the lane has accepted.
    pub fn queue<T: Queued>(&mut self, queue: &mut VecDeque<T>, mut batch: T, now: Instant) {
        let counting = self.on_accepted(batch.kind(), batch.cost(), now);
        *batch.counts() = counting == Counting::Counts;
        if counting == Counting::ExemptsMessage {
            for earlier in queue.iter_mut().rev() {
                if matches!(earlier.kind(), BatchKind::Whole { .. }) {
                    break;
                }
                if std::mem::take(earlier.counts()) {
                    self.on_exempted(earlier.cost());
                }
                if matches!(earlier.kind(), BatchKind::FirstFragment { .. }) {
                    break;
                }
            }
        }
        queue.push_back(batch);
    }

    /// Withdraws the fragments of the message that was queued last, as far as `may_withdraw` permits it, and calls `withdrawn` with
    /// each.
    pub fn abandon<T: Queued>(
        &mut self,
        queue: &mut VecDeque<T>,
        may_withdraw: impl Fn(&T) -> bool,
        mut withdrawn: impl FnMut(&T),
    ) {
        while let Some(last) = queue.back_mut() {
            if matches!(last.kind(), BatchKind::Whole { .. }) || !may_withdraw(last) {
                break;
            }
            if *last.counts() {
                self.on_exempted(last.cost());
            }
            let is_first = matches!(last.kind(), BatchKind::FirstFragment { .. });
            withdrawn(last);
            queue.pop_back();
            if is_first {
                break;
            }
        }
    }

    /// Returns whether the lane has room for a batch of a message that must arrive. A message of several fragments brings any
    /// number of bytes once its first fragment is accepted, so it begins only when few bytes wait, also of a large message.
    fn has_room(&self, kind: BatchKind, waiting_bytes: usize, limit_bytes: usize) -> bool {
        match kind {
            BatchKind::NextFragment => true,
            BatchKind::Whole { .. } => self.bytes < limit_bytes,
            BatchKind::FirstFragment { .. } => self.bytes.max(waiting_bytes) < MIN_LIMIT_BYTES,
        }
    }

    /// Returns when the lane accepts a batch of that kind even without room for it, or `None` if it has accepted none
    /// yet.
    pub fn overdue_at(&self, kind: BatchKind) -> Option<Instant> {
        let timeout = match kind {
            BatchKind::Whole { .. } => BATCH_STALL_TIMEOUT,
            BatchKind::FirstFragment { .. } => MESSAGE_STALL_TIMEOUT,
            BatchKind::NextFragment => Duration::ZERO,
        };
        self.last_progress
            .map(|last_progress| last_progress + timeout)
    }

    /// Counts a batch of `bytes` bytes that the lane has accepted.
    fn on_accepted(&mut self, kind: BatchKind, bytes: usize, now: Instant) -> Counting {
        self.last_progress = Some(now);
        let was_exempt = match kind {
            BatchKind::NextFragment => self.message.is_exempt(),
            BatchKind::Whole { is_droppable } | BatchKind::FirstFragment { is_droppable } => {
                self.message = Message {
                    bytes: 0,
                    is_droppable,
                };
                false
            }
        };
        self.message.bytes += bytes;
        // If a batch contains several whole messages, they are small.
        let is_exempt = self.message.is_exempt() && !matches!(kind, BatchKind::Whole { .. });
        match (was_exempt, is_exempt) {
            (false, false) => {
                self.bytes += bytes;
                Counting::Counts
            }
            (false, true) => Counting::ExemptsMessage,
            (true, _) => Counting::Exempt,
        }
    }

    /// Stops counting a batch that has become part of a large message, or was withdrawn.
    fn on_exempted(&mut self, bytes: usize) {
        self.bytes = self.bytes.saturating_sub(bytes);
    }

    /// Stops counting a batch that was sent.
    pub fn on_sent(&mut self, bytes: usize, now: Instant) {
        self.on_exempted(bytes);
        self.last_progress = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: BatchKind = BatchKind::Whole {
        is_droppable: false,
    };
    const FIRST: BatchKind = BatchKind::FirstFragment {
        is_droppable: false,
    };

    #[test]
    fn limit_is_time_at_the_measured_rate_with_a_floor() {
        let half = Duration::from_millis(500);
        assert_eq!(limit_bytes(Some(34_000.0), half), 17_000);
        assert_eq!(limit_bytes(Some(1_000_000.0), half), 500_000);
        assert_eq!(limit_bytes(Some(2_000.0), half), MIN_LIMIT_BYTES);
        assert_eq!(limit_bytes(Some(0.0), half), MIN_LIMIT_BYTES);
        assert_eq!(limit_bytes(None, half), 17_000);
    }

    #[test]
    fn message_counts_until_it_becomes_large() {
        let (mut backlog, now) = (Backlog::default(), Instant::now());
        assert_eq!(backlog.on_accepted(FIRST, 40_000, now), Counting::Counts);
        assert_eq!(
            backlog.on_accepted(BatchKind::NextFragment, 25_536, now),
            Counting::Counts
        );
        assert_eq!(backlog.bytes(), LARGE_MESSAGE_BYTES);
        let crossing = backlog.on_accepted(BatchKind::NextFragment, 1, now);
        assert_eq!(crossing, Counting::ExemptsMessage);
        backlog.on_exempted(LARGE_MESSAGE_BYTES);
        assert_eq!(
            backlog.on_accepted(BatchKind::NextFragment, 700, now),
            Counting::Exempt
        );
        assert_eq!(backlog.bytes(), 0);
        assert_eq!(backlog.on_accepted(WHOLE, 700, now), Counting::Counts);
    }

    #[test]
    fn fragmented_message_begins_only_when_few_bytes_wait() {
        let (mut backlog, now) = (Backlog::default(), Instant::now());
        let limit_bytes = 34_000;
        backlog.on_accepted(WHOLE, MIN_LIMIT_BYTES - 1, now);
        assert!(backlog.has_room(FIRST, 0, limit_bytes));
        assert!(
            !backlog.has_room(FIRST, MIN_LIMIT_BYTES, limit_bytes),
            "behind a large message"
        );
        assert!(backlog.has_room(WHOLE, 1_000_000, limit_bytes));
        backlog.on_accepted(WHOLE, 1, now);
        assert!(!backlog.has_room(FIRST, 0, limit_bytes));
        assert!(backlog.has_room(BatchKind::NextFragment, 0, limit_bytes));
        assert!(backlog.has_room(WHOLE, 0, limit_bytes));
        backlog.on_accepted(WHOLE, limit_bytes - MIN_LIMIT_BYTES, now);
        assert!(!backlog.has_room(WHOLE, 0, limit_bytes));
    }

    #[test]
    fn large_droppable_message_counts() {
        let (mut backlog, now) = (Backlog::default(), Instant::now());
        let is_droppable = true;
        let first = BatchKind::FirstFragment { is_droppable };
        assert_eq!(backlog.on_accepted(first, 60_000, now), Counting::Counts);
        assert_eq!(
            backlog.on_accepted(BatchKind::NextFragment, 60_000, now),
            Counting::Counts
        );
    }

    #[test]
    fn message_that_may_be_dropped_is_not_accepted_beyond_the_backlog() {
        let (mut backlog, now) = (Backlog::default(), Instant::now());
        let kind = BatchKind::Whole { is_droppable: true };
        // A fast path has carried everything, but the peer has not acknowledged it.
        let limits = Limits {
            droppable_bytes: 100_000,
            backlog_bytes: 20_000,
        };
        backlog.on_accepted(kind, 19_999, now);
        assert!(backlog.accepts(kind, 0, limits, now));
        backlog.on_accepted(kind, 1, now);
        assert!(!backlog.accepts(kind, 0, limits, now));
    }

    #[test]
    fn batch_is_overdue_some_time_after_the_last_progress() {
        let (mut backlog, start) = (Backlog::default(), Instant::now());
        assert_eq!(backlog.overdue_at(WHOLE), None, "nothing was accepted yet");
        backlog.on_accepted(WHOLE, 700, start);
        assert_eq!(backlog.overdue_at(WHOLE), Some(start + BATCH_STALL_TIMEOUT));
        assert_eq!(
            backlog.overdue_at(FIRST),
            Some(start + MESSAGE_STALL_TIMEOUT)
        );
        let later = start + Duration::from_secs(1);
        backlog.on_sent(700, later);
        assert_eq!(backlog.overdue_at(WHOLE), Some(later + BATCH_STALL_TIMEOUT));
    }
}

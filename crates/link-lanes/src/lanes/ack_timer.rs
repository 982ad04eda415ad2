//! Detects a peer that has stopped acknowledging.
//!
//! A receiver acknowledges once it has received [`credits::ack_due_bytes`](super::credits::ack_due_bytes). If at least
//! that much is unacknowledged for [`ACK_TIMEOUT`] and no new acknowledgement arrives, the peer does not read, or does
//! not follow the protocol. SDUs that are sent meanwhile do not restart the timer, because Zenoh sends keep-alives
//! regardless of the peer.
use std::time::{Duration, Instant};

use super::credits::ack_due_bytes;

/// Time without progress after which the link ends. Zenoh's lease (10 s) ends a silent link sooner; this ends one whose
/// peer still sends.
pub const ACK_TIMEOUT: Duration = Duration::from_secs(20);

/// Measures how long an acknowledgement has been due.
#[derive(Clone, Debug)]
pub struct AckTimer {
    due_bytes: u16,
    /// Time of the last progress while an acknowledgement is due.
    since: Option<Instant>,
}

impl AckTimer {
    /// Creates the timer of a link whose receiver announced `window` bytes.
    pub fn new(window: u16) -> Self {
        Self {
            due_bytes: ack_due_bytes(window),
            since: None,
        }
    }

    /// Handles a sent SDU, after which `unacknowledged` bytes are in flight.
    pub fn on_sent(&mut self, unacknowledged: u16, now: Instant) {
        if unacknowledged >= self.due_bytes {
            self.since.get_or_insert(now);
        }
    }

    /// Handles an acknowledgement of `new` bytes, after which `unacknowledged` bytes are in flight.
    pub fn on_ack(&mut self, new: u16, unacknowledged: u16, now: Instant) {
        if new > 0 {
            self.since = (unacknowledged >= self.due_bytes).then_some(now);
        }
    }

    /// Stops the timer: the link is ending.
    pub fn stop(&mut self) {
        self.since = None;
    }

    /// Returns when the link ends unless an acknowledgement arrives, or `None` if none is due.
    pub fn deadline(&self) -> Option<Instant> {
        self.since.map(|since| since + ACK_TIMEOUT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: u16 = 12_000;
    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn expires_although_more_is_sent() {
        let (mut timer, start) = (AckTimer::new(WINDOW), Instant::now());
        timer.on_sent(511, start);
        assert_eq!(timer.deadline(), None, "no acknowledgement is due yet");
        for n in 0..20_u16 {
            timer.on_sent(512 + 25 * n, start + SECOND * u32::from(n));
        }
        assert_eq!(timer.deadline(), Some(start + ACK_TIMEOUT));
    }

    #[test]
    fn new_acknowledgement_restarts_or_stops_the_timer_and_a_repeated_one_does_not() {
        let (mut timer, start) = (AckTimer::new(WINDOW), Instant::now());
        timer.on_sent(2000, start);
        timer.on_ack(0, 2000, start + SECOND);
        assert_eq!(timer.deadline(), Some(start + ACK_TIMEOUT));
        timer.on_ack(1000, 1000, start + SECOND);
        assert_eq!(timer.deadline(), Some(start + SECOND + ACK_TIMEOUT));
        timer.on_ack(600, 400, start + SECOND);
        assert_eq!(timer.deadline(), None);
    }

    #[test]
    fn small_window_is_acknowledged_in_quarters() {
        let (mut timer, start) = (AckTimer::new(1000), Instant::now());
        timer.on_sent(249, start);
        assert_eq!(timer.deadline(), None);
        timer.on_sent(250, start);
        assert_eq!(timer.deadline(), Some(start + ACK_TIMEOUT));
    }
}

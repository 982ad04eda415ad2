//! Owns the credits of a link: how much may be on its way, so that the receiver's socket holds it even while nobody reads.
//! Linux before 6.10 throws away what does not fit, without an error.
//!
//! The receiver's reader empties the socket at once and acknowledges what it took. Totals are counted, not differences,
//! in bytes modulo 2^16: an acknowledgement that comes late changes nothing, and one that cannot be true is an error.

/// Bytes that an SDU takes besides its own: a kernel's bookkeeping counts against a socket's buffer, and where the radio's
/// packets are short (27 bytes) the shortest SDU takes as much of it as one of 23 bytes.
pub const PER_SDU: u16 = 24;
/// The largest window: totals are told apart within half of their range.
pub const MAX_WINDOW: u16 = 16_384;
/// The smallest window worth a link: two batches of Zenoh's handshake.
pub const MIN_WINDOW: u16 = 512;
/// The part of the window after which an acknowledgement is due at the latest, to keep the sender going.
const PART: u16 = 4;
/// Bytes after which one is worth it: each full SDU has its own, from which the sender learns how much to keep on its way
/// (`flight`), and of small ones several share one. An acknowledgement takes 11 bytes of a packet that goes out anyway, and
/// 12 of the other direction, where Linux returns its credit at once. (One for every other SDU carried 1 % more in the VM,
/// but to keep the radio busy more has then to be on its way, which urgent messages wait for.)
const ACK_BYTES: u16 = 512;

/// What an SDU with a batch of that many bytes takes.
pub fn cost(bytes: usize) -> u16 {
    u16::try_from(bytes).map_or(u16::MAX, |bytes| bytes.saturating_add(PER_SDU))
}

/// The window of a receiver that keeps so many bytes unread.
pub fn window_of(kept_unread_bytes: usize) -> u16 {
    let window = u16::try_from(kept_unread_bytes).unwrap_or(MAX_WINDOW);
    window.clamp(MIN_WINDOW, MAX_WINDOW)
}

/// The largest batch that never gets stuck on that window.
pub fn largest_batch(window: u16) -> u16 {
    window / 2 - PER_SDU
}

/// Returns the bytes after which a receiver with that window acknowledges.
pub fn ack_due_bytes(window: u16) -> u16 {
    ACK_BYTES.min(window / PART)
}

/// How the other side broke the rules of credits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CreditError {
    /// It sent more than it was allowed to.
    #[error("it sent more than its credits allow")]
    Overrun,
    /// It acknowledged what was never sent.
    #[error("it acknowledged what was never sent")]
    NeverSent,
    /// It took an acknowledgement back.
    #[error("it took an acknowledgement back")]
    TakenBack,
}

/// The sender's side: what it may still send.
#[derive(Clone, Debug)]
pub struct Allowance {
    window: u16,
    sent: u16,
    acknowledged: u16,
}

impl Allowance {
    /// `window`: what the receiver told at the opening, in bytes.
    pub fn new(window: u16) -> Self {
        Self {
            window: window.min(MAX_WINDOW),
            sent: 0,
            acknowledged: 0,
        }
    }

    /// Whether the cost may be spent, and `reserve` is left over.
    pub fn has(&self, cost: u16, reserve: u16) -> bool {
        self.window - self.unacknowledged() >= cost.saturating_add(reserve)
    }

    /// Takes the cost off, after [`Allowance::has`] has said yes.
    pub fn spend(&mut self, cost: u16) {
        self.sent = self.sent.wrapping_add(cost);
    }

    /// The receiver took `total` bytes since the link began. Tells how many of them are new.
    pub fn on_ack(&mut self, total: u16) -> Result<u16, CreditError> {
        let new = total.wrapping_sub(self.acknowledged);
        if new <= self.unacknowledged() {
            self.acknowledged = total;
            return Ok(new);
        }
        let is_ahead = total.wrapping_sub(self.sent) <= u16::MAX / 2;
        Err(match is_ahead {
            true => CreditError::NeverSent,
            false => CreditError::TakenBack,
        })
    }

    /// Bytes on their way, as far as is known.
    pub fn unacknowledged(&self) -> u16 {
        self.sent.wrapping_sub(self.acknowledged)
    }

    /// Bytes sent since the link began.
    pub fn sent(&self) -> u16 {
        self.sent
    }

    /// The whole of it.
    pub fn window(&self) -> u16 {
        self.window
    }
}

/// The receiver's side: what it has taken, and told.
#[derive(Clone, Debug)]
pub struct Acks {
    window: u16,
    received: u16,
    told: u16,
}

impl Acks {
    /// `window`: what this side told at the opening, in bytes.
    pub fn new(window: u16) -> Self {
        Self {
            window: window.min(MAX_WINDOW),
            received: 0,
            told: 0,
        }
    }

    /// An SDU of that cost was taken out of the socket.
    pub fn on_received(&mut self, cost: u16) -> Result<(), CreditError> {
        if self.untold().saturating_add(cost) > self.window {
            return Err(CreditError::Overrun);
        }
        self.received = self.received.wrapping_add(cost);
        Ok(())
    }

    /// The total to acknowledge, when it is worth it.
    pub fn due(&mut self) -> Option<u16> {
        if !self.is_due() {
            return None;
        }
        self.told = self.received;
        Some(self.told)
    }

    /// Whether an acknowledgement is worth it.
    pub fn is_due(&self) -> bool {
        self.untold() >= ack_due_bytes(self.window)
    }

    fn untold(&self) -> u16 {
        self.received.wrapping_sub(self.told)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: u16 = 12_000;

    #[test]
    fn nothing_is_sent_beyond_the_window_until_some_of_it_is_acknowledged() {
        let (mut allowance, mut acks) = (Allowance::new(WINDOW), Acks::new(WINDOW));
        let cost = cost(1000);
        let mut sent = 0;
        while allowance.has(cost, 0) {
            allowance.spend(cost);
            acks.on_received(cost).expect("within the window");
            sent += 1;
        }
        assert_eq!(sent, WINDOW / cost);
        let total = acks.due().expect("all is taken");
        assert_eq!(acks.due(), None, "told once");
        assert_eq!(allowance.on_ack(total), Ok(sent * cost));
        assert_eq!(allowance.on_ack(total), Ok(0), "the same again is no harm");
        assert_eq!(allowance.unacknowledged(), 0);
    }

    #[test]
    fn a_window_over_the_largest_counts_as_the_largest() {
        assert_eq!(Allowance::new(u16::MAX).window(), MAX_WINDOW);
    }

    #[test]
    fn totals_may_wrap_as_often_as_they_like() {
        let (mut allowance, mut acks) = (Allowance::new(WINDOW), Acks::new(WINDOW));
        let mut sent: u32 = 0;
        for n in 0..10_000_usize {
            let cost = cost(n % 1000);
            assert!(allowance.has(cost, 0), "sdu {n}: all before it were taken");
            allowance.spend(cost);
            acks.on_received(cost).expect("within the window");
            if let Some(total) = acks.due() {
                allowance.on_ack(total).expect("true");
            }
            sent += u32::from(cost);
        }
        assert!(sent > 3 * u32::from(u16::MAX));
    }

    #[test]
    fn the_largest_batch_never_gets_stuck_whatever_its_lane_leaves_to_others() {
        for window in [MIN_WINDOW, 4000, WINDOW, MAX_WINDOW] {
            let cost = cost(usize::from(largest_batch(window)));
            let (mut allowance, mut acks) = (Allowance::new(window), Acks::new(window));
            for n in 0..100 {
                assert!(allowance.has(cost, window / 4 - 1), "{window}, sdu {n}");
                allowance.spend(cost);
                acks.on_received(cost).expect("within the window");
                if let Some(total) = acks.due() {
                    allowance.on_ack(total).expect("true");
                }
            }
        }
    }

    #[test]
    fn a_peer_that_breaks_the_rules_is_found_out() {
        let mut acks = Acks::new(1000);
        acks.on_received(600).expect("within the window");
        assert_eq!(acks.on_received(401), Err(CreditError::Overrun));

        let mut allowance = Allowance::new(1000);
        allowance.spend(600);
        assert_eq!(allowance.on_ack(601), Err(CreditError::NeverSent));
        assert_eq!(allowance.on_ack(500), Ok(500));
        assert_eq!(allowance.on_ack(499), Err(CreditError::TakenBack));
        assert_eq!(allowance.unacknowledged(), 100);
    }
}

//! Keeps track of the credits of a link: how many bytes may be in flight, so that they fit into the receiver's socket even
//! if the receiver does not read. Linux before 6.10 discards what does not fit, without an error.
//!
//! The receiver empties its socket at once and acknowledges what it has read. An acknowledgement carries the total since the
//! link began, in bytes modulo 2^16, rather than a difference. A late acknowledgement therefore changes nothing, and an
//! impossible one is detected.

/// Number of bytes that an SDU costs in addition to its batch. The kernel's bookkeeping for each K-frame counts against
/// the buffer of the socket, and even the shortest SDU takes one K-frame. If the radio's packets are short (27 bytes),
/// a K-frame carries up to 23 bytes.
pub const SDU_OVERHEAD_BYTES: u16 = 24;
/// The largest window, in bytes. Totals can be compared only within half of their range.
pub const MAX_WINDOW: u16 = 16_384;
/// The smallest window of a link, in bytes: two batches of Zenoh's handshake.
pub const MIN_WINDOW: u16 = 512;
/// An acknowledgement is due at the latest when the window divided by this number was received, so that the sender can
/// continue.
const ACK_WINDOW_DIVISOR: u16 = 4;
/// Number of bytes after which an acknowledgement is due. Each full SDU gets its own, from which the sender learns how many
/// bytes to keep in flight (`flight`); several small SDUs share one. An acknowledgement takes 11 bytes of a packet that is
/// sent anyway, and 12 bytes in the other direction, where Linux returns its credit at once. (One for every other SDU
/// increased the throughput by 1 % in the VM, but keeping the radio busy then needs more bytes in flight, and urgent messages
/// wait for those.)
const ACK_BYTES: u16 = 512;

/// Returns the cost in credits of an SDU with a batch of `bytes` bytes.
pub fn cost(bytes: usize) -> u16 {
    u16::try_from(bytes).map_or(u16::MAX, |bytes| bytes.saturating_add(SDU_OVERHEAD_BYTES))
}

/// Returns the window of a receiver whose socket holds at least `receive_capacity_bytes` unread bytes; [`MIN_WINDOW`]
/// to [`MAX_WINDOW`].
pub fn window_of(receive_capacity_bytes: usize) -> u16 {
    let window = u16::try_from(receive_capacity_bytes).unwrap_or(MAX_WINDOW);
    window.clamp(MIN_WINDOW, MAX_WINDOW)
}

/// Returns the size of the largest batch that can always be sent with that window, in bytes.
pub fn largest_batch(window: u16) -> u16 {
    window / 2 - SDU_OVERHEAD_BYTES
}

/// Returns the number of bytes after which a receiver with that window acknowledges.
pub fn ack_due_bytes(window: u16) -> u16 {
    ACK_BYTES.min(window / ACK_WINDOW_DIVISOR)
}

/// A violation of the credits by the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CreditError {
    /// The peer sent more than its credits allow.
    #[error("it sent more than its credits allow")]
    Overrun,
    /// The peer acknowledged more than was sent.
    #[error("it acknowledged more than was sent")]
    ExceedsSent,
    /// The peer acknowledged less than before.
    #[error("it acknowledged less than before")]
    Decreased,
}

/// The sender's side of the credits: what may still be sent.
#[derive(Clone, Debug)]
pub struct Allowance {
    window: u16,
    sent: u16,
    acknowledged: u16,
}

impl Allowance {
    /// Creates the allowance of a new link. `window` is what the receiver announced in the handshake, in bytes; at most
    /// [`MAX_WINDOW`] of it is used.
    pub fn new(window: u16) -> Self {
        Self {
            window: window.min(MAX_WINDOW),
            sent: 0,
            acknowledged: 0,
        }
    }

    /// Returns whether `cost` can be spent so that at least `reserve` bytes remain.
    pub fn can_spend(&self, cost: u16, reserve: u16) -> bool {
        self.window - self.unacknowledged() >= cost.saturating_add(reserve)
    }

    /// Spends `cost`. The caller has checked [`Allowance::can_spend`].
    pub fn spend(&mut self, cost: u16) {
        self.sent = self.sent.wrapping_add(cost);
    }

    /// Handles an acknowledgement of `total` bytes since the link began. Returns how many of them are new.
    ///
    /// # Errors
    /// Fails if the peer cannot have received that total.
    pub fn on_ack(&mut self, total: u16) -> Result<u16, CreditError> {
        let new = total.wrapping_sub(self.acknowledged);
        if new <= self.unacknowledged() {
            self.acknowledged = total;
            return Ok(new);
        }
        let is_ahead = total.wrapping_sub(self.sent) <= u16::MAX / 2;
        Err(match is_ahead {
            true => CreditError::ExceedsSent,
            false => CreditError::Decreased,
        })
    }

    /// Returns the number of bytes that were sent and not acknowledged yet.
    pub fn unacknowledged(&self) -> u16 {
        self.sent.wrapping_sub(self.acknowledged)
    }

    /// Returns the number of bytes sent since the link began, modulo 2^16.
    pub fn sent(&self) -> u16 {
        self.sent
    }

    /// Returns the receiver's window, in bytes.
    pub fn window(&self) -> u16 {
        self.window
    }
}

/// The receiver's side of the credits: what was received and what was acknowledged.
#[derive(Clone, Debug)]
pub struct Acks {
    window: u16,
    received: u16,
    acknowledged: u16,
}

impl Acks {
    /// Creates the counters of a new link. `window` is what this side announced in the handshake, in bytes.
    pub fn new(window: u16) -> Self {
        Self {
            window: window.min(MAX_WINDOW),
            received: 0,
            acknowledged: 0,
        }
    }

    /// Counts an SDU with that cost, which was read from the socket.
    ///
    /// # Errors
    /// Fails if the peer has sent more than the window allows.
    pub fn on_received(&mut self, cost: u16) -> Result<(), CreditError> {
        if self.unacknowledged().saturating_add(cost) > self.window {
            return Err(CreditError::Overrun);
        }
        self.received = self.received.wrapping_add(cost);
        Ok(())
    }

    /// Returns the total to acknowledge, if an acknowledgement is due, and counts it as acknowledged.
    pub fn due(&mut self) -> Option<u16> {
        if !self.is_due() {
            return None;
        }
        self.acknowledged = self.received;
        Some(self.acknowledged)
    }

    /// Returns whether an acknowledgement is due.
    pub fn is_due(&self) -> bool {
        self.unacknowledged() >= ack_due_bytes(self.window)
    }

    fn unacknowledged(&self) -> u16 {
        self.received.wrapping_sub(self.acknowledged)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: u16 = 12_000;

    #[test]
    fn sender_stops_at_the_window_until_an_acknowledgement_arrives() {
        let (mut allowance, mut acks) = (Allowance::new(WINDOW), Acks::new(WINDOW));
        let cost = cost(1000);
        let mut sent = 0;
        while allowance.can_spend(cost, 0) {
            allowance.spend(cost);
            acks.on_received(cost).expect("within the window");
            sent += 1;
        }
        assert_eq!(sent, WINDOW / cost);
        let total = acks.due().expect("an acknowledgement is due");
        assert_eq!(acks.due(), None, "acknowledged once");
        assert_eq!(allowance.on_ack(total), Ok(sent * cost));
        assert_eq!(
            allowance.on_ack(total),
            Ok(0),
            "a repeated one changes nothing"
        );
        assert_eq!(allowance.unacknowledged(), 0);
    }

    #[test]
    fn window_is_limited_to_the_largest() {
        assert_eq!(Allowance::new(u16::MAX).window(), MAX_WINDOW);
    }

    #[test]
    fn totals_may_wrap_any_number_of_times() {
        let (mut allowance, mut acks) = (Allowance::new(WINDOW), Acks::new(WINDOW));
        let mut sent: u32 = 0;
        for n in 0..10_000_usize {
            let cost = cost(n % 1000);
            assert!(
                allowance.can_spend(cost, 0),
                "sdu {n}: all before it were received"
            );
            allowance.spend(cost);
            acks.on_received(cost).expect("within the window");
            if let Some(total) = acks.due() {
                allowance.on_ack(total).expect("a valid total");
            }
            sent += u32::from(cost);
        }
        assert!(sent > 3 * u32::from(u16::MAX));
    }

    #[test]
    fn largest_batch_can_always_be_sent_whatever_its_lane_reserves() {
        for window in [MIN_WINDOW, 4000, WINDOW, MAX_WINDOW] {
            let cost = cost(usize::from(largest_batch(window)));
            let (mut allowance, mut acks) = (Allowance::new(window), Acks::new(window));
            for n in 0..100 {
                assert!(
                    allowance.can_spend(cost, window / 4 - 1),
                    "{window}, sdu {n}"
                );
                allowance.spend(cost);
                acks.on_received(cost).expect("within the window");
                if let Some(total) = acks.due() {
                    allowance.on_ack(total).expect("a valid total");
                }
            }
        }
    }

    #[test]
    fn credit_violations_are_detected() {
        let mut acks = Acks::new(1000);
        acks.on_received(600).expect("within the window");
        assert_eq!(acks.on_received(401), Err(CreditError::Overrun));

        let mut allowance = Allowance::new(1000);
        allowance.spend(600);
        assert_eq!(allowance.on_ack(601), Err(CreditError::ExceedsSent));
        assert_eq!(allowance.on_ack(500), Ok(500));
        assert_eq!(allowance.on_ack(499), Err(CreditError::Decreased));
        assert_eq!(allowance.unacknowledged(), 100);
    }
}

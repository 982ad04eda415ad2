//! Decides which connection gets a radio when two connection events overlap. A radio serves one event at a time.
//!
//! In all models, an event that has started is not interrupted: the other connection misses its event. Events of one
//! central come from one clock, and its controller places them so that they do not overlap; if there is no room for that,
//! they take turns. The models differ in what happens when the events come from different clocks, and one of them would
//! start while the other one is still in progress:
//!
//! - [`Arbitration::FirstCome`]: the event that starts first keeps the radio. If the intervals are equal, the other
//!   connection then misses every event until the clocks have drifted apart again, which takes longer than a supervision
//!   timeout. This is the behaviour of Nordic's SoftDevice between connections of equal priority (S132 SoftDevice
//!   Specification, "Scheduling": events of the central and of the peripheral role are scheduled independently, and the one
//!   that was requested first gets its time), and explains the losses that were measured in "Mind the Gap: Multi-hop IPv6
//!   over BLE in the IoT" (CoNEXT 2021).
//! - [`Arbitration::TimeoutFirst`]: as above, but a connection that is about to reach its supervision timeout has
//!   priority. (The same specification, first priority; Zephyr's controller, `ull_conn.c`, forces an event when six
//!   intervals are left.) The link holds, but carries one event per supervision timeout.
//! - [`Arbitration::LeastRecent`]: the connection whose last event is longer ago goes first. (Apache NimBLE's controller,
//!   `ble_ll_sched_conn_reschedule` with `ble_ll_conn_is_lru`, for events that have not started.) Each link carries every
//!   other event.
//!
//! The firmware of a Raspberry Pi's radio is not published. The default is therefore the model in which most goes wrong.
use std::time::Duration;

/// Number of intervals before the supervision timeout from which a connection has priority.
const URGENT_INTERVALS: u32 = 6;

/// How a radio is shared by connection events of different clocks that overlap. Default: first come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arbitration {
    /// The event that starts first keeps the radio.
    #[default]
    FirstCome,
    /// The event that starts first keeps the radio, unless the other connection is about to time out.
    TimeoutFirst,
    /// The connection whose last event is longer ago gets the radio.
    LeastRecent,
}

impl Arbitration {
    /// All models.
    pub const ALL: [Self; 3] = [Self::FirstCome, Self::TimeoutFirst, Self::LeastRecent];
}

/// The properties of a connection that decide about its next event on one radio. All times are since the start of the air.
#[derive(Clone, Copy, Debug)]
pub(super) struct Claim {
    /// Whether the radio's own clock determines the time of the event: the adapter is the central.
    pub(super) is_own_clock: bool,
    /// Start of the last event that it got on this radio. Ties are decided by the id of the connection.
    pub(super) last_event: (Duration, u32),
    /// Start of its next event.
    pub(super) next_event: Duration,
    /// End of the supervision timeout on this radio.
    pub(super) times_out_at: Duration,
    pub(super) interval: Duration,
}

impl Claim {
    /// Returns whether this connection leaves the radio to `other`, whose event starts while this one's would be in
    /// progress.
    pub(super) fn yields_to(&self, other: &Self, arbitration: Arbitration) -> bool {
        let is_longer_ago = other.last_event < self.last_event;
        if self.is_own_clock && other.is_own_clock {
            return is_longer_ago;
        }
        match arbitration {
            Arbitration::FirstCome => false,
            Arbitration::TimeoutFirst => other.is_urgent() && !self.is_urgent(),
            Arbitration::LeastRecent => is_longer_ago,
        }
    }

    fn is_urgent(&self) -> bool {
        self.next_event + URGENT_INTERVALS * self.interval >= self.times_out_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(is_own_clock: bool, last_event_ms: u64, times_out_ms: u64) -> Claim {
        Claim {
            is_own_clock,
            last_event: (Duration::from_millis(last_event_ms), 0),
            next_event: Duration::from_millis(1000),
            times_out_at: Duration::from_millis(times_out_ms),
            interval: Duration::from_millis(30),
        }
    }

    #[test]
    fn connections_of_one_central_take_turns_in_every_model() {
        let (recent, old) = (claim(true, 970, 3000), claim(true, 940, 3000));
        for arbitration in Arbitration::ALL {
            assert!(recent.yields_to(&old, arbitration), "{arbitration:?}");
            assert!(!old.yields_to(&recent, arbitration), "{arbitration:?}");
        }
    }

    #[test]
    fn different_clocks_follow_the_model() {
        let (own, other) = (claim(true, 970, 3000), claim(false, 500, 2000));
        assert!(!own.yields_to(&other, Arbitration::FirstCome));
        assert!(!own.yields_to(&other, Arbitration::TimeoutFirst));
        assert!(own.yields_to(&other, Arbitration::LeastRecent));
        let urgent = claim(false, 500, 1180);
        assert!(own.yields_to(&urgent, Arbitration::TimeoutFirst));
        assert!(!urgent.yields_to(&urgent, Arbitration::TimeoutFirst));
        assert!(!own.yields_to(&claim(false, 500, 1181), Arbitration::TimeoutFirst));
    }
}

//! Models the three advertising channels: which packets overlap, and which of them a scanner listens for.
//!
//! An advertising event is one packet on each of the channels 37, 38 and 39, one after the other. All advertisers of the
//! air use the same spacing, so the packets of two events overlap on all three channels or on none. A receiver receives
//! neither of two packets that overlap: pure (unslotted) ALOHA, without the capture of a much stronger packet.
use std::{collections::VecDeque, time::Duration};

use super::AdapterId;
use crate::phy::{Phy, INTER_FRAME_SPACE};

/// Number of advertising channels.
pub(super) const CHANNELS: u32 = 3;
/// Payload of RECT's ADV_IND: the address (6) and 31 bytes of advertising data.
const ADVERTISEMENT_BYTES: usize = 6 + 31;
/// Payload of CONNECT_IND: two addresses and 22 bytes of parameters (Vol 6, Part B, 2.3.3.1).
pub(super) const CONNECT_BYTES: usize = 34;
/// Time for which the advertiser listens for the beginning of a request after each of its packets, before it changes the
/// channel.
const LISTENING: Duration = Duration::from_micros(74);
/// Events that started longer ago cannot overlap with a packet that is being decided about.
const MEMORY: Duration = Duration::from_millis(10);

/// The advertising events of the recent past.
#[derive(Debug, Default)]
pub(super) struct AdvertisingChannel {
    /// Start and advertiser of each event, in order of time.
    events: VecDeque<(Duration, AdapterId)>,
}

/// Number of packets that a receiver could have received, and of those that overlapped with another one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Collisions {
    pub(super) packets: u64,
    pub(super) collided: u64,
}

impl Collisions {
    pub(super) fn on_packet(&mut self, has_collided: bool) {
        self.packets += 1;
        self.collided += u64::from(has_collided);
    }
}

/// How an adapter scans: for `window` at the beginning of each `interval`, on one channel after the other.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScanPattern {
    pub(super) since: Duration,
    pub(super) interval: Duration,
    pub(super) window: Duration,
}

/// Returns the airtime of an advertising packet.
pub(super) fn packet() -> Duration {
    Phy::Le1M.airtime(ADVERTISEMENT_BYTES)
}

/// Returns the airtime of an advertising event.
pub(super) fn event_airtime() -> Duration {
    CHANNELS * packet()
}

/// Returns the time from the start of an event until everything has been sent that belongs to it, including a connect
/// request after its last packet.
pub(super) fn event_duration() -> Duration {
    packet_offset(CHANNELS - 1) + packet() + INTER_FRAME_SPACE + Phy::Le1M.airtime(CONNECT_BYTES)
}

/// Returns the time from the start of an event to its packet on a channel.
fn packet_offset(channel: u32) -> Duration {
    channel * (packet() + INTER_FRAME_SPACE + LISTENING)
}

impl AdvertisingChannel {
    /// Records the start of an event.
    pub(super) fn on_event(&mut self, at: Duration, advertiser: AdapterId) {
        while self
            .events
            .front()
            .is_some_and(|(start, _)| *start + MEMORY < at)
        {
            self.events.pop_front();
        }
        self.events.push_back((at, advertiser));
    }

    /// Returns the other advertisers whose packets overlap with those of the event that started at `start`.
    pub(super) fn overlapping(
        &self,
        start: Duration,
        advertiser: AdapterId,
    ) -> impl Iterator<Item = AdapterId> + '_ {
        self.others(advertiser)
            .filter(move |(other, _)| other.abs_diff(start) < packet())
            .map(|(_, other)| other)
    }

    /// Returns the other advertisers whose packets overlap with a connect request in response to the event.
    pub(super) fn overlapping_request(
        &self,
        start: Duration,
        advertiser: AdapterId,
    ) -> impl Iterator<Item = AdapterId> + '_ {
        let from = start + packet() + INTER_FRAME_SPACE;
        let to = from + Phy::Le1M.airtime(CONNECT_BYTES);
        self.others(advertiser)
            .filter(move |(other, _)| *other < to && *other + packet() > from)
            .map(|(_, other)| other)
    }

    /// Returns whether the adapter itself advertises during the event.
    pub(super) fn is_advertising(&self, adapter: AdapterId, start: Duration) -> bool {
        self.events
            .iter()
            .any(|(other, by)| *by == adapter && other.abs_diff(start) < event_duration())
    }

    fn others(&self, advertiser: AdapterId) -> impl Iterator<Item = (Duration, AdapterId)> + '_ {
        let events = self.events.iter().copied();
        events.filter(move |(_, by)| *by != advertiser)
    }
}

impl ScanPattern {
    /// Returns the channel on which the adapter listens during a packet of the event that started at `start`, if there is
    /// one.
    pub(super) fn channel(&self, start: Duration) -> Option<u32> {
        (0..CHANNELS).find(|channel| {
            let channel = *channel;
            let Some(scanned) = (start + packet_offset(channel)).checked_sub(self.since) else {
                return false;
            };
            let turn = scanned.as_nanos() / self.interval.as_nanos().max(1);
            let within = scanned.as_nanos() % self.interval.as_nanos().max(1);
            turn % u128::from(CHANNELS) == u128::from(channel)
                && within + packet().as_nanos() <= self.window.as_nanos()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(micros: u64) -> Duration {
        Duration::from_micros(micros)
    }

    #[test]
    fn packets_overlap_within_their_airtime() {
        assert_eq!(packet(), us(376));
        let mut channel = AdvertisingChannel::default();
        for (at, advertiser) in [(1000, 1), (1375, 2), (1751, 3), (2500, 1)] {
            channel.on_event(us(at), AdapterId(advertiser));
        }
        let overlapping = |start, advertiser| {
            let others = channel.overlapping(us(start), AdapterId(advertiser));
            others.map(|other| other.0).collect::<Vec<_>>()
        };
        assert_eq!(overlapping(1000, 1), [2]);
        assert_eq!(overlapping(1375, 2), [1]);
        assert_eq!(overlapping(1751, 3), [0_u32; 0]);
        // A connect request starts 526 us after the event and takes 352 us.
        let requests = channel.overlapping_request(us(1000), AdapterId(1));
        assert_eq!(requests.map(|other| other.0).collect::<Vec<_>>(), [2, 3]);
        assert!(channel.is_advertising(AdapterId(3), us(3000)));
        assert!(!channel.is_advertising(AdapterId(3), us(9000)));
    }

    #[test]
    fn scanner_listens_on_one_channel_after_the_other() {
        let pattern = |window| ScanPattern {
            since: us(0),
            interval: us(20_000),
            window: us(window),
        };
        let covered = |pattern: ScanPattern| {
            let starts = (0..6000).map(|n| us(n * 10 + 20_000));
            starts
                .filter(|start| pattern.channel(*start).is_some())
                .count()
        };
        // One packet of each event is on the channel of a continuous scan, except at the change of the channel.
        assert!((5600..6000).contains(&covered(pattern(20_000))));
        assert!((2700..3000).contains(&covered(pattern(10_000))));
        assert_eq!(pattern(20_000).channel(us(1000)), Some(0));
        assert_eq!(pattern(20_000).channel(us(21_000)), Some(1));
        assert_eq!(pattern(10_000).channel(us(31_000)), None);
    }
}

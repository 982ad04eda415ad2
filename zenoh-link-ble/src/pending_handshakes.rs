//! Decides which incoming channels may have a handshake in progress, when there are more of them than the limit. This is
//! plain logic and is given the time: the caller reports events and ends the handshakes that are evicted.
//!
//! Any device in range can open channels without completing a handshake. Therefore, if the limit is reached, a new handshake
//! evicts the oldest one. A device that opens channels repeatedly could then evict a robot before its handshake is complete,
//! so an address whose last handshake failed has lower precedence than all others for a while. To keep a robot out, an
//! attacker would need [`MAX_HANDSHAKES`] new addresses within the fraction of a second that a handshake takes, again and
//! again. A peer whose handshake has succeeded does not count towards the limit.
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::address::DeviceAddress;

use crate::rejected_peers::RejectedPeers;

/// Largest number of handshakes in progress at the same time.
pub(crate) const MAX_HANDSHAKES: usize = 8;
/// Largest number of handshakes in progress with the same address. A robot needs one, and a second one if it dials again
/// before this side has noticed that its last channel is closed.
pub(crate) const MAX_HANDSHAKES_PER_ADDRESS: usize = 2;
/// How long a handshake with an address whose last one failed cannot be evicted by another such address. It suffices for a
/// handshake.
const MIN_TURN: Duration = Duration::from_secs(1);

/// Identifies a handshake in progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct HandshakeId(u64);

/// The decision about a new channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// The handshake may begin.
    Admitted(HandshakeId),
    /// The handshake may begin, and another one with the given device was evicted.
    AdmittedInsteadOf(HandshakeId, DeviceAddress),
    /// The channel has to be closed.
    Rejected,
}

#[derive(Debug)]
struct PendingHandshake {
    id: HandshakeId,
    device: DeviceAddress,
    since: Instant,
    evicted: CancellationToken,
}

/// The handshakes in progress, the oldest first, and the addresses whose last one failed.
#[derive(Debug, Default)]
pub(crate) struct PendingHandshakes {
    next: u64,
    pending: Vec<PendingHandshake>,
    failed: RejectedPeers,
}

impl PendingHandshakes {
    /// Decides about a new channel. `evicted` is cancelled if its handshake is evicted later.
    pub(crate) fn on_channel(
        &mut self,
        device: DeviceAddress,
        evicted: CancellationToken,
        now: Instant,
    ) -> Admission {
        let index = match self.find_evicted(device, now) {
            Ok(index) => index,
            Err(LimitReached) => return Admission::Rejected,
        };
        let replaced = index.map(|index| {
            let handshake = self.pending.remove(index);
            handshake.evicted.cancel();
            self.failed.insert(handshake.device, now);
            handshake.device
        });
        let id = HandshakeId(self.next);
        self.next += 1;
        self.pending.push(PendingHandshake {
            id,
            device,
            since: now,
            evicted,
        });
        match replaced {
            Some(replaced) => Admission::AdmittedInsteadOf(id, replaced),
            None => Admission::Admitted(id),
        }
    }

    /// Removes a handshake that has succeeded.
    pub(crate) fn on_succeeded(&mut self, id: HandshakeId) {
        if let Some(handshake) = self.take(id) {
            self.failed.remove(handshake.device);
        }
    }

    /// Removes a handshake that has failed, for instance because the channel was closed. Does nothing after a success.
    pub(crate) fn on_failed(&mut self, id: HandshakeId, now: Instant) {
        if let Some(handshake) = self.take(id) {
            self.failed.insert(handshake.device, now);
        }
    }

    /// Returns the index of the handshake that a new one with that device evicts, or `None` if the limit is not reached.
    fn find_evicted(
        &self,
        device: DeviceAddress,
        now: Instant,
    ) -> Result<Option<usize>, LimitReached> {
        let oldest =
            |matches: &dyn Fn(&PendingHandshake) -> bool| self.pending.iter().position(matches);
        let is_its_own = |handshake: &PendingHandshake| handshake.device == device;
        let own = self.pending.iter().filter(|h| is_its_own(h)).count();
        if own >= MAX_HANDSHAKES_PER_ADDRESS {
            return Ok(oldest(&is_its_own));
        }
        if self.pending.len() < MAX_HANDSHAKES {
            return Ok(None);
        }
        let has_failed = |handshake: &PendingHandshake| self.failed.contains(handshake.device, now);
        let had_its_turn = |handshake: &PendingHandshake| {
            has_failed(handshake) && now.saturating_duration_since(handshake.since) >= MIN_TURN
        };
        let evicted = match self.failed.contains(device, now) {
            true => oldest(&had_its_turn),
            false => oldest(&has_failed).or(Some(0)),
        };
        evicted.map(Some).ok_or(LimitReached)
    }

    fn take(&mut self, id: HandshakeId) -> Option<PendingHandshake> {
        let at = self.pending.iter().position(|h| h.id == id)?;
        Some(self.pending.remove(at))
    }
}

/// The limit is reached, and all handshakes in progress take precedence.
struct LimitReached;

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_radio::address::{Address, AddressType};

    fn device(number: u8) -> DeviceAddress {
        DeviceAddress {
            address: Address([0xc0, 0, 0, 0, 0, number]),
            kind: AddressType::Random,
        }
    }

    struct World {
        handshakes: PendingHandshakes,
        now: Instant,
    }

    impl World {
        fn new() -> Self {
            Self {
                handshakes: PendingHandshakes::default(),
                now: Instant::now(),
            }
        }

        fn channel(&mut self, number: u8) -> (Admission, CancellationToken) {
            let token = CancellationToken::new();
            let admission = self
                .handshakes
                .on_channel(device(number), token.clone(), self.now);
            (admission, token)
        }

        fn admitted(&mut self, number: u8) -> (HandshakeId, CancellationToken) {
            match self.channel(number) {
                (Admission::Admitted(id) | Admission::AdmittedInsteadOf(id, _), token) => {
                    (id, token)
                }
                (Admission::Rejected, _) => panic!("{number} is rejected"),
            }
        }
    }

    #[test]
    fn oldest_handshake_is_evicted_at_the_limit() {
        let mut world = World::new();
        let tokens: Vec<_> = (0..MAX_HANDSHAKES as u8)
            .map(|n| world.admitted(n).1)
            .collect();
        assert!(tokens.iter().all(|token| !token.is_cancelled()));
        for n in 0..3 {
            let (admission, token) = world.channel(100 + n);
            let oldest = device(n);
            assert!(
                matches!(admission, Admission::AdmittedInsteadOf(_, replaced) if replaced ==  oldest)
            );
            let at = usize::from(n);
            assert!(tokens[at].is_cancelled() && !tokens[at + 1].is_cancelled());
            assert!(!token.is_cancelled());
        }
        assert_eq!(world.handshakes.pending.len(), MAX_HANDSHAKES);
    }

    #[test]
    fn one_address_evicts_only_its_own_handshakes() {
        let mut world = World::new();
        let (_, robot) = world.admitted(1);
        let tokens: Vec<_> = (0..100).map(|_| world.admitted(2).1).collect();
        assert!(!robot.is_cancelled());
        assert_eq!(
            world.handshakes.pending.len(),
            1 + MAX_HANDSHAKES_PER_ADDRESS
        );
        // The device most likely still uses its latest channels.
        let is_evicted: Vec<_> = tokens[96..].iter().map(|t| t.is_cancelled()).collect();
        assert_eq!(is_evicted, [true, true, false, false]);
    }

    #[test]
    fn finished_handshake_does_not_count_towards_the_limit() {
        let mut world = World::new();
        for n in 0..=255 {
            let (admission, token) = world.channel(n);
            let Admission::Admitted(id) = admission else {
                panic!("{n}: {admission:?}");
            };
            match n % 2 {
                0 => world.handshakes.on_succeeded(id),
                _ => world.handshakes.on_failed(id, world.now),
            }
            assert!(!token.is_cancelled());
        }
        assert!(world.handshakes.pending.is_empty());
    }

    #[test]
    fn devices_that_dial_repeatedly_do_not_evict_a_new_one() {
        let mut world = World::new();
        for n in 0..12 {
            let (id, _) = world.admitted(n);
            world.handshakes.on_failed(id, world.now);
        }
        (0..MAX_HANDSHAKES as u8).for_each(|n| drop(world.admitted(n)));
        let (admission, robot) = world.channel(100);
        assert!(
            matches!(admission, Admission::AdmittedInsteadOf(_, replaced) if replaced ==  device(0))
        );
        for n in 0..1000_u16 {
            world.now += Duration::from_millis(10);
            world.channel((n % 12) as u8);
        }
        assert!(!robot.is_cancelled());
    }

    #[test]
    fn each_device_that_failed_has_time_for_a_handshake() {
        let mut world = World::new();
        for n in 0..=MAX_HANDSHAKES as u8 {
            let (id, _) = world.admitted(n);
            world.handshakes.on_failed(id, world.now);
        }
        let first = world.admitted(0).1;
        (1..MAX_HANDSHAKES as u8).for_each(|n| drop(world.admitted(n)));
        let late = MAX_HANDSHAKES as u8;
        world.now += MIN_TURN - Duration::from_millis(1);
        assert_eq!(world.channel(late).0, Admission::Rejected);
        assert!(!first.is_cancelled());
        world.now += Duration::from_millis(1);
        assert!(
            matches!(world.channel(late).0, Admission::AdmittedInsteadOf(_, replaced) if replaced == device(0))
        );
        assert!(first.is_cancelled());
    }

    #[test]
    fn device_that_succeeds_counts_as_new_again() {
        let mut world = World::new();
        let (id, _) = world.admitted(0);
        world.handshakes.on_failed(id, world.now);
        let (id, _) = world.admitted(0);
        world.handshakes.on_succeeded(id);
        (1..=MAX_HANDSHAKES as u8).for_each(|n| drop(world.admitted(n)));
        assert!(matches!(
            world.channel(0).0,
            Admission::AdmittedInsteadOf(..)
        ));
    }
}

//! Decides which incoming channels may be in the middle of a handshake. Plain logic, given the time: it is told what happens
//! and answers whose handshake ends; nothing here waits or sends.
//!
//! Anyone in range can open channels and leave it at that, so a place is never reserved: when all are taken, a new channel
//! takes the place of the oldest one. Channels that are opened again and again would then push a robot out before its own
//! handshake is over. That is why an address whose last handshake failed stands back behind all others for a while. To
//! keep a robot out, somebody would need [`PLACES`] new addresses in the fraction of a second that a handshake takes, time
//! after time. A peer whose handshake has succeeded holds no place.
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use crate::{address::DeviceAddress, strangers::Strangers};

/// How many handshakes with incoming channels may be under way at once.
pub(crate) const PLACES: usize = 8;
/// How many of them with the same address. A robot needs one, and another if it dials again before this side has noticed
/// that its last channel is closed.
pub(crate) const PLACES_PER_ADDRESS: usize = 2;
/// How long an address whose last handshake failed keeps its place from others of that kind: enough for a handshake.
const SHORTEST_TURN: Duration = Duration::from_secs(1);

/// Identifies one place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place(u64);

/// The decision about a new channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// It has a place.
    Admitted(Place),
    /// It has the place of another one, whose handshake ends.
    InsteadOf(Place, DeviceAddress),
    /// It is to be closed.
    TurnedAway,
}

#[derive(Debug)]
struct Handshake {
    place: Place,
    device: DeviceAddress,
    since: Instant,
    evicted: CancellationToken,
}

/// The handshakes that are under way, the oldest first.
#[derive(Debug, Default)]
pub(crate) struct Handshakes {
    next: u64,
    under_way: Vec<Handshake>,
    failed: Strangers,
}

impl Handshakes {
    /// Decides about a new channel; `evicted` is cancelled if it loses its place again.
    pub(crate) fn on_channel(
        &mut self,
        device: DeviceAddress,
        evicted: CancellationToken,
        now: Instant,
    ) -> Admission {
        let loser = match self.loser_to(device, now) {
            Ok(loser) => loser,
            Err(NoPlace) => return Admission::TurnedAway,
        };
        let loser = loser.map(|at| {
            let loser = self.under_way.remove(at);
            loser.evicted.cancel();
            self.failed.on_no_proof(loser.device, now);
            loser.device
        });
        let place = Place(self.next);
        self.next += 1;
        self.under_way.push(Handshake {
            place,
            device,
            since: now,
            evicted,
        });
        match loser {
            Some(loser) => Admission::InsteadOf(place, loser),
            None => Admission::Admitted(place),
        }
    }

    /// Frees the place of a handshake that succeeded.
    pub(crate) fn on_succeeded(&mut self, place: Place) {
        if let Some(handshake) = self.take(place) {
            self.failed.forget(handshake.device);
        }
    }

    /// Frees the place of a handshake that failed, for instance because the channel closed.
    pub(crate) fn on_failed(&mut self, place: Place, now: Instant) {
        if let Some(handshake) = self.take(place) {
            self.failed.on_no_proof(handshake.device, now);
        }
    }

    /// Returns the index of the handshake that ends for a new one with that device; `None` if there is a free place.
    fn loser_to(&self, device: DeviceAddress, now: Instant) -> Result<Option<usize>, NoPlace> {
        let oldest = |is_it: &dyn Fn(&Handshake) -> bool| self.under_way.iter().position(is_it);
        let is_its_own = |handshake: &Handshake| handshake.device == device;
        let own = self.under_way.iter().filter(|h| is_its_own(h)).count();
        if own >= PLACES_PER_ADDRESS {
            return Ok(oldest(&is_its_own));
        }
        if self.under_way.len() < PLACES {
            return Ok(None);
        }
        let has_failed = |handshake: &Handshake| self.failed.has(handshake.device, now);
        let had_its_turn = |handshake: &Handshake| {
            has_failed(handshake) && now.saturating_duration_since(handshake.since) >= SHORTEST_TURN
        };
        let loser = match self.failed.has(device, now) {
            true => oldest(&had_its_turn),
            false => oldest(&has_failed).or(Some(0)),
        };
        loser.map(Some).ok_or(NoPlace)
    }

    fn take(&mut self, place: Place) -> Option<Handshake> {
        let at = self.under_way.iter().position(|h| h.place == place)?;
        Some(self.under_way.remove(at))
    }
}

/// All places are taken by devices that come first.
struct NoPlace;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::address::{Address, AddressType};

    fn device(number: u8) -> DeviceAddress {
        DeviceAddress {
            address: Address([0xc0, 0, 0, 0, 0, number]),
            kind: AddressType::Random,
        }
    }

    struct World {
        handshakes: Handshakes,
        now: Instant,
    }

    impl World {
        fn new() -> Self {
            Self {
                handshakes: Handshakes::default(),
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

        fn admitted(&mut self, number: u8) -> (Place, CancellationToken) {
            match self.channel(number) {
                (Admission::Admitted(place) | Admission::InsteadOf(place, _), token) => {
                    (place, token)
                }
                (Admission::TurnedAway, _) => panic!("{number} is turned away"),
            }
        }
    }

    #[test]
    fn the_oldest_gives_way_when_all_places_are_taken() {
        let mut world = World::new();
        let tokens: Vec<_> = (0..PLACES as u8).map(|n| world.admitted(n).1).collect();
        assert!(tokens.iter().all(|token| !token.is_cancelled()));
        for n in 0..3 {
            let (admission, token) = world.channel(100 + n);
            let oldest = device(n);
            assert!(matches!(admission, Admission::InsteadOf(_, loser) if loser == oldest));
            let at = usize::from(n);
            assert!(tokens[at].is_cancelled() && !tokens[at + 1].is_cancelled());
            assert!(!token.is_cancelled());
        }
        assert_eq!(world.handshakes.under_way.len(), PLACES);
    }

    #[test]
    fn one_address_takes_only_its_own_places() {
        let mut world = World::new();
        let (_, robot) = world.admitted(1);
        let tokens: Vec<_> = (0..100).map(|_| world.admitted(2).1).collect();
        assert!(!robot.is_cancelled());
        assert_eq!(world.handshakes.under_way.len(), 1 + PLACES_PER_ADDRESS);
        // The latest channels are those that the device still means.
        let is_evicted: Vec<_> = tokens[96..].iter().map(|t| t.is_cancelled()).collect();
        assert_eq!(is_evicted, [true, true, false, false]);
    }

    #[test]
    fn a_handshake_that_is_over_frees_its_place() {
        let mut world = World::new();
        for n in 0..=255 {
            let (admission, token) = world.channel(n);
            let Admission::Admitted(place) = admission else {
                panic!("{n}: {admission:?}");
            };
            match n % 2 {
                0 => world.handshakes.on_succeeded(place),
                _ => world.handshakes.on_failed(place, world.now),
            }
            assert!(!token.is_cancelled());
        }
        assert!(world.handshakes.under_way.is_empty());
    }

    #[test]
    fn devices_that_come_again_and_again_do_not_push_out_a_new_one() {
        let mut world = World::new();
        for n in 0..12 {
            let (place, _) = world.admitted(n);
            world.handshakes.on_failed(place, world.now);
        }
        (0..PLACES as u8).for_each(|n| drop(world.admitted(n)));
        let (admission, robot) = world.channel(100);
        assert!(matches!(admission, Admission::InsteadOf(_, loser) if loser == device(0)));
        for n in 0..1000_u16 {
            world.now += Duration::from_millis(10);
            world.channel((n % 12) as u8);
        }
        assert!(!robot.is_cancelled());
    }

    #[test]
    fn of_devices_that_failed_each_has_time_for_a_handshake() {
        let mut world = World::new();
        for n in 0..=PLACES as u8 {
            let (place, _) = world.admitted(n);
            world.handshakes.on_failed(place, world.now);
        }
        let first = world.admitted(0).1;
        (1..PLACES as u8).for_each(|n| drop(world.admitted(n)));
        let late = PLACES as u8;
        world.now += SHORTEST_TURN - Duration::from_millis(1);
        assert_eq!(world.channel(late).0, Admission::TurnedAway);
        assert!(!first.is_cancelled());
        world.now += Duration::from_millis(1);
        assert!(matches!(world.channel(late).0, Admission::InsteadOf(_, l) if l == device(0)));
        assert!(first.is_cancelled());
    }

    #[test]
    fn a_device_that_succeeds_counts_as_new_again() {
        let mut world = World::new();
        let (place, _) = world.admitted(0);
        world.handshakes.on_failed(place, world.now);
        let (place, _) = world.admitted(0);
        world.handshakes.on_succeeded(place);
        (1..=PLACES as u8).for_each(|n| drop(world.admitted(n)));
        assert!(matches!(world.channel(0).0, Admission::InsteadOf(..)));
    }
}

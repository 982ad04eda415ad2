//! Owns which devices did not prove that they have this node's secret: whoever dials anyone of a fleet passes them over
//! for a while. Fleets are told apart by 16 bits of a hash, and a stranger may take any name. `handshakes` remembers in the
//! same way whose handshakes failed.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use crate::address::DeviceAddress;

/// How long: a device that was given the right secret meanwhile is found again soon enough.
const PASSED_OVER: Duration = Duration::from_secs(60);
/// How many are remembered; of more the latest. Whoever changes its address with each try is one of many anyway.
const REMEMBERED: usize = 64;

#[derive(Debug, Default)]
pub(crate) struct Strangers(VecDeque<(DeviceAddress, Instant)>);

impl Strangers {
    pub(crate) fn on_no_proof(&mut self, device: DeviceAddress, now: Instant) {
        self.forget(device);
        self.0.truncate(REMEMBERED - 1);
        self.0.push_front((device, now + PASSED_OVER));
    }

    /// Removes a device that has proved itself since.
    pub(crate) fn forget(&mut self, device: DeviceAddress) {
        self.0.retain(|(known, _)| *known != device);
    }

    pub(crate) fn has(&self, device: DeviceAddress, now: Instant) -> bool {
        let is_it = |(known, until): &(DeviceAddress, Instant)| *known == device && now < *until;
        self.0.iter().any(is_it)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::address::{Address, AddressType};

    fn device(number: u8) -> DeviceAddress {
        DeviceAddress {
            address: Address([0, 0, 0, 0, 0, number]),
            kind: AddressType::Public,
        }
    }

    #[test]
    fn a_stranger_is_passed_over_for_a_minute() {
        let (mut strangers, start) = (Strangers::default(), Instant::now());
        strangers.on_no_proof(device(1), start);
        let end = start + PASSED_OVER;
        assert!(strangers.has(device(1), end - Duration::from_millis(1)));
        assert!(!strangers.has(device(1), end));
        strangers.on_no_proof(device(1), start);
        strangers.forget(device(1));
        assert!(!strangers.has(device(1), start));
        assert!(!strangers.has(device(2), start));
    }

    #[test]
    fn a_crowd_of_them_takes_no_more_memory_than_a_few() {
        let (mut strangers, now) = (Strangers::default(), Instant::now());
        for _ in 0..3 {
            (0..=255).for_each(|number| strangers.on_no_proof(device(number), now));
        }
        assert_eq!(strangers.0.len(), REMEMBERED);
        assert!(strangers.has(device(255), now) && !strangers.has(device(0), now));
    }
}

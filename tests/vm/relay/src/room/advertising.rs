//! When a scanner hears an advertiser.

use std::time::Instant;

use super::{controller::DEFAULT_ADVERTISING_INTERVAL, Id, Output, Room};
use crate::hci::Address;

impl Room {
    /// btvirt reports an advertiser within microseconds of the command to scan: before the kernel takes reports at all,
    /// and, as the controller filters repetitions, never again. A real controller hears it at its next advertising
    /// event: after half an interval, in the mean.
    pub(super) fn on_advertising_report(
        &mut self,
        scanner: Id,
        from: Address,
        report: Vec<u8>,
        now: Instant,
    ) {
        let advertiser = self.controllers.values().find(|c| c.is_at(&from));
        let scans = self.controllers.get(&scanner);
        if advertiser.into_iter().chain(scans).any(|c| c.frozen) {
            return;
        }
        let interval = advertiser.map_or(DEFAULT_ADVERTISING_INTERVAL, |c| c.advertising_interval);
        let heard = now + interval / 2;
        let place = self.reports.partition_point(|(other, ..)| *other <= heard);
        self.reports.insert(place, (heard, scanner, report));
    }

    /// Hands on the reports that are due.
    pub(super) fn hear_reports(&mut self, now: Instant) {
        let due = self.reports.partition_point(|(heard, ..)| *heard <= now);
        for (_, id, report) in self.reports.drain(..due) {
            if self.controllers.contains_key(&id) {
                self.outputs.push_back(Output::Host(id, report));
            }
        }
    }
}

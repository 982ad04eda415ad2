//! Decides when a scanner receives an advertisement.

use std::time::Instant;

use super::{controller::DEFAULT_ADVERTISING_INTERVAL, Id, Output, Room};
use crate::hci::Address;

impl Room {
    /// Delays a report of btvirt. btvirt reports an advertiser within microseconds of the scan command: before the
    /// kernel accepts reports, and, because the controller filters duplicates, never again. A real controller receives
    /// the advertisement at its next advertising event: after half an interval on average.
    pub(super) fn on_advertising_report(
        &mut self,
        scanner: Id,
        from: Address,
        report: Vec<u8>,
        now: Instant,
    ) {
        let advertiser = self.controllers.values().find(|c| c.is_at(&from));
        let receiver = self.controllers.get(&scanner);
        if advertiser.into_iter().chain(receiver).any(|c| c.frozen) {
            return;
        }
        let interval = advertiser.map_or(DEFAULT_ADVERTISING_INTERVAL, |c| c.advertising_interval);
        let delivery = now + interval / 2;
        let place = self
            .reports
            .partition_point(|(other, ..)| *other <= delivery);
        self.reports.insert(place, (delivery, scanner, report));
    }

    /// Delivers the reports that are due.
    pub(super) fn deliver_reports(&mut self, now: Instant) {
        let due = self
            .reports
            .partition_point(|(delivery, ..)| *delivery <= now);
        for (_, id, report) in self.reports.drain(..due) {
            if self.controllers.contains_key(&id) {
                self.outputs.push_back(Output::Host(id, report));
            }
        }
    }
}

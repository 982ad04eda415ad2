//! Transmits ACL data: one packet of a controller at a time, at its rate limit.

use std::time::Instant;

use super::{controller::Transmission, Id, Output, Room, CATCH_UP};
use crate::hci::{self, Handle};

impl Room {
    /// Returns the destination of a packet, if its link is up and neither end is frozen.
    fn destination(&self, id: Id, packet: &[u8]) -> Option<(Handle, Id, Handle)> {
        let controller = self.controllers.get(&id).filter(|c| !c.frozen)?;
        let handle = hci::acl_handle(packet)?;
        let (to, to_handle) = controller.links.get(&handle)?.other_end?;
        self.controllers.get(&to).filter(|c| !c.frozen)?;
        Some((handle, to, to_handle))
    }

    /// Starts the transmission of the first packet that can be sent, at `start`, unless one is in progress. A link with
    /// a frozen end does not block others.
    pub(super) fn transmit_next(&mut self, id: Id, start: Instant) {
        let Some(controller) = self.controllers.get(&id).filter(|c| c.on_air.is_none()) else {
            return;
        };
        let Some(index) = controller
            .waiting
            .iter()
            .position(|p| self.destination(id, p).is_some())
        else {
            return;
        };
        self.edit(id, |c| {
            c.on_air = c.waiting.remove(index).map(|packet| Transmission {
                ends: start + c.airtime(&packet),
                packet,
            });
        });
    }

    /// Completes the transmission that is due. Returns whether there was one.
    pub(super) fn deliver_due(&mut self, id: Id, now: Instant) -> bool {
        let Some(controller) = self.controllers.get_mut(&id).filter(|c| !c.frozen) else {
            return false;
        };
        let Some(Transmission { packet, ends }) = controller.on_air.take_if(|t| t.ends <= now)
        else {
            return false;
        };
        let Some((handle, to, to_handle)) = self.destination(id, &packet) else {
            // The peer was frozen in the meantime: retransmit later.
            self.edit(id, |c| c.waiting.push_front(packet));
            return true;
        };
        self.edit(id, |c| {
            c.sent_bytes += (packet.len() - hci::ACL_HEADER_BYTES) as u64
        });
        self.outputs
            .push_back(Output::Host(to, hci::acl_for_peer(packet, to_handle)));
        self.outputs
            .push_back(Output::Host(id, hci::one_packet_completed(handle)));
        let earliest_start = now.checked_sub(CATCH_UP).unwrap_or(now);
        self.transmit_next(id, ends.max(earliest_start));
        true
    }
}

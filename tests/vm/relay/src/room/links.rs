//! Keeps track of the links: joins the two ends that btvirt reports separately, and removes them.

use super::{controller::Link, Id, Room};
use crate::{
    hci::{self, Address, Handle},
    room::{Output, FIRST_HANDLE},
};

impl Room {
    pub(super) fn lowest_free_handle(&self, id: Id) -> Handle {
        let Some(controller) = self.controllers.get(&id) else {
            return FIRST_HANDLE;
        };
        (FIRST_HANDLE..)
            .find(|handle| !controller.links.contains_key(handle))
            .unwrap_or(FIRST_HANDLE)
    }

    /// Removes all links of a controller without a termination. Its peers receive supervision timeouts.
    pub(super) fn forget_links(&mut self, id: Id) {
        let handles: Vec<Handle> = self
            .controllers
            .get(&id)
            .into_iter()
            .flat_map(|c| c.links.keys().copied())
            .collect();
        for handle in handles {
            let other_end = self
                .controllers
                .get(&id)
                .and_then(|c| c.links.get(&handle))
                .and_then(|l| l.other_end);
            self.on_disconnected(id, handle);
            if let Some((other, other_handle)) = other_end {
                self.on_disconnected(other, other_handle);
                let event = hci::disconnection_complete(other_handle, hci::CONNECTION_TIMEOUT);
                self.outputs.push_back(Output::Host(other, event));
            }
        }
    }

    /// Adds one end of a link, and joins it with the other end if that was reported before.
    pub(super) fn on_connected(&mut self, id: Id, handle: Handle, peer: Address) {
        let other_end = self
            .controllers
            .iter()
            .filter(|(i, c)| **i != id && c.is_at(&peer))
            .find_map(|(i, c)| {
                let mine = self.controllers.get(&id)?;
                c.links
                    .iter()
                    .find(|(_, link)| link.other_end.is_none() && mine.is_at(&link.peer))
                    .map(|(other_handle, _)| (*i, *other_handle))
            });
        self.edit(id, |c| {
            let interval = 0;
            c.links.insert(
                handle,
                Link {
                    peer,
                    other_end,
                    interval,
                },
            );
        });
        if let Some((other, other_handle)) = other_end {
            self.edit(other, |c| {
                if let Some(link) = c.links.get_mut(&other_handle) {
                    link.other_end = Some((id, handle));
                }
            });
        }
    }

    /// Records the connection interval of one end of a link.
    pub(super) fn set_interval(&mut self, id: Id, handle: Handle, interval: u16) {
        self.edit(id, |c| {
            if let Some(link) = c.links.get_mut(&handle) {
                link.interval = interval;
            }
        });
    }

    /// Reports the completion of the oldest LE Connection Update of a controller to both ends of the link.
    pub(super) fn complete_update(&mut self, id: Id) {
        let Some(controller) = self.controllers.get_mut(&id) else {
            return;
        };
        let Some((handle, interval)) = controller.updates.pop_front() else {
            return;
        };
        let Some(link) = controller.links.get(&handle) else {
            return;
        };
        for (end, handle) in link.other_end.into_iter().chain([(id, handle)]) {
            self.set_interval(end, handle, interval);
            let event = hci::update_complete(handle, interval);
            self.outputs.push_back(Output::Host(end, event));
        }
    }

    /// Removes one end of a link, with its packets that have not arrived.
    pub(super) fn on_disconnected(&mut self, id: Id, handle: Handle) {
        let mut other_end = None;
        self.edit(id, |c| {
            other_end = c.links.remove(&handle).and_then(|link| link.other_end);
            c.waiting
                .retain(|packet| hci::acl_handle(packet) != Some(handle));
            c.on_air
                .take_if(|t| hci::acl_handle(&t.packet) == Some(handle));
        });
        if let Some((other, other_handle)) = other_end {
            self.edit(other, |c| {
                if let Some(link) = c.links.get_mut(&other_handle) {
                    link.other_end = None;
                }
            });
        }
    }
}

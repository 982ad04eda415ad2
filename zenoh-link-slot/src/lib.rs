//! A Zenoh link whose peer is chosen, changed and taken away while the router runs.
//!
//! Zenoh reads the endpoints it connects to once, when it starts. A program puts those of a [`Slots`] among them; Zenoh
//! then dials every slot for good, waits where it is empty, and dials again when a link has ended. What to dial is whatever
//! [`Dial`] is in the slot at that moment; the link that comes out is that of the real protocol. Ending a link whose slot
//! changed is left to who made it.
mod manager;
mod slots;

pub use manager::{LinkManagerUnicastSlot, SlotLocatorInspector};
pub use slots::{Dial, Slots};

/// The protocol's name in a locator: `slot/<table>.<number>`.
pub const SLOT_LOCATOR_PREFIX: &str = "slot";

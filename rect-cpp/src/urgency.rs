//! Defines the urgencies of messages, as numbers for C.

/// The urgency of messages. In every queue and on a Bluetooth link, messages overtake less urgent ones.
#[repr(C)]
pub enum Urgency {
    /// For data that may wait, e.g. files.
    Bulk = 0,
    /// For most messages. The default.
    Normal = 1,
    /// For messages that must arrive before all others, e.g. emergency stops.
    Urgent = 2,
}

/// The urgencies by their numbers in C.
pub const URGENCIES: [(u32, rect::Urgency); 3] = [
    (Urgency::Bulk as u32, rect::Urgency::Bulk),
    (Urgency::Normal as u32, rect::Urgency::Normal),
    (Urgency::Urgent as u32, rect::Urgency::Urgent),
];

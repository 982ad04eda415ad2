//! Converts the counts of a subscriber's messages, by sender, into the form that C receives.
use rect::Name;
use rect_core::message::gaps::SenderCounts as Counts;

use crate::{
    handle::{self, Object},
    text::Text,
};

/// How many messages of one robot a subscriber has received and missed.
#[repr(C)]
pub struct SenderCounts {
    /// The robot that published or sent the messages.
    pub sender: Text,
    /// Number of messages that arrived.
    pub received: u64,
    /// Number of messages that did not arrive, according to their sequence numbers.
    pub missed: u64,
}

/// The counts of all senders, in alphabetical order. Release it with `rect_drop(&counts.id, ..)`.
#[repr(C)]
pub struct CountsBySender {
    /// The handle.
    pub id: u64,
    /// The counts of the first sender.
    pub items: *const SenderCounts,
    /// Number of senders.
    pub len: usize,
}

struct OwnedCounts {
    _names: Vec<Name>,
    _views: Vec<SenderCounts>,
}

// SAFETY: the views point into the names stored next to them, which never change.
unsafe impl Send for OwnedCounts {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedCounts {}

impl Object for OwnedCounts {
    const KIND: &'static str = "counts by sender";
}

/// Moves the counts into the handle table and returns their C form.
pub fn into_c(counts: Vec<(Name, Counts)>) -> CountsBySender {
    let (names, counts): (Vec<Name>, Vec<Counts>) = counts.into_iter().unzip();
    let of_sender = |(name, counts): (&Name, Counts)| SenderCounts {
        sender: Text::of(name.as_str()),
        received: counts.received,
        missed: counts.missed,
    };
    let views: Vec<SenderCounts> = names.iter().zip(counts).map(of_sender).collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedCounts {
        _names: names,
        _views: views,
    });
    CountsBySender { id, items, len }
}

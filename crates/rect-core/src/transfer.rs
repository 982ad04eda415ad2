//! Transfers: data of any size from one robot to another, sent in pieces, verified at the end and resumed after an
//! interruption.
//!
//! The sender offers the transfer: it queries the receiver, and repeats the query until the transfer has ended. Because
//! an offer contains the name of its sender, the receiver first asks that robot, on that robot's own key, whether it
//! makes the offer ([`admission`]). Then the receiver requests pieces. The sender replies to these requests without
//! keeping state, so that it may be restarted at any time. The receiver keeps track of what it has received, keeps
//! several requests for missing pieces in flight, and optionally stores its state on disk. Because the receiver sets
//! the pace, a slow link never has more of a transfer in its queues than it needs to stay busy ([`window`]), and an
//! interruption loses at most what was in flight.
//!
//! | key | purpose of a query | its payload | the reply |
//! |---|---|---|---|
//! | `<fleet>/<receiver>/@rect/`[`OFFERS`] | offers a transfer | [`Offer`] | [`Answer`] |
//! | `<fleet>/<sender>/@rect/transfer/<id>` | asks for confirmation of an offer | [`Request`] | the [`Offer`] |
//! | the same | requests a piece, or reports the end | [`Request`] | the bytes alone, or an error with a [`Fault`] |
//!
//! | module | responsibility |
//! |---|---|
//! | [`sender`] | decides when to repeat the offer, and when the transfer has finished |
//! | [`admission`] | decides which offers to accept |
//! | [`receiver`] | decides which pieces to request, and when |
//! | [`window`] | decides how much may be in flight, and the size of pieces |
//! | [`push`], [`pull`], [`reception`] | drive a session: which Zenoh actions the above results in |
//! | [`ranges`], [`record`] | keep track of what was received, also across restarts |
pub mod admission;
pub mod answer;
pub mod files;
pub mod offer;
pub mod progress;
mod progress_throttle;
pub mod pull;
pub mod push;
pub mod ranges;
pub mod receiver;
pub mod reception;
pub mod record;
pub mod request;
pub mod sender;
#[cfg(test)]
mod simulated;
#[cfg(test)]
mod tests;
pub mod window;
mod wire;

pub use answer::{Answer, Fault, Refusal};
pub use offer::{Checksum, Offer, OfferError, TransferId};
pub use progress::Progress;
pub use request::Request;

/// The maximum size of a piece, in bytes: the longest reply to a request.
pub const MAX_PIECE_BYTES: u32 = 256 * 1024;

/// The part of the key after `@rect/` at which a robot receives offers.
pub const OFFERS: &str = "inbox";

/// Returns the part of the key after `@rect/` at which a sender replies to requests for a transfer.
pub fn source(id: TransferId) -> String {
    format!("transfer/{id}")
}

//! Owns transfers: bytes of any size from one robot to another, in pieces, resumed where they stopped.
//!
//! An offer names its sender itself, so the receiver first asks that robot on its own key whether it makes the offer
//! ([`inbox`]). Then the receiver pulls. The sender offers (a query to the receiver's inbox, repeated until it is settled) and answers
//! requests for ranges without remembering anything, so that it may be restarted at any time; the receiver knows what it
//! holds, asks for what is missing with several requests on their way at once, and keeps what it holds on disk if it is to.
//! Who pulls sets the pace, so that a slow link never has more of a transfer in its queues than it needs to stay busy
//! ([`window`]), and a cut costs at most what was on its way.
//!
//! | key | a query there | its payload | the reply |
//! |---|---|---|---|
//! | `<fleet>/<receiver>/@rect/inbox` | offers | [`Offer`] | [`Answer`] |
//! | `<fleet>/<sender>/@rect/transfer/<id>` | asks whether it is offered | [`Request`] | the [`Offer`] |
//! | the same | asks for a range, or says that it ended | [`Request`] | the bytes alone, or an error with a [`Fault`] |
//!
//! | part | what it decides |
//! |---|---|
//! | [`sender`] | when to offer again, and when it is over |
//! | [`inbox`] | which offers are taken |
//! | [`receiver`] | what to ask for, and when |
//! | [`window`] | how much at once, and in pieces of which size |
//! | [`ranges`], [`record`] | what is there, also after a restart |
pub mod answer;
pub mod inbox;
pub mod offer;
pub mod progress;
pub mod ranges;
pub mod receiver;
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

/// The largest piece, in bytes: what a sender answers one request with at most.
pub const MAX_PIECE_BYTES: u32 = 256 * 1024;

/// What goes after a robot's `@rect/` for its inbox.
pub const INBOX: &str = "inbox";

/// What goes after a robot's `@rect/` for a transfer that it sends.
pub fn source(id: TransferId) -> String {
    format!("transfer/{id}")
}

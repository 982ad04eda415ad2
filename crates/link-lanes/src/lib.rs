//! The wire protocol of RECT's Zenoh links, without I/O: the messages and the state of both ends of a link.
//!
//! A link begins with a handshake: [`hello`] defines its messages, [`key_agreement`] derives keys from the [`secret`] of a
//! team, and [`sealed_message`] encrypts the messages that follow; [`first_message`] decides which dialler gets a link. After the
//! handshake, [`lanes`] carries Zenoh's batches by priority, [`seal`] encrypts each SDU, and a [`goodbye`] states why a link
//! ends. [`lanes::usage`] counts what a link sends for each key. `PROTOCOL.md` is the specification.
//!
//! All types are given the time and never wait. `zenoh-link-ble` moves their bytes over Bluetooth channels, and
//! `zenoh-link-any` also over TCP.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
pub mod compression;
pub mod first_message;
pub mod goodbye;
pub mod hello;
pub mod key_agreement;
pub mod lanes;
mod node_id;
pub mod seal;
pub mod sealed_message;
pub mod secret;

pub use lanes::usage;
#[cfg(test)]
mod vectors {
    //! Reads the test vectors of the protocol.

    /// Returns the bytes that a vector states in hexadecimal.
    pub(crate) fn bytes(hex: &str) -> Vec<u8> {
        let digit = |at: usize| u8::from_str_radix(&hex[at..at + 2], 16).expect("hexadecimal");
        (0..hex.len()).step_by(2).map(digit).collect()
    }
}

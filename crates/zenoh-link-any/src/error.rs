//! The errors of `any` links.
use std::sync::Arc;

use zenoh_link_ble::{secret_file::SecretError, BleError};

use crate::{locator::LocatorError, meeting::MeetingError, multipath::End};

/// Why a link could not be opened, or has ended.
#[derive(Debug, thiserror::Error)]
pub enum AnyError {
    /// The locator is invalid.
    #[error(transparent)]
    Locator(#[from] LocatorError),
    /// There is a link with the peer already.
    #[error("there is a link with {0} already")]
    AlreadyLinked(String),
    /// The link has ended.
    #[error("the link with {peer} has ended: {end}")]
    Ended {
        /// The peer.
        peer: String,
        /// The reason.
        end: End,
    },
    /// The peer violates the protocol.
    #[error("{peer} does not follow the protocol of links with several paths: {what}")]
    Protocol {
        /// The peer.
        peer: String,
        /// The violation.
        what: String,
    },
    /// The peer has opened the link anew, or has lost its side of it.
    #[error("{0} has opened a new link")]
    Replaced(String),
    /// Zenoh does not need the link any more.
    #[error("the link with {0} was closed")]
    Dropped(String),
    /// A batch is larger than the link accepts.
    #[error("a batch of {size} bytes is over the limit of {max}")]
    BatchTooLarge {
        /// Its size, in bytes.
        size: usize,
        /// The largest batch, in bytes.
        max: usize,
    },
    /// The port for further paths cannot be opened.
    #[error("cannot listen on TCP port {port}: {error}; choose another one with port=")]
    Listen {
        /// The port.
        port: u16,
        /// The system's error.
        #[source]
        error: std::io::Error,
    },
    /// A peer was to be reached by an address without a secret.
    #[error("a link to {0} needs secret=: without one, use tcp/{0}, which is not encrypted")]
    NoSecret(String),
    /// The secret cannot be read.
    #[error(transparent)]
    Secret(#[from] SecretError),
    /// No link can be opened at an address.
    #[error("no link at {address}: {error}")]
    Meeting {
        /// The address, as in the locator.
        address: String,
        /// The reason.
        #[source]
        error: MeetingError,
    },
    /// A peer was reached neither at its address nor over Bluetooth.
    // Short forms of the text keep its end, and the address is what the user has chosen.
    #[error("{ble}; and {network}")]
    Nowhere {
        /// The reason at the address.
        network: Box<AnyError>,
        /// The reason over Bluetooth.
        ble: BleError,
    },
    /// The Bluetooth path failed.
    #[error(transparent)]
    Ble(#[from] BleError),
    /// The end of a link, which several parts report.
    #[error(transparent)]
    Shared(#[from] Arc<AnyError>),
}

//! Defines [`Received`], a complete transfer.
use rect_core::storage::Content;

use super::options::IncomingTransfer;

/// A complete transfer whose checksum was verified.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Received {
    /// The properties of the transfer, which are also accessible through `Deref`: `received.sender`.
    pub transfer: IncomingTransfer,
    /// The content: a file or a buffer.
    pub content: Content,
}

impl Received {
    pub(super) fn new(transfer: IncomingTransfer, content: Content) -> Self {
        Self { transfer, content }
    }
}

impl std::ops::Deref for Received {
    type Target = IncomingTransfer;

    fn deref(&self) -> &IncomingTransfer {
        &self.transfer
    }
}

//! Reads the messages of Zenoh's handshake that a link carries: who the two are, and how long each waits for the other.
use std::time::Duration;

use zenoh_buffers::reader::HasReader;
use zenoh_codec::{RCodec, Zenoh080};
use zenoh_protocol::transport::{TransportBody, TransportMessage};

use super::ZenohNode;

/// A message of Zenoh's handshake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Message {
    /// The dialling side introduces itself.
    InitSyn(ZenohNode),
    /// The accepting side introduces itself.
    InitAck(ZenohNode),
    /// The dialling side proves its login. Contains its lease.
    OpenSyn(Duration),
    /// The accepting side opens the session. Contains its lease.
    OpenAck(Duration),
}

/// Decodes a batch. Returns `None` if it is not a message of the handshake.
pub(super) fn decode(batch: &[u8]) -> Option<Message> {
    let mut reader = batch.reader();
    let message: TransportMessage = Zenoh080::new().read(&mut reader).ok()?;
    match message.body {
        TransportBody::InitSyn(init) => Some(Message::InitSyn(ZenohNode {
            zid: init.zid,
            whatami: init.whatami,
        })),
        TransportBody::InitAck(init) => Some(Message::InitAck(ZenohNode {
            zid: init.zid,
            whatami: init.whatami,
        })),
        TransportBody::OpenSyn(open) => Some(Message::OpenSyn(open.lease)),
        TransportBody::OpenAck(open) => Some(Message::OpenAck(open.lease)),
        _ => None,
    }
}

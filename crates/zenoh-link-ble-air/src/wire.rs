//! Encodes and decodes the messages on the air's socket: postcard, each preceded by its length in four little-endian
//! bytes. A message is decoded completely or rejected; the air checks its content.
use std::io;

use serde::{de::DeserializeOwned, Deserialize, Serialize};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

use super::{
    air::AirStatus,
    condition::Condition,
    message::{Command, Event},
};

/// Version of the protocol. It changes whenever a message changes; both ends must have the same version.
pub(super) const PROTOCOL: u16 = 3;

/// Maximum size of a message in bytes. An SDU has at most 65535 bytes; a status is much shorter.
pub(super) const MAX_MESSAGE_BYTES: usize = 128 * 1024;

/// Messages of a process to the air. The first message is `Attach` or `Control`; all others are `Command`.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum ToAir {
    /// The connection belongs to an adapter.
    Attach { protocol: u16, adapter: String },
    /// The connection is used for one control command.
    Control { protocol: u16, control: Control },
    /// A command of the adapter.
    Command(Command),
}

/// Messages of the air to a process.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum FromAir {
    /// The adapter is attached. Connections have this interval by default, in units of 1.25 ms.
    Attached {
        interval_units: u16,
        /// Whether the adapter can change the interval of an open connection.
        changes_open_connections: bool,
    },
    /// The request was refused, or the client is disconnected. Contains the reason.
    Refused(String),
    /// An event for the adapter.
    Event(Event),
    /// The control command succeeded.
    Done,
    /// Response to `Control::Status`.
    Status(AirStatus),
}

/// Control commands for a running air.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// Cuts the radio contact between all adapters.
    Cut,
    /// Restores the radio contact between all adapters.
    Restore,
    /// Changes the radio condition.
    Condition(Condition),
    /// Switches an adapter on or off.
    Power {
        /// Name of the adapter.
        adapter: String,
        /// New power state.
        on: bool,
    },
    /// Requests the status of the air.
    Status,
}

/// Reasons why a message could not be read or written.
#[derive(Debug, thiserror::Error)]
pub(super) enum WireError {
    #[error("the socket failed")]
    Io(#[from] io::Error),
    #[error("a message of {0} bytes exceeds the maximum length")]
    TooLong(usize),
    #[error("a message that cannot be decoded")]
    Malformed(#[from] postcard::Error),
    #[error("a message with {0} excess bytes")]
    Excess(usize),
}

/// Reads a message. Returns `None` if the other end closed the socket before the length of the message was complete.
pub(super) async fn read<T: DeserializeOwned>(
    from: &mut (impl AsyncRead + Unpin),
) -> Result<Option<T>, WireError> {
    let size = match from.read_u32_le().await {
        Ok(size) => usize::try_from(size).unwrap_or(usize::MAX),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(None),
        Err(error) => return Err(error.into()),
    };
    if size > MAX_MESSAGE_BYTES {
        return Err(WireError::TooLong(size));
    }
    let mut bytes = vec![0; size];
    from.read_exact(&mut bytes).await?;
    decode(&bytes).map(Some)
}

/// Writes a message.
pub(super) async fn write(
    to: &mut (impl AsyncWrite + Unpin),
    message: &impl Serialize,
) -> Result<(), WireError> {
    to.write_all(&encode(message)?).await?;
    Ok(())
}

fn encode(message: &impl Serialize) -> Result<Vec<u8>, WireError> {
    let mut bytes = postcard::to_extend(message, vec![0; 4])?;
    let size = bytes.len() - 4;
    if size > MAX_MESSAGE_BYTES {
        return Err(WireError::TooLong(size));
    }
    let prefix = u32::try_from(size).map_err(|_| WireError::TooLong(size))?;
    bytes[..4].copy_from_slice(&prefix.to_le_bytes());
    Ok(bytes)
}

fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, WireError> {
    let (message, rest) = postcard::take_from_bytes(bytes)?;
    if rest.is_empty() {
        Ok(message)
    } else {
        Err(WireError::Excess(rest.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::ChannelId;

    fn sample() -> ToAir {
        ToAir::Command(Command::Send {
            channel: ChannelId(7),
            sdu: vec![1, 2, 3],
        })
    }

    #[tokio::test]
    async fn reads_the_messages_that_were_written() {
        let mut bytes = Vec::new();
        write(&mut bytes, &sample()).await.expect("fits");
        write(&mut bytes, &sample()).await.expect("fits");
        let mut from = bytes.as_slice();
        for _ in 0..2 {
            let read: Option<ToAir> = read(&mut from).await.expect("well formed");
            assert_eq!(read, Some(sample()));
        }
        assert!(matches!(read::<ToAir>(&mut from).await, Ok(None)));
    }

    #[tokio::test]
    async fn rejects_a_long_message_before_reading_it() {
        let mut from: &[u8] = &[0xff, 0xff, 0xff, 0x7f, 1];
        let error = read::<ToAir>(&mut from).await.expect_err("too long");
        assert!(matches!(error, WireError::TooLong(0x7fff_ffff)));
    }

    #[test]
    fn rejects_truncated_and_overlong_messages() {
        let bytes = encode(&sample()).expect("fits");
        for end in 4..bytes.len() - 1 {
            assert!(decode::<ToAir>(&bytes[4..end]).is_err(), "{end} bytes");
        }
        let mut longer = bytes[4..].to_vec();
        longer.push(0);
        assert!(matches!(
            decode::<ToAir>(&longer),
            Err(WireError::Excess(1))
        ));
    }
}

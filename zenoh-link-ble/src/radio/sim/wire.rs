//! Owns what travels over the air's socket: postcard messages, each after its length in four bytes, little end first.
//! A message is decoded as a whole or not at all; what it means is checked by the air.
use std::io;

use serde::{de::DeserializeOwned, Deserialize, Serialize};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

use super::{
    air::AirStatus,
    condition::Condition,
    message::{Command, Event},
};

/// Changes whenever a message does: both ends must be of one version.
pub(super) const PROTOCOL: u16 = 1;

/// The longest message: an SDU has at most 65535 bytes, a status far less.
pub(super) const MAX_MESSAGE_BYTES: usize = 128 * 1024;

/// What a process tells the air. The first message is `Attach` or `Control`; all others are `Command`.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum ToAir {
    /// This connection is an adapter.
    Attach { protocol: u16, adapter: String },
    /// This connection is a person at the command line.
    Control { protocol: u16, control: Control },
    /// What the adapter asks for.
    Command(Command),
}

/// What the air tells a process.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) enum FromAir {
    /// The adapter is on the air.
    Attached,
    /// The first message could not be granted.
    Refused(String),
    /// What happened to the adapter.
    Event(Event),
    /// The control did what it should.
    Done,
    /// The answer to `Control::Status`.
    Status(AirStatus),
}

/// What can be done to a running air from outside.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// Nobody hears anybody any more.
    Cut,
    /// Everybody hears everybody again.
    Restore,
    /// Changes how good the air is.
    Condition(Condition),
    /// Switches an adapter on or off.
    Power {
        /// The adapter.
        adapter: String,
        /// On.
        on: bool,
    },
    /// Asks who is there.
    Status,
}

/// Why a message could not be read or written.
#[derive(Debug, thiserror::Error)]
pub(super) enum WireError {
    #[error("the socket failed")]
    Io(#[from] io::Error),
    #[error("a message of {0} bytes is longer than any should be")]
    TooLong(usize),
    #[error("a message that cannot be read")]
    Malformed(#[from] postcard::Error),
    #[error("a message with {0} bytes too many")]
    Excess(usize),
}

/// Reads a message; `None` when the other end closed the socket between two messages.
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
    use crate::radio::sim::message::ChannelId;

    fn sample() -> ToAir {
        ToAir::Command(Command::Send {
            channel: ChannelId(7),
            sdu: vec![1, 2, 3],
        })
    }

    #[tokio::test]
    async fn a_message_reads_back_as_it_was_written() {
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
    async fn a_long_message_is_refused_before_it_is_read() {
        let mut from: &[u8] = &[0xff, 0xff, 0xff, 0x7f, 1];
        let error = read::<ToAir>(&mut from).await.expect_err("too long");
        assert!(matches!(error, WireError::TooLong(0x7fff_ffff)));
    }

    #[test]
    fn what_is_cut_short_or_too_long_is_malformed() {
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

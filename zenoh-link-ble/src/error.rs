//! Defines why a link cannot be opened or has ended, with advice for the user, and converts these errors into Zenoh's error
//! type.
use link_lanes::hello::Refusal;
use std::{fmt, sync::Arc, time::Duration};
use zenoh_link_ble_radio::{address::DeviceAddress, RadioError};

use crate::{locator::LocatorError, secret_file::SecretError};

/// Why a link could not be opened, or has ended.
#[derive(Debug, thiserror::Error)]
pub enum BleError {
    /// The locator or one of its options is invalid. Correct it.
    #[error(transparent)]
    Locator(#[from] LocatorError),
    /// The radio reported an error.
    #[error(transparent)]
    Radio(#[from] RadioError),
    /// The `secret=` file contains no valid secret or cannot be read, or the system provides no random numbers for a
    /// nonce.
    #[error(transparent)]
    Secret(#[from] SecretError),
    /// The peer did not prove that it has this side's secret. It belongs to another team, or one of the two has the wrong
    /// file.
    #[error("{peer} did not prove that it has the same secret: another team, or a different secret= file")]
    NoSharedSecret {
        /// Address of the peer.
        peer: DeviceAddress,
    },
    /// `sec=high` needs a secret, from which the passkey for pairing is derived. Give both sides the same `secret=` file.
    #[error("sec=high needs a secret: give both sides the same file as secret=")]
    HighWithoutSecret,
    /// The dial timed out because no advertisement of the target was received. Switch the robot on, move closer, or check
    /// the name.
    #[error("cannot connect to {target}: no advertisement received within {waited:.1?} on {adapter}. Is its router running, in range and listening with that name?")]
    NotFound {
        /// The name or address that was dialled.
        target: String,
        /// Name of the adapter that scanned.
        adapter: String,
        /// How long the dial took.
        waited: Duration,
    },
    /// The dial timed out before or after the discovery of the target. Move closer, or set a longer `timeout=`.
    #[error("cannot connect to {target} within {limit:?}: {step}. Move closer, or set a longer timeout=")]
    DialTimedOut {
        /// The name or address that was dialled.
        target: String,
        /// The step that was not complete.
        step: DialStep,
        /// The timeout of all steps together.
        limit: Duration,
    },
    /// There is a link with that robot already. A pair of robots has only one.
    #[error("{target} is linked already: a pair of robots has one ble link")]
    AlreadyLinked {
        /// The name or address that was dialled.
        target: String,
    },
    /// The peer accepted the channel and refused the link.
    #[error("{peer} refused the link: {refusal}")]
    Refused {
        /// Address of the peer.
        peer: DeviceAddress,
        /// The reason that the peer gave.
        refusal: Refusal,
    },
    /// The peer violated the link protocol. Update both sides to the same version.
    #[error("{peer} does not follow the link protocol: {what}")]
    Protocol {
        /// Address of the peer.
        peer: DeviceAddress,
        /// The violation.
        what: String,
    },
    /// The peer sent its answer on the wrong channel. Its kernel took this side's connection response for the response to
    /// another request with the same identifier, because Linux searches for the identifier among both the sent and the
    /// received requests (`l2cap_le_connect_rsp`). Dialling again resolves it.
    #[error("{peer} answered on the wrong channel, because its kernel confused two requests that crossed; dialling again")]
    Misdirected {
        /// Address of the peer.
        peer: DeviceAddress,
    },
    /// The peer closed the link with a goodbye.
    #[error("{peer} closed the link: {reason}")]
    ClosedByPeer {
        /// Name of the peer, or its address if it has no name.
        peer: String,
        /// The reason in the goodbye, as text for people.
        reason: &'static str,
    },
    /// A newer link with the same peer has replaced this one.
    #[error("a newer link with {peer} replaced this one")]
    Replaced {
        /// Name of the peer, or its address if it has no name.
        peer: String,
    },
    /// The peer has stopped acknowledging. Its router hangs, or it does not follow the protocol.
    #[error("{peer} has acknowledged nothing for {} s: its router hangs, or it does not follow the link protocol", .limit.as_secs())]
    Unacknowledged {
        /// Name of the peer, or its address if it has no name.
        peer: String,
        /// How long this side waited.
        limit: Duration,
    },
    /// Another robot in range uses this name. Give one of the two another `name=`.
    #[error("another robot in range ({other}) uses the name {name} already: give one of the two another name=")]
    NameTaken {
        /// The name that both use.
        name: String,
        /// Address of the other robot.
        other: DeviceAddress,
    },
    /// The link ended earlier, for that reason.
    #[error(transparent)]
    Ended(#[from] Arc<BleError>),
    /// The batch is larger than the link's MTU, which is an error of the caller.
    #[error("a batch of {size} bytes is over the link's mtu of {mtu}")]
    BatchTooLarge {
        /// The size of the batch, in bytes.
        size: usize,
        /// The link's MTU, in bytes.
        mtu: usize,
    },
    /// There is no listener on that adapter.
    #[error("there is no listener on {0}")]
    NoListener(String),
    /// That adapter has a listener already. All peers share it.
    #[error("{0} has a listener already: all peers share one listener per adapter")]
    ListenerExists(String),
    /// The link manager is shutting down, or was asked to stop dialling.
    #[error("the link manager is shutting down")]
    ShuttingDown,
}

/// A step of a dial, in the order of the steps. As text, it states what is not complete during that step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DialStep {
    /// Waiting until another dial to the same target, or the link with it, has ended.
    OtherDial,
    /// Waiting for an advertisement of the target.
    Discovery,
    /// Connecting a channel to the discovered peer.
    Connect,
    /// Performing the handshake on the channel.
    Handshake,
}

impl fmt::Display for DialStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OtherDial => "another dial to it has not ended",
            Self::Discovery => "no advertisement received",
            Self::Connect => "it was discovered, but connecting the channel is not complete",
            Self::Handshake => "the channel is connected, but the handshake is not complete",
        })
    }
}

/// Describes an error with all its causes in one line.
pub(crate) fn describe(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let cause_text = cause.to_string();
        if !text.ends_with(&cause_text) {
            text.push_str(": ");
            text.push_str(&cause_text);
        }
        source = cause.source();
    }
    text
}

/// Converts an error into Zenoh's error type, with all its causes in the text.
pub(crate) fn into_zenoh(error: BleError) -> zenoh_result::Error {
    zenoh_result::zerror!("{}", describe(&error)).into()
}

//! Owns the reasons for which a link cannot be made or ends, each with what to do about it; and the one place
//! where they become Zenoh's error type.
use std::{sync::Arc, time::Duration};

use crate::{
    address::DeviceAddress, hello::Refusal, locator::LocatorError, radio::RadioError,
    secret::SecretError,
};

/// Why there is no link, or no longer one.
#[derive(Debug, thiserror::Error)]
pub enum BleError {
    /// The locator or one of its options is wrong: correct it.
    #[error(transparent)]
    Locator(#[from] LocatorError),
    /// The radio could not do it.
    #[error(transparent)]
    Radio(#[from] RadioError),
    /// The file of `secret=` gives none: correct it.
    #[error(transparent)]
    Secret(#[from] SecretError),
    /// The peer does not know this side's secret: it is of another team, or one of the two has the wrong file.
    #[error("{peer} did not prove that it has the same secret: a stranger, or one of the two has another secret= file")]
    NoSharedSecret {
        /// Who.
        peer: DeviceAddress,
    },
    /// `sec=high` compares a passkey, which is made of the secret.
    #[error("sec=high needs a secret: give both sides the same file as secret=")]
    HighWithoutSecret,
    /// Nobody in range advertises as that name or address: switch the robot on, come nearer, or check the name.
    #[error("nobody in range advertises as {target} (scanned with {adapter} for {waited:.1?}): is its router running, in range and listening with that name?")]
    NotFound {
        /// The name or address dialled.
        target: String,
        /// The adapter that scanned.
        adapter: String,
        /// How long it scanned.
        waited: Duration,
    },
    /// There is a link to that robot already; a pair of robots has one.
    #[error("{target} is linked already: a pair of robots has one ble link")]
    AlreadyLinked {
        /// The name or address dialled.
        target: String,
    },
    /// The peer took the channel but would not make a link.
    #[error("{peer} refused the link: {refusal}")]
    Refused {
        /// Who.
        peer: DeviceAddress,
        /// Its reason.
        refusal: Refusal,
    },
    /// What the peer sent is not this protocol.
    #[error("{peer} does not follow the link protocol: {what}")]
    Protocol {
        /// Who.
        peer: DeviceAddress,
        /// What was wrong.
        what: String,
    },
    /// The peer's kernel took this side's connection response for that to another request of the same number, and sends on
    /// the wrong channel: Linux looks for the number among what it asked and what it was asked (`l2cap_le_connect_rsp`).
    #[error("the answer of {peer} went astray: its kernel mixed up two requests that crossed; dialling again")]
    Astray {
        /// Who.
        peer: DeviceAddress,
    },
    /// The peer said goodbye.
    #[error("{peer} closed the link: {reason}")]
    ClosedByPeer {
        /// Who.
        peer: String,
        /// Its reason in words.
        reason: &'static str,
    },
    /// A newer link with the same peer takes this one's place.
    #[error("a newer link with {peer} replaced this one")]
    Replaced {
        /// Who.
        peer: String,
    },
    /// The peer has stopped acknowledging: its program hangs, or it does not follow the protocol.
    #[error("{peer} has acknowledged nothing for {} s: its program hangs, or it does not follow the link protocol", .limit.as_secs())]
    Unacknowledged {
        /// Who.
        peer: String,
        /// How long it was waited for.
        limit: Duration,
    },
    /// Another robot here uses this name: give one of them another `name=`.
    #[error("another robot in range ({other}) calls itself {name} already: give one of the two another name=")]
    NameTaken {
        /// The name both use.
        name: String,
        /// The other one's address.
        other: DeviceAddress,
    },
    /// The link had ended, for that reason.
    #[error(transparent)]
    Ended(#[from] Arc<BleError>),
    /// A batch does not fit the link (a fault of the caller).
    #[error("a batch of {size} bytes is over the link's mtu of {mtu}")]
    BatchTooLarge {
        /// Its size in bytes.
        size: usize,
        /// The link's MTU in bytes.
        mtu: usize,
    },
    /// That endpoint is not listened on.
    #[error("there is no listener on {0}")]
    NoListener(String),
    /// That adapter has a listener already.
    #[error("{0} has a listener already: one per adapter is enough, peers share it")]
    ListenerExists(String),
    /// The runtime is shutting down.
    #[error("the link manager is shutting down")]
    ShuttingDown,
}

/// The whole chain of causes in one line.
pub(crate) fn in_words(error: &dyn std::error::Error) -> String {
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

/// As Zenoh prints it.
pub(crate) fn into_zenoh(error: BleError) -> zenoh_result::Error {
    zenoh_result::zerror!("{}", in_words(&error)).into()
}

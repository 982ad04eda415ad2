//! Performs the handshake on a new channel, for the dialler and the listener. Each step has a timeout.
//!
//! The messages are defined in [`hello`](crate::protocol::hello), and the proofs in [`secret`](crate::protocol::secret).
use std::{sync::Arc, time::Duration};

use crate::{
    error::BleError,
    protocol::hello::{Challenge, HandshakeMessage, Hello, NodeId, Refusal, MIN_MTU, VERSION},
    protocol::lanes::{credits, HEADER},
    protocol::secret::{nonce, ProofTranscript, Secret, Side},
    radio::{Channel, ChannelOptions, RadioError, Security},
};

/// How long the peer may take for each message: 60 of the longest connection intervals (50 ms) that Linux requests by
/// default.
pub(crate) const MESSAGE_TIMEOUT: Duration = Duration::from_secs(3);

/// How long a refused peer may take to close the channel.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// The largest accepted SDU, in bytes. Kernels before 6.10 grant the peer enough L2CAP credits for one SDU of this
/// size, so it is larger than any batch.
const RECV_MTU: u16 = 16_384;

/// Returns the options with which either side opens a channel.
///
/// # Errors
/// Fails if `security` is high and there is no secret.
pub(crate) fn channel_options(
    security: Security,
    secret: Option<&Secret>,
) -> Result<ChannelOptions, BleError> {
    if security == Security::High && secret.is_none() {
        return Err(BleError::HighWithoutSecret);
    }
    Ok(ChannelOptions {
        recv_mtu: RECV_MTU,
        security,
        passkey: secret.map(Secret::passkey),
    })
}

/// The first SDU of a peer that dialled this node.
pub(crate) enum FirstSdu {
    Hello(Hello),
    /// A bare Zenoh batch.
    Plain(Vec<u8>),
}

/// Sends a hello, waits for the peer's acceptance and returns it. With a secret, both sides first prove that they have
/// it.
///
/// # Errors
/// Fails if the peer refuses, does not prove the secret, violates the protocol or does not answer in time.
pub(crate) async fn dialler_handshake(
    channel: &Arc<dyn Channel>,
    mut own: Hello,
    secret: Option<&Secret>,
) -> Result<Hello, BleError> {
    let (peer, node) = (channel.peer(), own.node);
    own.nonce = secret.map(|_| nonce()).transpose()?;
    let hello = HandshakeMessage::Hello(own).encode();
    channel.send(&hello).await?;
    let answer = match secret {
        Some(secret) => authenticate_listener(channel, node, &hello, secret).await?,
        None => receive_message(channel).await?,
    };
    match answer {
        HandshakeMessage::Accept(hello) if hello.version <= VERSION => Ok(hello),
        HandshakeMessage::Accept(hello) => {
            let chosen = format!(
                "it chose version {}, and this side offered at most {VERSION}",
                hello.version
            );
            Err(protocol(channel, &chosen))
        }
        HandshakeMessage::Refuse(refusal) => Err(BleError::Refused { peer, refusal }),
        HandshakeMessage::Hello(_) => Err(protocol(channel, "it answered a hello with a hello")),
        HandshakeMessage::Challenge(_) | HandshakeMessage::Proof(_) => {
            Err(protocol(channel, "it sent a proof that was not requested"))
        }
    }
}

/// Verifies the listener's proof and sends the dialler's. Returns the listener's answer.
async fn authenticate_listener(
    channel: &Arc<dyn Channel>,
    own: NodeId,
    hello: &[u8],
    secret: &Secret,
) -> Result<HandshakeMessage, BleError> {
    let challenge = match receive_message(channel).await? {
        HandshakeMessage::Challenge(challenge) => challenge,
        // The peer accepts every dialler, and therefore has no secret.
        HandshakeMessage::Accept(_) => return Err(no_shared_secret(channel)),
        other => return Ok(other),
    };
    let transcript = ProofTranscript {
        hello,
        listener: challenge.node,
        nonce: &challenge.nonce,
    };
    // A peer that reflects this node's own challenge proves nothing.
    let is_own = challenge.node == own;
    if is_own || !secret.verify(Side::Listener, transcript, &challenge.proof) {
        // The refusal lets the peer log the reason as well.
        refuse(channel, Refusal::Secret).await?;
        return Err(no_shared_secret(channel));
    }
    let proof = HandshakeMessage::Proof(secret.proof(Side::Dialler, transcript));
    channel.send(&proof.encode()).await?;
    match receive_message(channel).await? {
        HandshakeMessage::Accept(accept) if accept.node != challenge.node => {
            Err(protocol(channel, "it used two node ids in one handshake"))
        }
        answer => Ok(answer),
    }
}

/// Waits for the first SDU of a peer that has dialled this node. With a secret, the hello is returned only after the peer
/// has proved that it has the secret, too.
///
/// # Errors
/// Fails if the peer does not prove the secret, violates the protocol or sends nothing in time.
pub(crate) async fn receive_hello(
    channel: &Arc<dyn Channel>,
    own: NodeId,
    secret: Option<&Secret>,
) -> Result<FirstSdu, BleError> {
    let sdu = receive(channel).await?;
    if is_zenoh_init(&sdu) {
        return match secret {
            // A plain peer cannot prove anything.
            Some(_) => Err(no_shared_secret(channel)),
            None => Ok(FirstSdu::Plain(sdu)),
        };
    }
    let message = match HandshakeMessage::decode(&sdu) {
        Ok(message) => message,
        Err(error) => {
            if let Some(refusal) = error.refusal(&sdu) {
                refuse(channel, refusal).await?;
            }
            return Err(protocol(channel, &error.to_string()));
        }
    };
    let hello = match message {
        HandshakeMessage::Hello(hello) => hello,
        // This answers this node's own hello, but on the channel that the peer has opened.
        HandshakeMessage::Accept(_) | HandshakeMessage::Challenge(_) => {
            return Err(BleError::Misdirected {
                peer: channel.peer(),
            })
        }
        _ => return Err(protocol(channel, "it sent an answer instead of a hello")),
    };
    if let Some(secret) = secret {
        let is_authentic = match hello.nonce {
            Some(_) => authenticate_dialler(channel, own, &sdu, secret).await,
            None => Ok(false),
        };
        match is_authentic {
            Ok(true) => {}
            Ok(false) => {
                refuse(channel, Refusal::Secret).await?;
                return Err(no_shared_secret(channel));
            }
            Err(error) => {
                if let BleError::Protocol { .. } = error {
                    refuse(channel, Refusal::Malformed).await?;
                }
                return Err(error);
            }
        }
    }
    Ok(FirstSdu::Hello(hello))
}

/// Sends the listener's proof and verifies the dialler's. Returns whether that is valid.
async fn authenticate_dialler(
    channel: &Arc<dyn Channel>,
    own: NodeId,
    hello: &[u8],
    secret: &Secret,
) -> Result<bool, BleError> {
    let nonce = nonce()?;
    let transcript = ProofTranscript {
        hello,
        listener: own,
        nonce: &nonce,
    };
    let challenge = HandshakeMessage::Challenge(Challenge {
        node: own,
        nonce,
        proof: secret.proof(Side::Listener, transcript),
    });
    answer(channel, challenge).await?;
    match receive_message(channel).await? {
        HandshakeMessage::Proof(proof) => Ok(secret.verify(Side::Dialler, transcript, &proof)),
        HandshakeMessage::Refuse(Refusal::Secret) => Ok(false),
        _ => Err(protocol(
            channel,
            "it sent something else instead of its proof",
        )),
    }
}

/// Sends a refusal and waits until the peer closes the channel, which it does when it has read the refusal.
pub(crate) async fn refuse(channel: &Arc<dyn Channel>, refusal: Refusal) -> Result<(), BleError> {
    answer(channel, HandshakeMessage::Refuse(refusal)).await?;
    let _ = tokio::time::timeout(REFUSAL_TIMEOUT, drain_until_closed(channel)).await;
    Ok(())
}

/// Sends a message of the handshake in answer to the peer.
pub(crate) async fn answer(
    channel: &Arc<dyn Channel>,
    message: HandshakeMessage,
) -> Result<(), BleError> {
    let sdu = message.encode();
    tokio::time::timeout(MESSAGE_TIMEOUT, channel.send(&sdu))
        .await
        .map_err(|_| timed_out())??;
    Ok(())
}

/// Discards received SDUs of any size until the peer has closed the channel. If this side closed first, the end of the
/// channel could overtake its last message.
pub(crate) async fn drain_until_closed(channel: &Arc<dyn Channel>) {
    let mut sdu = vec![0; usize::from(RECV_MTU)];
    while channel.recv(&mut sdu).await.is_ok() {}
}

/// Returns the number of bytes that this side accepts unacknowledged: what its socket holds without a reader.
pub(crate) fn own_window(channel: &Arc<dyn Channel>) -> u16 {
    credits::window_of(channel.receive_capacity_bytes())
}

/// Returns the MTU of the link: the smallest of what both sides accept, what the channel carries, and what both windows
/// allow. `peer` is `None` for a plain peer.
///
/// # Errors
/// Fails if the MTU would be under [`MIN_MTU`].
pub(crate) fn agreed_mtu(
    channel: &Arc<dyn Channel>,
    own: u16,
    peer: Option<&Hello>,
) -> Result<u16, BleError> {
    let header = peer.map_or(0, |_| HEADER);
    let carried = channel.send_mtu().saturating_sub(header);
    let carried = u16::try_from(carried).unwrap_or(u16::MAX);
    let accepted = peer.map_or(own, |peer| {
        let window = peer.window.min(own_window(channel));
        own.min(peer.mtu).min(credits::largest_batch(window))
    });
    let mtu = accepted.min(carried);
    if mtu < MIN_MTU {
        return Err(protocol(
            channel,
            &format!("its channel carries {carried} bytes, and Zenoh's handshake needs {MIN_MTU}"),
        ));
    }
    Ok(mtu)
}

/// Returns whether the SDU is a Zenoh InitSyn: it has message id 1 in the low five bits, and more than a header.
fn is_zenoh_init(sdu: &[u8]) -> bool {
    sdu.len() > 1 && sdu.first().is_some_and(|byte| byte & 0x1f == 0x01)
}

/// Receives the next message of the handshake.
async fn receive_message(channel: &Arc<dyn Channel>) -> Result<HandshakeMessage, BleError> {
    decoded(channel, &receive(channel).await?)
}

fn decoded(channel: &Arc<dyn Channel>, sdu: &[u8]) -> Result<HandshakeMessage, BleError> {
    HandshakeMessage::decode(sdu).map_err(|error| protocol(channel, &error.to_string()))
}

async fn receive(channel: &Arc<dyn Channel>) -> Result<Vec<u8>, BleError> {
    // The first batch of a plain peer may be longer than any hello, and the kernel truncates an SDU to the buffer.
    let mut sdu = vec![0; usize::from(RECV_MTU)];
    let size = tokio::time::timeout(MESSAGE_TIMEOUT, channel.recv(&mut sdu))
        .await
        .map_err(|_| timed_out())??;
    sdu.truncate(size);
    Ok(sdu)
}

fn timed_out() -> BleError {
    BleError::Radio(RadioError::TimedOut {
        action: "waiting for the peer in the handshake",
        limit: MESSAGE_TIMEOUT,
    })
}

fn no_shared_secret(channel: &Arc<dyn Channel>) -> BleError {
    BleError::NoSharedSecret {
        peer: channel.peer(),
    }
}

fn protocol(channel: &Arc<dyn Channel>, what: &str) -> BleError {
    BleError::Protocol {
        peer: channel.peer(),
        what: what.to_owned(),
    }
}

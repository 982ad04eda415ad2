//! Owns the exchange of hellos on a fresh channel, from either side, each step under a limit.
use std::{sync::Arc, time::Duration};

use crate::{
    error::BleError,
    hello::{Challenge, Hello, NodeId, Opening, Refusal, MIN_MTU, VERSION},
    lanes::{credits, HEADER},
    radio::{Channel, ChannelOptions, RadioError, Security},
    secret::{nonce, Said, Secret, Side},
};

/// How long the other side may take with its hello. Ten of the longest connection intervals BlueZ uses by default.
pub(crate) const HELLO_TIMEOUT: Duration = Duration::from_secs(3);

/// How long a refused peer may take to close.
const REFUSAL_READ: Duration = Duration::from_secs(1);

/// The largest SDU taken, in bytes. On kernels before 6.10 it sets how many credits the peer gets (facts: one SDU in
/// flight), so it is larger than any batch.
const RECV_MTU: u16 = 16_384;

/// What a channel is opened with, from either side.
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

/// Says hello and waits for the answer. With a secret, both sides prove that they have it.
pub(crate) async fn say_hello(
    channel: &Arc<dyn Channel>,
    mut own: Hello,
    secret: Option<&Secret>,
) -> Result<Hello, BleError> {
    let (peer, node) = (channel.peer(), own.node);
    own.nonce = secret.map(|_| nonce()).transpose()?;
    let hello = Opening::Hello(own).encode();
    channel.send(&hello).await?;
    let answer = match secret {
        Some(secret) => prove(channel, node, &hello, secret).await?,
        None => hear(channel).await?,
    };
    match answer {
        Opening::Accept(hello) if hello.version <= VERSION => Ok(hello),
        Opening::Accept(hello) => {
            let chosen = format!("it chose version {} of {VERSION}", hello.version);
            Err(protocol(channel, &chosen))
        }
        Opening::Refuse(refusal) => Err(BleError::Refused { peer, refusal }),
        Opening::Hello(_) => Err(protocol(channel, "a hello in answer to a hello")),
        Opening::Challenge(_) | Opening::Proof(_) => {
            Err(protocol(channel, "a proof that was not asked for"))
        }
    }
}

/// The dialler's part of the proofs; gives the listener's answer to them.
async fn prove(
    channel: &Arc<dyn Channel>,
    own: NodeId,
    hello: &[u8],
    secret: &Secret,
) -> Result<Opening, BleError> {
    let challenge = match hear(channel).await? {
        Opening::Challenge(challenge) => challenge,
        // Whoever takes anybody.
        Opening::Accept(_) => return Err(no_shared_secret(channel)),
        other => return Ok(other),
    };
    let said = Said {
        hello,
        listener: challenge.node,
        nonce: &challenge.nonce,
    };
    // Whoever hands this node's own answer back to it proves nothing.
    let is_own = challenge.node == own;
    if is_own || !secret.is_proved(Side::Listener, said, &challenge.proof) {
        // So that its log says why, too.
        refuse(channel, Refusal::Secret).await?;
        return Err(no_shared_secret(channel));
    }
    let proof = Opening::Proof(secret.proof(Side::Dialler, said));
    channel.send(&proof.encode()).await?;
    match hear(channel).await? {
        Opening::Accept(accept) if accept.node != challenge.node => {
            Err(protocol(channel, "two node ids in one opening"))
        }
        answer => Ok(answer),
    }
}

/// Waits for the first SDU of a peer that dialled this node. With a secret, it is heard only if the peer has it too.
pub(crate) async fn hear_hello(
    channel: &Arc<dyn Channel>,
    own: NodeId,
    secret: Option<&Secret>,
) -> Result<FirstSdu, BleError> {
    let sdu = receive(channel).await?;
    if is_zenoh_init(&sdu) {
        return match secret {
            // It can't prove anything.
            Some(_) => Err(no_shared_secret(channel)),
            None => Ok(FirstSdu::Plain(sdu)),
        };
    }
    let opening = match Opening::decode(&sdu) {
        Ok(opening) => opening,
        Err(error) => {
            if let Some(refusal) = error.refusal(&sdu) {
                refuse(channel, refusal).await?;
            }
            return Err(protocol(channel, &error.to_string()));
        }
    };
    let hello = match opening {
        Opening::Hello(hello) => hello,
        // The answer to this node's own hello, on the channel that the peer opened.
        Opening::Accept(_) | Opening::Challenge(_) => {
            return Err(BleError::Astray {
                peer: channel.peer(),
            })
        }
        _ => return Err(protocol(channel, "an answer where a hello was due")),
    };
    if let Some(secret) = secret {
        let proved = match hello.nonce {
            Some(_) => is_proved(channel, own, &sdu, secret).await,
            None => Ok(false),
        };
        match proved {
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

/// The listener's part of the proofs.
async fn is_proved(
    channel: &Arc<dyn Channel>,
    own: NodeId,
    hello: &[u8],
    secret: &Secret,
) -> Result<bool, BleError> {
    let nonce = nonce()?;
    let said = Said {
        hello,
        listener: own,
        nonce: &nonce,
    };
    let challenge = Opening::Challenge(Challenge {
        node: own,
        nonce,
        proof: secret.proof(Side::Listener, said),
    });
    answer(channel, challenge).await?;
    match hear(channel).await? {
        Opening::Proof(proof) => Ok(secret.is_proved(Side::Dialler, said, &proof)),
        Opening::Refuse(Refusal::Secret) => Ok(false),
        _ => Err(protocol(channel, "no proof where one was due")),
    }
}

/// Sends a refusal, and waits until the peer has closed, which it does when it has read it.
pub(crate) async fn refuse(channel: &Arc<dyn Channel>, refusal: Refusal) -> Result<(), BleError> {
    answer(channel, Opening::Refuse(refusal)).await?;
    let _ = tokio::time::timeout(REFUSAL_READ, until_closed(channel)).await;
    Ok(())
}

/// Answers a hello.
pub(crate) async fn answer(channel: &Arc<dyn Channel>, opening: Opening) -> Result<(), BleError> {
    let sdu = opening.encode();
    tokio::time::timeout(HELLO_TIMEOUT, channel.send(&sdu))
        .await
        .map_err(|_| timed_out())??;
    Ok(())
}

/// Throws away what still comes until the channel is down, whatever its size: closing first could overtake this side's
/// last word.
pub(crate) async fn until_closed(channel: &Arc<dyn Channel>) {
    let mut sdu = vec![0; usize::from(RECV_MTU)];
    while channel.recv(&mut sdu).await.is_ok() {}
}

/// What this side takes unacknowledged: what its socket holds while nobody reads.
pub(crate) fn own_window(channel: &Arc<dyn Channel>) -> u16 {
    credits::window_of(channel.kept_unread_bytes())
}

/// The MTU of the link: the smallest of what both take, what the channel carries, and what both windows are good for.
pub(crate) fn agreed_mtu(
    channel: &Arc<dyn Channel>,
    own: u16,
    peer: Option<&Hello>,
) -> Result<u16, BleError> {
    let header = peer.map_or(0, |_| HEADER);
    let carried = channel.send_mtu().saturating_sub(header);
    let carried = u16::try_from(carried).unwrap_or(u16::MAX);
    let taken = peer.map_or(own, |peer| {
        let window = peer.window.min(own_window(channel));
        own.min(peer.mtu).min(credits::largest_batch(window))
    });
    let mtu = taken.min(carried);
    if mtu < MIN_MTU {
        return Err(protocol(
            channel,
            &format!("its channel carries {carried} bytes, and Zenoh's handshake needs {MIN_MTU}"),
        ));
    }
    Ok(mtu)
}

/// A Zenoh InitSyn: message id 1 in the low five bits, and more than a header.
fn is_zenoh_init(sdu: &[u8]) -> bool {
    sdu.len() > 1 && sdu.first().is_some_and(|byte| byte & 0x1f == 0x01)
}

/// The next message of the opening.
async fn hear(channel: &Arc<dyn Channel>) -> Result<Opening, BleError> {
    decoded(channel, &receive(channel).await?)
}

fn decoded(channel: &Arc<dyn Channel>, sdu: &[u8]) -> Result<Opening, BleError> {
    Opening::decode(sdu).map_err(|error| protocol(channel, &error.to_string()))
}

async fn receive(channel: &Arc<dyn Channel>) -> Result<Vec<u8>, BleError> {
    // A plain peer's first batch may be longer than any hello, and a kernel would cut what is longer than this.
    let mut sdu = vec![0; usize::from(RECV_MTU)];
    let size = tokio::time::timeout(HELLO_TIMEOUT, channel.recv(&mut sdu))
        .await
        .map_err(|_| timed_out())??;
    sdu.truncate(size);
    Ok(sdu)
}

fn timed_out() -> BleError {
    BleError::Radio(RadioError::TimedOut {
        action: "waiting for the peer's hello",
        limit: HELLO_TIMEOUT,
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

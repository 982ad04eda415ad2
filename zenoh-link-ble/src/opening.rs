//! Owns the exchange of hellos on a fresh channel, from either side, each step under a limit.
use std::{sync::Arc, time::Duration};

use crate::{
    dialer::RECV_MTU,
    error::BleError,
    hello::{Hello, Opening, Refusal, MIN_MTU, VERSION},
    lanes::{credits, HEADER},
    radio::{Channel, RadioError},
};

/// How long the other side may take with its hello. Ten of the longest connection intervals BlueZ uses by default.
pub(crate) const HELLO_TIMEOUT: Duration = Duration::from_secs(3);

/// The first SDU of a peer that dialled this node.
pub(crate) enum FirstSdu {
    Hello(Hello),
    /// A bare Zenoh batch.
    Plain(Vec<u8>),
}

/// Says hello and waits for the answer.
pub(crate) async fn say_hello(channel: &Arc<dyn Channel>, own: Hello) -> Result<Hello, BleError> {
    let peer = channel.peer();
    channel.send(&Opening::Hello(own).encode()).await?;
    match Opening::decode(&receive(channel).await?) {
        Ok(Opening::Accept(hello)) if hello.version <= VERSION => Ok(hello),
        Ok(Opening::Accept(_)) => Err(BleError::Refused {
            peer,
            refusal: Refusal::Version,
        }),
        Ok(Opening::Refuse(refusal)) => Err(BleError::Refused { peer, refusal }),
        Ok(Opening::Hello(_)) => Err(protocol(channel, "a hello in answer to a hello")),
        Err(error) => Err(protocol(channel, &error.to_string())),
    }
}

/// Waits for the first SDU of a peer that dialled this node.
pub(crate) async fn hear_hello(channel: &Arc<dyn Channel>) -> Result<FirstSdu, BleError> {
    let sdu = receive(channel).await?;
    if is_zenoh_init(&sdu) {
        return Ok(FirstSdu::Plain(sdu));
    }
    match Opening::decode(&sdu) {
        Ok(Opening::Hello(hello)) => Ok(FirstSdu::Hello(hello)),
        Ok(_) => Err(protocol(channel, "an answer where a hello was due")),
        Err(error) => Err(protocol(channel, &error.to_string())),
    }
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

async fn receive(channel: &Arc<dyn Channel>) -> Result<Vec<u8>, BleError> {
    // A plain peer's first batch may be longer than any hello.
    let mut sdu = vec![0; 1024];
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

fn protocol(channel: &Arc<dyn Channel>, what: &str) -> BleError {
    BleError::Protocol {
        peer: channel.peer(),
        what: what.to_owned(),
    }
}

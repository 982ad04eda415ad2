//! Owns the exchange of hellos on a fresh channel, from either side, each step under a limit.
use std::{sync::Arc, time::Duration};

use crate::{
    error::BleError,
    frame::HEADER,
    hello::{Hello, Opening, Refusal, MIN_MTU, VERSION},
    link::Framing,
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

/// The MTU of the link: the smaller of what both take and what the channel carries.
pub(crate) fn agreed_mtu(
    channel: &Arc<dyn Channel>,
    framing: Framing,
    own: u16,
    peer: Option<u16>,
) -> Result<u16, BleError> {
    let header = match framing {
        Framing::Rect => HEADER,
        Framing::Plain => 0,
    };
    let carried = channel.send_mtu().saturating_sub(header);
    let carried = u16::try_from(carried).unwrap_or(u16::MAX);
    let mtu = own.min(peer.unwrap_or(own)).min(carried);
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

//! Provides the handshake of a raw peer with a secret.
use std::sync::Arc;

use link_lanes::{
    hello::{HandshakeMessage, Hello, Key, VERSION},
    key_agreement::Initiator,
    lanes::sdu::Protection,
    seal::LinkKeys,
    sealed_message,
    secret::Secret,
};
use zenoh_link_ble_radio::{Channel, Radio};

use super::{
    peer::within,
    raw::{answer_to, hello, raw_channel, RawPeer},
};

/// Dials a listener with the same secret and completes the handshake.
pub async fn dial_with_secret(
    from: &Arc<dyn Radio>,
    to: &Arc<dyn Radio>,
    name: &str,
    secret: &Secret,
) -> RawPeer {
    let channel = raw_channel(from, to).await;
    let mut keys = agree(&channel, secret).await;
    let sealed = sealed_message::seal(&mut keys, &HandshakeMessage::Hello(hello(5, name)));
    within("sending", channel.send(&sealed))
        .await
        .expect("sends");
    let answer = receive_sealed(&channel, &mut keys).await;
    let HandshakeMessage::Accept(Hello { window, .. }) = answer else {
        panic!("{answer:?}");
    };
    RawPeer::on(channel, window, Protection::keys(keys))
}

/// Agrees on keys with a listener.
pub async fn agree(channel: &Arc<dyn Channel>, secret: &Secret) -> LinkKeys {
    let started = Initiator::start(secret, &Key::header(VERSION));
    let (initiator, message) = started.expect("starts");
    let version = VERSION;
    let key = HandshakeMessage::Key(Key { version, message });
    match answer_to(channel, &key.encode()).await {
        Some(HandshakeMessage::KeyAnswer(answer)) => {
            initiator
                .finish(&answer.message)
                .expect("the same secret")
                .keys
        }
        other => panic!("a listener with a secret answers with its key, and not {other:?}"),
    }
}

/// Receives a sealed message of the handshake.
pub async fn receive_sealed(channel: &Arc<dyn Channel>, keys: &mut LinkKeys) -> HandshakeMessage {
    let mut buffer = [0; 2000];
    let size = within("the answer", channel.recv(&mut buffer)).await;
    sealed_message::open(keys, &mut buffer[..size.expect("receives")]).expect("sealed and valid")
}

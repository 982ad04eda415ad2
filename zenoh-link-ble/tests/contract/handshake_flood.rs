//! Peers that open channels without completing the handshake, or close them immediately.
use link_lanes::hello::{HandshakeMessage, Hello, NodeId};

use super::World;
use crate::shared::{
    listener::{psm_of, OPTIONS},
    peer::{assert_delivers, within, Peer},
    raw::{answer_to, hello},
};

/// More than the maximum number of pending handshakes.
const CHANNELS: u64 = 12;

/// All pending handshakes belong to peers that never send a hello.
pub async fn accepts_a_robot_despite_silent_channels(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let psm = psm_of(&world.a, &world.b).await;
    let to = world.b.address().await.expect("has an address");
    let mut silent = Vec::new();
    for _ in 0..CHANNELS {
        let channel = within("connecting", world.a.connect(to, psm, OPTIONS)).await;
        silent.push(channel.expect("connects"));
    }
    // Within the timeout of one dial: a robot that is turned away would have to dial again.
    let a = Peer::on(&world.a);
    let near = a
        .dial("ble/wombat-2")
        .await
        .expect("is accepted immediately");
    assert_delivers(&near, &b.incoming().await, b"there").await;
    drop(silent);
}

/// Links that end before Zenoh receives them, because it still holds an earlier one.
pub async fn closed_channel_releases_its_handshake_immediately(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dial("ble/wombat-2").await.expect("dials");
    let held = b.incoming().await;
    let mut buffer = [0; 100];
    let ending = async { tokio::join!(near.close(), held.read(&mut buffer, None)) };
    let (closed, _) = within("closing", ending).await;
    closed.expect("closes");

    let psm = psm_of(&world.a, &world.b).await;
    let to = world.b.address().await.expect("has an address");
    for node in 0..CHANNELS {
        let channel = within("connecting", world.a.connect(to, psm, OPTIONS)).await;
        let channel = channel.expect("connects");
        let hello = HandshakeMessage::Hello(Hello {
            node: NodeId(100 + node),
            ..hello(0, "")
        });
        let answer = answer_to(&channel, &hello.encode()).await;
        assert!(
            matches!(answer, Some(HandshakeMessage::Accept(_))),
            "dial {node}: {answer:?}"
        );
    }
    a.dial("ble/wombat-2")
        .await
        .expect("is accepted immediately");
    held.close().await.expect("closes");
}

//! Peers that open channels and do not finish their handshakes, or do not stay.
use zenoh_link_ble::hello::{Hello, NodeId, Opening};

use super::World;
use crate::shared::{
    listener::{psm_of, OPTIONS},
    peer::{says, within, Peer},
    raw::{answer_to, hello},
};

/// More than the places for handshakes.
const CHANNELS: u64 = 12;

/// All places for handshakes, taken by somebody who never says hello.
pub async fn channels_that_stay_silent_do_not_keep_a_robot_waiting(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let psm = psm_of(&world.a, &world.b).await;
    let to = world.b.address().await.expect("has an address");
    let mut silent = Vec::new();
    for _ in 0..CHANNELS {
        let channel = within("connecting", world.a.connect(to, psm, OPTIONS)).await;
        silent.push(channel.expect("connects"));
    }
    // The limit of one dial: a robot that is turned away would have to dial again.
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("is let in at once");
    says(&near, &b.incoming().await, b"there").await;
    drop(silent);
}

/// Links that ended before Zenoh got them: it holds an earlier one still.
pub async fn a_channel_that_is_closed_frees_its_place_at_once(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("dials");
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
        let hello = Opening::Hello(Hello {
            node: NodeId(100 + node),
            ..hello(0, "")
        });
        let answer = answer_to(&channel, &hello.encode()).await;
        assert!(
            matches!(answer, Some(Opening::Accept(_))),
            "dial {node}: {answer:?}"
        );
    }
    a.dials("ble/wombat-2").await.expect("is let in at once");
    held.close().await.expect("closes");
}

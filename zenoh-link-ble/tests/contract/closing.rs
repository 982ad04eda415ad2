//! Contract of the BLE connections below links: each is closed when no link uses it any more. A peer may not advertise while it is
//! connected, as many microcontrollers, and can be found again only then.
use std::time::Duration;

use link_lanes::{
    goodbye::Goodbye,
    hello::{HandshakeMessage, Refusal},
    lanes::{
        sdu::{Content, Protection},
        Lane,
    },
};
use zenoh_link_commons::LinkUnicast;

use super::{advertisement, World};
use crate::shared::{
    listener::OPTIONS,
    peer::{within, Peer},
    raw::{answer_to, hello, raw_channel, RawPeer, WINDOW},
};

/// Longer than a side waits that has not ended the link itself.
const GRACE: Duration = Duration::from_secs(3);

/// Waits until there is no connection between the two radios.
pub async fn disconnected(world: &World) {
    within("the end of the connection", async {
        while (world.is_connected)().await {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await;
}

/// Dials a peer that does not advertise while it is connected.
async fn dial_quiet_peer(world: &World, a: &Peer) -> (LinkUnicast, RawPeer) {
    let listener = world.b.listen(None, OPTIONS).await.expect("listens");
    let advertised = advertisement(listener.psm(), "raw");
    let accepting = async {
        let advertising = world.b.advertise(&advertised, "raw").await;
        let channel = within("the channel", listener.accept()).await;
        drop(advertising.expect("advertises"));
        let (raw, _) = RawPeer::accept(channel.expect("accepts"), hello(6, "raw")).await;
        raw
    };
    let (dialled, raw) = tokio::join!(a.dial("ble/raw"), accepting);
    (dialled.expect("dials"), raw)
}

async fn assert_ended(link: &LinkUnicast) {
    let end = within("the end", link.read(&mut [0; 100], None)).await;
    assert!(end.is_err(), "the link has ended");
    link.close().await.expect("closes");
}

pub async fn dialler_closes_the_connection_after_the_peer_has_ended_the_link(world: World) {
    let a = Peer::on(&world.a);
    for has_goodbye in [true, false] {
        let (near, mut raw) = dial_quiet_peer(&world, &a).await;
        assert!((world.is_connected)().await);
        if has_goodbye {
            raw.send(Content::Goodbye(Goodbye::Closing.code())).await;
            assert!(raw.receive().await.is_none(), "the channel is down");
        }
        drop(raw);
        assert_ended(&near).await;
        disconnected(&world).await;
    }
}

pub async fn dialler_closes_the_connection_after_a_refusal(world: World) {
    let a = Peer::on(&world.a);
    for _ in 0..2 {
        let listener = world.b.listen(None, OPTIONS).await.expect("listens");
        let advertised = advertisement(listener.psm(), "raw");
        let refusing = async {
            let advertising = world.b.advertise(&advertised, "raw").await;
            let channel = within("the channel", listener.accept()).await;
            let channel = channel.expect("accepts");
            drop(advertising.expect("advertises"));
            channel.recv(&mut [0; 200]).await.expect("a hello");
            let refuse = HandshakeMessage::Refuse(Refusal::Full).encode();
            channel.send(&refuse).await.expect("sends");
            let more = within("the end", channel.recv(&mut [0; 200])).await;
            assert!(more.is_err(), "the dialler closes the channel");
        };
        let (dialled, ()) = tokio::join!(a.dial("ble/raw"), refusing);
        let error = dialled.expect_err("is refused").to_string();
        assert!(error.contains("as many links as it accepts"), "{error}");
        disconnected(&world).await;
    }
}

pub async fn side_that_ends_a_link_closes_its_connection(world: World) {
    let a = Peer::on(&world.a);
    let (near, mut raw) = dial_quiet_peer(&world, &a).await;
    let closing = async {
        assert_eq!(raw.receive_goodbye().await, Some(Goodbye::Closing.code()));
        drop(raw);
    };
    let (closed, ()) = tokio::join!(near.close(), closing);
    closed.expect("closes");
    disconnected(&world).await;
    // The listener ends the link, because the peer violates the protocol.
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
    let far = b.incoming().await;
    raw.send_sdu(vec![0x60, 1]).await;
    let expected = Some(Goodbye::ProtocolError.code());
    let (goodbye, ()) = tokio::join!(raw.receive_goodbye(), assert_ended(&far));
    assert_eq!(goodbye, expected);
    disconnected(&world).await;
}

pub async fn listener_closes_the_connection_of_a_peer_that_it_refuses(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let good = HandshakeMessage::Hello(hello(77, "bad")).encode();
    for (first, is_answered) in [(&good[..20], true), (&b"GET / HTTP/1.1"[..], false)] {
        let channel = raw_channel(&world.a, &world.b).await;
        let answer = answer_to(&channel, first).await;
        assert_eq!(answer.is_some(), is_answered, "{answer:?}");
        // The peer keeps its channel.
        disconnected(&world).await;
    }
    assert!(b.no_more_incoming(), "no link");
}

pub async fn connection_stays_open_while_another_link_uses_it(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let mut one = RawPeer::dial(&world.a, &world.b, "raw").await;
    let ended = b.incoming().await;
    // Another node with the same address.
    let channel = raw_channel(&world.a, &world.b).await;
    let hello = HandshakeMessage::Hello(hello(7, "other")).encode();
    let answer = answer_to(&channel, &hello).await;
    assert!(
        matches!(answer, Some(HandshakeMessage::Accept(_))),
        "{answer:?}"
    );
    let far = b.incoming().await;
    one.send(Content::Goodbye(Goodbye::Closing.code())).await;
    assert!(one.receive().await.is_none(), "the channel is down");
    assert_ended(&ended).await;
    tokio::time::sleep(GRACE).await;
    assert!((world.is_connected)().await);
    let mut other = RawPeer::on(channel, WINDOW, Protection::checks());
    other
        .send(Content::Batch(Lane::first(), b"still here"))
        .await;
    let mut buffer = [0; 100];
    let size = within("the batch", far.read(&mut buffer, None)).await;
    assert_eq!(&buffer[..size.expect("reads")], b"still here");
}

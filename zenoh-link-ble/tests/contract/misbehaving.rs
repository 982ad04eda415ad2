//! Protocol violations of a peer, which must affect only its own link.
use std::{sync::Arc, time::Duration};

use link_lanes::{
    goodbye::Goodbye,
    hello::{HandshakeMessage, Hello, VERSION},
    lanes::{
        credits::cost,
        sdu::{Content, Sealer},
        Lane,
    },
};
use tokio::time::Instant;
use zenoh_link_ble::{locator::DEFAULT_MTU, status};
use zenoh_link_ble_radio::Channel;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::{advertisement, World};
use crate::shared::{
    listener::OPTIONS,
    peer::{assert_delivers, within, Peer},
    raw::{hello, raw_channel, RawPeer},
};

/// Maximum time until the owner of a link learns of a violation: a radio's supervision timeout, plus a margin for slow
/// machines.
const END_LIMIT: Duration = Duration::from_secs(5);

/// Returns a link with a peer that can violate the protocol.
async fn raw_peer(world: &World) -> (RawPeer, LinkUnicast, Peer) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let raw = RawPeer::dial(&world.a, &world.b, "raw").await;
    let far = b.incoming().await;
    (raw, far, b)
}

/// Asserts that the link ends with `reason` for its owner, and with the goodbye `expected_goodbye` for the peer.
pub async fn assert_link_ends(
    raw: &mut RawPeer,
    far: &LinkUnicast,
    reason: &str,
    expected_goodbye: Goodbye,
) {
    let reading = async { while far.read(&mut [0; 9000], None).await.is_ok() {} };
    // The goodbye must be read concurrently: a kernel reports the end of the channel before unread data.
    let (ended, goodbye) = tokio::join!(
        tokio::time::timeout(END_LIMIT, reading),
        raw.receive_goodbye()
    );
    ended.unwrap_or_else(|_| panic!("the link did not end within {END_LIMIT:?}: {reason}"));
    let error = far.read(&mut [0; 9000], None).await.expect_err("it ended");
    let error = error.to_string();
    assert!(error.contains(reason), "{error}");
    assert_eq!(goodbye, Some(expected_goodbye.code()), "{error}");
    assert!(
        far.write_all(b"more", None).await.is_err(),
        "the link has ended"
    );
}

fn lane(number: u8) -> Lane {
    Lane::new(number).expect("there are eight lanes")
}

fn batch(size: usize) -> Vec<u8> {
    Content::Batch(lane(0), &vec![7; size]).encode()
}

async fn wait_until_dropped(channel: &Arc<dyn Channel>) {
    within("being dropped", async {
        while channel.recv(&mut [0; 2000]).await.is_ok() {}
    })
    .await;
}

pub async fn accepts_a_plain_peer_without_a_hello(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let channel = raw_channel(&world.a, &world.b).await;
    // Starts like Zenoh's InitSyn: message id 1.
    let init = [0x01, 0x09, 0x02, 0x03];
    channel.send(&init).await.expect("sends");
    let far = b.incoming().await;
    let mut buffer = [0; 2000];
    let size = within("the first batch", far.read(&mut buffer, None))
        .await
        .expect("reads");
    assert_eq!(&buffer[..size], &init);
    channel.send(b"second").await.expect("sends");
    let size = within("the second batch", far.read(&mut buffer, None))
        .await
        .expect("reads");
    assert_eq!(&buffer[..size], b"second");
    far.write_all(b"answer", None).await.expect("writes");
    let size = within("the answer", channel.recv(&mut buffer))
        .await
        .expect("receives");
    assert_eq!(&buffer[..size], b"answer");
}

pub async fn zenoh_handshake_on_another_lane_ends_the_link(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let init = [0x01, 9, 9];
    for (before, on) in [(0, 1), (0, 7), (1, 5)] {
        let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
        let far = b.incoming().await;
        for _ in 0..before {
            raw.send(Content::Batch(lane(0), &init)).await;
        }
        raw.send(Content::Batch(lane(on), &init)).await;
        let start = Instant::now();
        let reason = format!("a batch arrived on lane {on} during Zenoh's handshake");
        assert_link_ends(&mut raw, &far, &reason, Goodbye::ProtocolError).await;
        assert!(start.elapsed() < END_LIMIT, "{:?}", start.elapsed());
    }
}

/// The peer sends data as soon as it has answered Zenoh's handshake.
pub async fn accepts_all_lanes_after_the_zenoh_handshake(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    raw.send(Content::Batch(lane(0), b"its last part")).await;
    raw.send(Content::Batch(lane(5), b"data")).await;
    raw.send(Content::Batch(lane(1), b"urgent")).await;
    let mut buffer = [0; 100];
    for (priority, batch) in [
        (None, &b"its last part"[..]),
        (Some(Priority::Data), b"data"),
        (Some(Priority::RealTime), b"urgent"),
    ] {
        let size = within("reading", far.read(&mut buffer, priority)).await;
        assert_eq!(&buffer[..size.expect("the link is open")], batch);
    }
}

pub async fn replaced_link_reports_the_replacement_on_both_sides(world: World) {
    let b = Peer::on(&world.b).listen_as("name=replacing").await;
    let last_end = || {
        let nodes = status::nodes()
            .into_iter()
            .filter(|node| node.name == "replacing");
        let peers = nodes
            .flat_map(|node| node.peers)
            .filter(|peer| peer.peer == "raw");
        peers
            .filter_map(|peer| peer.last_end)
            .next_back()
            .map(|end| end.reason)
    };
    let mut old = RawPeer::dial(&world.a, &world.b, "raw").await;
    let ended = b.incoming().await;
    // The same node dials again without having closed its link.
    let dialling = RawPeer::dial(&world.a, &world.b, "raw");
    let mut buffer = [0; 100];
    let reading = ended.read(&mut buffer, None);
    let (new, goodbye, read) = tokio::join!(dialling, old.receive_goodbye(), reading);
    assert_eq!(goodbye, Some(Goodbye::Replaced.code()));
    let reason = "a newer link with raw replaced this one";
    let error = read.expect_err("it ended").to_string();
    assert!(error.contains(reason), "{error}");
    assert_eq!(last_end().as_deref(), Some(reason));

    // The peer replaces the link.
    ended.close().await.expect("closes");
    let (mut new, replaced) = (new, b.incoming().await);
    new.send(Content::Goodbye(Goodbye::Replaced.code())).await;
    let read = within("the end", replaced.read(&mut [0; 100], None)).await;
    let reason = "raw closed the link: a newer link between the two replaces it";
    let error = read.expect_err("it ended").to_string();
    assert!(error.contains(reason), "{error}");
    assert_eq!(last_end().as_deref(), Some(reason));
}

pub async fn drops_garbage_and_silent_peers_without_affecting_others(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let good = Peer::on(&world.a);
    let near = good.dial("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    let whole = HandshakeMessage::Hello(hello(77, "bad")).encode();
    for first in [
        b"GET / HTTP/1.1".to_vec(),
        whole[..9].to_vec(),
        vec![0xff; 1024],
    ] {
        let channel = raw_channel(&world.a, &world.b).await;
        channel.send(&first).await.expect("sends");
        wait_until_dropped(&channel).await;
        assert_delivers(&near, &far, b"the good link is not affected").await;
    }
    let silent = raw_channel(&world.a, &world.b).await;
    wait_until_dropped(&silent).await;
    assert_delivers(&far, &near, b"still there").await;
    assert!(b.no_more_incoming(), "none of them became a link");
}

/// The opposite direction: a listener accepts the channel, and then sends an invalid response or none.
pub async fn dial_fails_on_an_invalid_or_missing_response(world: World) {
    let later = Hello {
        version: VERSION + 1,
        ..hello(6, "raw")
    };
    let answers: [(Vec<u8>, &str); 5] = [
        (
            Vec::new(),
            "waiting for the peer in the handshake took longer",
        ),
        (
            b"HTTP/1.1 200 OK".to_vec(),
            "does not follow the link protocol",
        ),
        (
            HandshakeMessage::Accept(hello(6, "raw")).encode()[..12].to_vec(),
            "does not follow the link protocol",
        ),
        (
            HandshakeMessage::Hello(hello(6, "raw")).encode(),
            "it answered a hello with a hello",
        ),
        (
            HandshakeMessage::Accept(later).encode(),
            &format!(
                "it chose version {}, and this side offered version {VERSION}",
                VERSION + 1
            ),
        ),
    ];
    let a = Peer::on(&world.a);
    for (answer, reason) in answers {
        let listener = world.b.listen(None, OPTIONS).await.expect("listens");
        let advertised = advertisement(listener.psm(), "raw");
        let _advertising = world.b.advertise(&advertised, "raw").await;
        let answering = async {
            let channel = listener.accept().await.expect("accepts");
            channel.recv(&mut [0; 200]).await.expect("a hello");
            if !answer.is_empty() {
                channel.send(&answer).await.expect("sends");
            }
            let more = within("the end", channel.recv(&mut [0; 200])).await;
            assert!(more.is_err(), "a dialler answers nothing");
        };
        let (dialled, ()) = tokio::join!(a.dial("ble/raw"), answering);
        let error = dialled.expect_err("the dial fails").to_string();
        assert!(error.contains(reason), "{error}");
    }
}

pub async fn oversize_batch_ends_the_link(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let just_over = usize::from(DEFAULT_MTU) + 1;
    for size in [just_over, 3000] {
        let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
        let far = b.incoming().await;
        raw.send_sdu(batch(size)).await;
        let reason = format!("is over the mtu of {DEFAULT_MTU}");
        assert_link_ends(&mut raw, &far, &reason, Goodbye::ProtocolError).await;
    }
}

pub async fn repeated_sdu_ends_the_link(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    let sdu = raw.seal(batch(20));
    raw.send_raw(&sdu).await;
    raw.send_raw(&sdu).await;
    let mut buffer = [0; 100];
    let size = far.read(&mut buffer, None).await.expect("the first one");
    assert_eq!(&buffer[..size], [7; 20]);
    assert_link_ends(&mut raw, &far, "damaged or twice", Goodbye::LostOrDamaged).await;
}

pub async fn skipped_sdu_ends_the_link(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    raw.send_sdu(batch(20)).await;
    if let Sealer::Check { number } = &mut raw.protection.out {
        *number += 2;
    }
    raw.send_sdu(batch(20)).await;
    let reason = "2 sdus were lost on the way";
    assert_link_ends(&mut raw, &far, reason, Goodbye::LostOrDamaged).await;
}

pub async fn malformed_sdu_ends_the_link(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    for (sdu, reason) in [
        (vec![0x08, 1], "an sdu of unknown kind 0x08"),
        (
            vec![0x50, 1],
            "an sdu of 2 bytes, which is a wrong length for its kind",
        ),
        (vec![0x60, 1], "an sdu of unknown kind 0x60"),
        (vec![0x13, 1, 0], "an sdu of unknown kind 0x13"),
        (vec![0x00], "an sdu of 1 bytes"),
        (vec![0x10, 1], "an sdu of 2 bytes"),
        (vec![0x20, 1], "an sdu of 2 bytes"),
        (vec![], "an sdu of 2 bytes"),
    ] {
        let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
        let far = b.incoming().await;
        raw.send_sdu(sdu).await;
        assert_link_ends(&mut raw, &far, reason, Goodbye::ProtocolError).await;
    }
}

pub async fn acknowledging_unsent_data_ends_the_link(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    far.write_all(&[7; 500], None).await.expect("writes");
    raw.send(Content::Ack(cost(500) + 1)).await;
    let reason = "acknowledged more than was sent";
    assert_link_ends(&mut raw, &far, reason, Goodbye::ProtocolError).await;
}

pub async fn decreasing_acknowledgement_ends_the_link(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    far.write_all(&[7; 500], None).await.expect("writes");
    assert!(matches!(raw.receive().await, Some(Content::Batch(..))));
    raw.send(Content::Ack(cost(500))).await;
    raw.send(Content::Ack(cost(500) - 1)).await;
    let reason = "acknowledged less than before";
    assert_link_ends(&mut raw, &far, reason, Goodbye::ProtocolError).await;
}

pub async fn ignores_data_after_a_goodbye(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    raw.send_sdu(batch(20)).await;
    raw.send(Content::Goodbye(Goodbye::Closing.code())).await;
    raw.send_sdu(batch(30)).await;
    let mut buffer = [0; 100];
    let size = within("the batch before", far.read(&mut buffer, None)).await;
    assert_eq!(size.expect("arrived"), 20);
    let end = tokio::time::timeout(END_LIMIT, far.read(&mut buffer, None)).await;
    let error = end
        .expect("the read ends")
        .expect_err("the link has ended")
        .to_string();
    assert!(
        error.contains("closed the link: it has finished"),
        "{error}"
    );
    assert_eq!(raw.receive_goodbye().await, None, "the channel is down");
}

/// The closing side waits for the peer to close too, but not forever.
pub async fn close_completes_if_the_peer_keeps_sending(world: World) {
    let (mut raw, far, _b) = raw_peer(&world).await;
    let talking = async {
        assert_eq!(raw.receive_goodbye().await, Some(Goodbye::Closing.code()));
        for _ in 0..3 {
            raw.send_sdu(batch(20)).await;
        }
        assert!(raw.receive().await.is_none(), "the channel is down");
    };
    let (closed, ()) = within("closing", async { tokio::join!(far.close(), talking) }).await;
    closed.expect("closes");
}

//! What a peer may do wrong, and that only its own link suffers.
use std::{sync::Arc, time::Duration};

use tokio::time::Instant;
use zenoh_link_ble::{
    bye::Bye,
    hello::{Hello, Opening},
    lanes::{credits::cost, sdu::Content, Lane},
    locator::DEFAULT_MTU,
    radio::Channel,
    status,
};
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::{advertisement, World};
use crate::shared::{
    listener::OPTIONS,
    peer::{says, within, Peer},
    raw::{hello, raw_channel, RawPeer},
};

/// How soon a link's owner is told what its peer did: a radio's supervision timeout, and some for a slow machine.
const TOLD: Duration = Duration::from_secs(5);

/// A link with a peer that can do as it likes.
async fn odd_peer(world: &World) -> (RawPeer, LinkUnicast, Peer) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let odd = RawPeer::dials(&world.a, &world.b, "odd").await;
    let far = b.incoming().await;
    (odd, far, b)
}

/// The link's owner is told the reason, and so is the peer.
async fn ends_for(odd: &mut RawPeer, far: &LinkUnicast, reason: &str, bye: Bye) {
    let reading = async { while far.read(&mut [0; 9000], None).await.is_ok() {} };
    // A peer that does not listen meanwhile may miss the goodbye: a kernel tells of the end first.
    let (told, goodbye) = tokio::join!(tokio::time::timeout(TOLD, reading), odd.hears_goodbye());
    told.unwrap_or_else(|_| panic!("nobody is told within {TOLD:?} that {reason}"));
    let error = far.read(&mut [0; 9000], None).await.expect_err("it ended");
    let error = error.to_string();
    assert!(error.contains(reason), "{error}");
    assert_eq!(goodbye, Some(bye.code()), "{error}");
    assert!(far.write_all(b"more", None).await.is_err(), "it is over");
}

fn lane(number: u8) -> Lane {
    Lane::new(number).expect("there are eight")
}

fn batch(size: usize) -> Vec<u8> {
    Content::Batch(lane(0), &vec![7; size]).encode()
}

async fn is_dropped(channel: &Arc<dyn Channel>) {
    within("being dropped", async {
        while channel.recv(&mut [0; 2000]).await.is_ok() {}
    })
    .await;
}

pub async fn a_plain_peer_without_hello_is_served(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let channel = raw_channel(&world.a, &world.b).await;
    // Looks like Zenoh's InitSyn: message id 1.
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

pub async fn a_handshake_of_zenoh_on_another_lane_ends_the_link_with_its_reason(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let init = [0x01, 9, 9];
    for (before, on) in [(0, 1), (0, 7), (1, 5)] {
        let mut odd = RawPeer::dials(&world.a, &world.b, "odd").await;
        let far = b.incoming().await;
        for _ in 0..before {
            odd.says(Content::Batch(lane(0), &init)).await;
        }
        odd.says(Content::Batch(lane(on), &init)).await;
        let start = Instant::now();
        let reason = format!("a batch came on lane {on} during Zenoh's handshake");
        ends_for(&mut odd, &far, &reason, Bye::ProtocolError).await;
        assert!(start.elapsed() < TOLD, "{:?}", start.elapsed());
    }
}

/// As a peer does that goes on to send as soon as it has answered Zenoh's handshake.
pub async fn the_other_lanes_may_follow_the_handshake_of_zenoh_at_once(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    odd.says(Content::Batch(lane(0), b"its last part")).await;
    odd.says(Content::Batch(lane(5), b"data")).await;
    odd.says(Content::Batch(lane(1), b"urgent")).await;
    let mut buffer = [0; 100];
    for (priority, batch) in [
        (None, &b"its last part"[..]),
        (Some(Priority::Data), b"data"),
        (Some(Priority::RealTime), b"urgent"),
    ] {
        let size = within("reading", far.read(&mut buffer, priority)).await;
        assert_eq!(&buffer[..size.expect("the link lives")], batch);
    }
}

pub async fn the_goodbye_of_a_replaced_link_says_so_on_both_sides(world: World) {
    let b = Peer::on(&world.b).listens_as("name=replacing").await;
    let last_end = || {
        let nodes = status::nodes()
            .into_iter()
            .filter(|node| node.name == "replacing");
        let peers = nodes
            .flat_map(|node| node.peers)
            .filter(|peer| peer.peer == "odd");
        peers
            .filter_map(|peer| peer.last_end)
            .next_back()
            .map(|end| end.reason)
    };
    let mut old = RawPeer::dials(&world.a, &world.b, "odd").await;
    let ended = b.incoming().await;
    // The same node dials again without having closed its link.
    let dialling = RawPeer::dials(&world.a, &world.b, "odd");
    let mut buffer = [0; 100];
    let reading = ended.read(&mut buffer, None);
    let (new, goodbye, read) = tokio::join!(dialling, old.hears_goodbye(), reading);
    assert_eq!(goodbye, Some(Bye::Replaced.code()));
    let reason = "a newer link with odd replaced this one";
    let error = read.expect_err("it ended").to_string();
    assert!(error.contains(reason), "{error}");
    assert_eq!(last_end().as_deref(), Some(reason));

    // The other way round.
    ended.close().await.expect("closes");
    let (mut new, replaced) = (new, b.incoming().await);
    new.says(Content::Bye(Bye::Replaced.code())).await;
    let read = within("the end", replaced.read(&mut [0; 100], None)).await;
    let reason = "odd closed the link: a newer link between the two replaces it";
    let error = read.expect_err("it ended").to_string();
    assert!(error.contains(reason), "{error}");
    assert_eq!(last_end().as_deref(), Some(reason));
}

pub async fn garbage_half_a_hello_and_silence_are_dropped_and_others_do_not_notice(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let good = Peer::on(&world.a);
    let near = good.dials("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    let whole = Opening::Hello(hello(77, "bad")).encode();
    for first in [
        b"GET / HTTP/1.1".to_vec(),
        whole[..9].to_vec(),
        vec![0xff; 1024],
    ] {
        let channel = raw_channel(&world.a, &world.b).await;
        channel.send(&first).await.expect("sends");
        is_dropped(&channel).await;
        says(&near, &far, b"the good link does not notice").await;
    }
    let silent = raw_channel(&world.a, &world.b).await;
    is_dropped(&silent).await;
    says(&far, &near, b"still there").await;
    assert!(b.no_more_incoming(), "none of them became a link");
}

/// The other way round: who takes the channel, and then answers wrongly or not at all.
pub async fn a_listener_that_answers_wrongly_or_not_at_all_is_given_up(world: World) {
    let later = Hello {
        version: 2,
        ..hello(6, "odd")
    };
    let answers: [(Vec<u8>, &str); 5] = [
        (Vec::new(), "waiting for the peer's hello took longer"),
        (
            b"HTTP/1.1 200 OK".to_vec(),
            "does not follow the link protocol",
        ),
        (
            Opening::Accept(hello(6, "odd")).encode()[..12].to_vec(),
            "does not follow the link protocol",
        ),
        (
            Opening::Hello(hello(6, "odd")).encode(),
            "a hello in answer to a hello",
        ),
        (Opening::Accept(later).encode(), "it chose version 2 of 1"),
    ];
    let a = Peer::on(&world.a);
    for (answer, reason) in answers {
        let listener = world.b.listen(None, OPTIONS).await.expect("listens");
        let advertised = advertisement(listener.psm(), "odd");
        let _advertising = world.b.advertise(&advertised, "odd").await;
        let answering = async {
            let channel = listener.accept().await.expect("accepts");
            channel.recv(&mut [0; 200]).await.expect("a hello");
            if !answer.is_empty() {
                channel.send(&answer).await.expect("sends");
            }
            let more = within("the end", channel.recv(&mut [0; 200])).await;
            assert!(more.is_err(), "a dialler answers nothing");
        };
        let (dialled, ()) = tokio::join!(a.dials("ble/odd"), answering);
        let error = dialled.expect_err("that is no link").to_string();
        assert!(error.contains(reason), "{error}");
    }
}

pub async fn an_oversize_batch_ends_the_link_with_its_reason(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let just_over = usize::from(DEFAULT_MTU) + 1;
    for size in [just_over, 3000] {
        let mut odd = RawPeer::dials(&world.a, &world.b, "odd").await;
        let far = b.incoming().await;
        odd.says_bytes(batch(size)).await;
        let reason = format!("is over the mtu of {DEFAULT_MTU}");
        ends_for(&mut odd, &far, &reason, Bye::ProtocolError).await;
    }
}

pub async fn a_repeated_sdu_ends_the_link_with_its_reason(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    let mut sdu = batch(20);
    zenoh_link_ble::lanes::sdu::seal(0, &mut sdu);
    odd.sends(&sdu).await;
    odd.sends(&sdu).await;
    let mut buffer = [0; 100];
    let size = far.read(&mut buffer, None).await.expect("the first one");
    assert_eq!(&buffer[..size], [7; 20]);
    ends_for(&mut odd, &far, "damaged or twice", Bye::Unverified).await;
}

pub async fn a_skipped_sdu_ends_the_link_with_its_reason(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    odd.says_bytes(batch(20)).await;
    odd.said += 2;
    odd.says_bytes(batch(20)).await;
    let reason = "2 sdus were lost on the way";
    ends_for(&mut odd, &far, reason, Bye::Unverified).await;
}

pub async fn an_unknown_kind_lane_or_size_ends_the_link_with_its_reason(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    for (sdu, reason) in [
        (vec![0x08, 0, 0, 1], "an sdu of unknown kind 0x08"),
        (vec![0x50, 0, 0, 1], "an sdu of unknown kind 0x50"),
        (vec![0x13, 0, 0, 1, 0], "an sdu of unknown kind 0x13"),
        (vec![0x00, 0, 0], "an sdu of 3 bytes"),
        (vec![0x10, 0, 0, 1], "an sdu of 4 bytes"),
        (vec![0x20, 0, 0, 1], "an sdu of 4 bytes"),
        (vec![0x00], "an sdu of 1 bytes"),
    ] {
        let mut odd = RawPeer::dials(&world.a, &world.b, "odd").await;
        let far = b.incoming().await;
        odd.says_bytes(sdu).await;
        ends_for(&mut odd, &far, reason, Bye::ProtocolError).await;
    }
}

pub async fn an_acknowledgement_of_what_was_never_sent_ends_the_link(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    far.write_all(&[7; 500], None).await.expect("writes");
    odd.says(Content::Ack(cost(500) + 1)).await;
    let reason = "acknowledged what was never sent";
    ends_for(&mut odd, &far, reason, Bye::ProtocolError).await;
}

pub async fn an_acknowledgement_taken_back_ends_the_link(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    far.write_all(&[7; 500], None).await.expect("writes");
    assert!(matches!(odd.hears().await, Some(Content::Batch(..))));
    odd.says(Content::Ack(cost(500))).await;
    odd.says(Content::Ack(cost(500) - 1)).await;
    let reason = "took an acknowledgement back";
    ends_for(&mut odd, &far, reason, Bye::ProtocolError).await;
}

pub async fn what_comes_after_a_goodbye_is_not_delivered(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    odd.says_bytes(batch(20)).await;
    odd.says(Content::Bye(Bye::Closing.code())).await;
    odd.says_bytes(batch(30)).await;
    let mut buffer = [0; 100];
    let size = within("the batch before", far.read(&mut buffer, None)).await;
    assert_eq!(size.expect("came in time"), 20);
    let end = tokio::time::timeout(TOLD, far.read(&mut buffer, None)).await;
    let error = end.expect("is told").expect_err("it is over").to_string();
    assert!(error.contains("closed the link: it is done"), "{error}");
    assert_eq!(odd.hears_goodbye().await, None, "the channel is down");
}

/// Whoever closes waits for the peer to close too, but not for ever.
pub async fn a_peer_that_talks_on_after_this_sides_goodbye_does_not_hold_up_the_end(world: World) {
    let (mut odd, far, _b) = odd_peer(&world).await;
    let talking = async {
        assert_eq!(odd.hears_goodbye().await, Some(Bye::Closing.code()));
        for _ in 0..3 {
            odd.says_bytes(batch(20)).await;
        }
        assert!(odd.hears().await.is_none(), "the channel is down");
    };
    let (closed, ()) = within("closing", async { tokio::join!(far.close(), talking) }).await;
    closed.expect("closes");
}

//! Contract of the handshake: the response of a listener to the first SDU of a channel, and the negotiated values.
use std::convert::Infallible;

use link_lanes::{
    hello::{HandshakeMessage, Hello, Refusal, MIN_MTU, VERSION},
    lanes::{
        credits::MIN_WINDOW,
        sdu::{Content, Protection},
        Lane,
    },
};
use zenoh_link_ble_radio::ChannelOptions;

use super::World;
use crate::shared::{
    listener::OPTIONS,
    peer::{within, Peer},
    raw::{answer_to, hello, raw_channel, raw_channel_with},
};

/// A plain link does not exchange MTUs in its handshake; Zenoh's own handshake does.
pub async fn mtu_of_a_plain_link_is_limited_by_the_channel(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2;mtu=300").await;
    for (recv_mtu, mtu) in [(4096, 300), (200, 200)] {
        let options = ChannelOptions {
            recv_mtu,
            ..OPTIONS
        };
        let channel = raw_channel_with(&world.a, &world.b, options).await;
        channel.send(&[0x01, 9, 9]).await.expect("sends");
        assert_eq!(b.incoming().await.get_mtu(), mtu);
    }
}

pub async fn refuses_an_invalid_hello_with_the_reason(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let good = HandshakeMessage::Hello(hello(77, "bad")).encode();
    let with = |change: fn(&mut Hello)| {
        let mut hello = hello(77, "bad");
        change(&mut hello);
        HandshakeMessage::Hello(hello).encode()
    };
    let longer = [good.clone(), vec![0; 129 - good.len()]].concat();
    let not_utf8 = [&good[..good.len() - 1], &[0xff]].concat();
    for (what, first, refusal) in [
        (
            "version 0",
            with(|hello| hello.version = 0),
            Refusal::Version,
        ),
        (
            "an older version",
            with(|hello| hello.version = VERSION - 1),
            Refusal::Version,
        ),
        ("too short", good[..20].to_vec(), Refusal::Malformed),
        ("too long", longer, Refusal::Malformed),
        (
            "its mtu",
            with(|hello| hello.mtu = MIN_MTU - 1),
            Refusal::Malformed,
        ),
        (
            "its window",
            with(|hello| hello.window = MIN_WINDOW - 1),
            Refusal::Malformed,
        ),
        ("its name", not_utf8, Refusal::Malformed),
        (
            "its kind",
            b"RECT\x09\x02 and so on".to_vec(),
            Refusal::Malformed,
        ),
        ("no kind", b"RECT".to_vec(), Refusal::Malformed),
    ] {
        let channel = raw_channel(&world.a, &world.b).await;
        let answer = answer_to(&channel, &first).await;
        assert_eq!(answer, Some(HandshakeMessage::Refuse(refusal)), "{what}");
    }
    let accept = HandshakeMessage::Accept(hello(77, "bad")).encode();
    for (what, first) in [
        ("another protocol", b"GET / HTTP/1.1".to_vec()),
        ("an answer", accept.clone()),
        ("half an answer", accept[..20].to_vec()),
        (
            "a refusal",
            HandshakeMessage::Refuse(Refusal::Full).encode(),
        ),
    ] {
        let channel = raw_channel(&world.a, &world.b).await;
        assert_eq!(answer_to(&channel, &first).await, None, "{what}");
    }
    assert!(b.no_more_incoming(), "none of them became a link");
}

pub async fn answers_a_later_version_with_its_own_version(world: World) {
    let _b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let channel = raw_channel(&world.a, &world.b).await;
    let later = Hello {
        version: 200,
        ..hello(77, "later")
    };
    let answer = answer_to(&channel, &HandshakeMessage::Hello(later).encode()).await;
    assert!(
        matches!(
            answer,
            Some(HandshakeMessage::Accept(Hello {
                version: VERSION,
                ..
            }))
        ),
        "{answer:?}"
    );
}

/// The listener cannot distinguish such a batch from one that is sent after ACCEPT.
pub async fn delivers_a_batch_sent_before_the_accept(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let channel = raw_channel(&world.a, &world.b).await;
    let hello = HandshakeMessage::Hello(hello(5, "hasty")).encode();
    channel.send(&hello).await.expect("sends");
    let first = Lane::first();
    let mut early = Content::Batch(first, &[7; 20]).encode();
    let Ok(_) = (Protection::checks().out).seal(&mut early, |_| Ok::<_, Infallible>(true));
    channel.send(&early).await.expect("sends");
    let far = b.incoming().await;
    let mut buffer = [0; 100];
    let size = within("the early batch", far.read(&mut buffer, None)).await;
    assert_eq!(&buffer[..size.expect("reads")], [7; 20]);
}

//! What a peer may do wrong, and that only its own link suffers.
use std::sync::Arc;

use zenoh_link_ble::{
    frame::Frame,
    hello::{Hello, NodeId, Opening},
    locator::DEFAULT_MTU,
    radio::{Channel, Sighting},
};

use super::{
    link::{says, Peer},
    within, World, OPTIONS,
};

/// Dials a listener by hand, below the link: a peer that can do as it likes.
async fn raw_channel(world: &World) -> Arc<dyn Channel> {
    let to = world.b.address().await.expect("has an address");
    let mut scan = world.a.scan().await.expect("scans");
    let psm = within("seeing the listener", async {
        loop {
            let Sighting {
                device,
                advertisement,
                ..
            } = scan.next().await.expect("goes on scanning");
            if let (true, Some(advertisement)) = (device == to, advertisement) {
                return advertisement.psm;
            }
        }
    })
    .await;
    drop(scan);
    within("connecting", world.a.connect(to, psm, OPTIONS))
        .await
        .expect("connects")
}

fn hello(node: u64, name: &str) -> Vec<u8> {
    Opening::Hello(Hello {
        version: 1,
        node: NodeId(node),
        mtu: DEFAULT_MTU,
        name: name.to_owned(),
    })
    .encode()
}

async fn is_dropped(channel: &Arc<dyn Channel>) {
    within("being dropped", async {
        while channel.recv(&mut [0; 2000]).await.is_ok() {}
    })
    .await;
}

pub async fn a_plain_peer_without_hello_is_served(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let channel = raw_channel(&world).await;
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

pub async fn garbage_half_a_hello_and_silence_are_dropped_and_others_do_not_notice(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let good = Peer::on(&world.a);
    let near = good.dials("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    let whole = hello(77, "bad");
    for first in [
        b"GET / HTTP/1.1".to_vec(),
        whole[..9].to_vec(),
        vec![0xff; 1024],
    ] {
        let channel = raw_channel(&world).await;
        channel.send(&first).await.expect("sends");
        is_dropped(&channel).await;
        says(&near, &far, b"the good link does not notice").await;
    }
    let silent = raw_channel(&world).await;
    is_dropped(&silent).await;
    says(&far, &near, b"still there").await;
    assert!(b.no_more_incoming(), "none of them became a link");
}

pub async fn an_oversize_batch_ends_the_link_with_its_reason(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    for wrong in [
        Frame::Batch(&[0; DEFAULT_MTU as usize + 1]).encode(),
        vec![9, 9, 9],
        vec![0; 3000],
    ] {
        let channel = raw_channel(&world).await;
        channel.send(&hello(5, "odd")).await.expect("sends");
        let mut buffer = [0; 2000];
        let size = within("the answer", channel.recv(&mut buffer))
            .await
            .expect("receives");
        assert!(matches!(
            Opening::decode(&buffer[..size]),
            Ok(Opening::Accept(_))
        ));
        let far = b.incoming().await;
        if wrong != vec![0; 3000] || channel.send_mtu() >= 3000 {
            channel.send(&wrong).await.expect("sends");
            let error = within("the end", far.read(&mut [0; 9000], None)).await;
            let error = error.expect_err("ends").to_string();
            assert!(
                error.contains("link protocol") || error.contains("over the channel"),
                "{error}"
            );
        }
        drop(far);
        is_dropped(&channel).await;
    }
}

//! Batches of declarations, which are compressed for a peer that accepts that.
use link_lanes::{
    compression::{Compressor, Decompressor},
    goodbye::Goodbye,
    hello::Hello,
    lanes::{sdu::Content, Lane},
};
use tokio::time::Instant;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::World;
use crate::shared::{
    peer::{within, Peer},
    raw::{hello, RawPeer},
};

/// The largest batch of these tests, in bytes.
const MAX: usize = 900;

/// Returns a batch that resembles declarations.
fn declarations(first: usize) -> Vec<u8> {
    let keys = (first..first + 20).map(|n| format!("rect/wombat-{n}/gripper/service"));
    [0x25]
        .into_iter()
        .chain(keys.flat_map(String::into_bytes))
        .collect()
}

async fn read(link: &LinkUnicast, priority: Priority) -> Vec<u8> {
    let mut buffer = vec![0; 2000];
    let size = within("reading", link.read(&mut buffer, Some(priority))).await;
    buffer.truncate(size.expect("reads"));
    buffer
}

pub async fn delivers_declarations_in_order_in_both_directions(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let near = Peer::on(&world.a)
        .dial("ble/wombat-2")
        .await
        .expect("dials");
    let far = b.incoming().await;
    for (from, to) in [(&near, &far), (&far, &near)] {
        for n in 0..10 {
            for (batch, priority) in [
                (declarations(n), Priority::Control),
                (vec![4], Priority::Control),
                (declarations(n), Priority::Data),
            ] {
                from.write_all(&batch, Some(priority))
                    .await
                    .expect("writes");
                assert_eq!(read(to, priority).await, batch);
            }
        }
    }
}

pub async fn compresses_declarations_alone_and_only_for_a_peer_that_accepts_that(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    for accepts_compressed in [false, true] {
        let own = Hello {
            accepts_compressed,
            ..hello(5, "raw")
        };
        let mut raw = RawPeer::dial_with(&world.a, &world.b, own).await;
        let far = b.incoming().await;
        let mut into = Decompressor::default();
        for (n, priority) in [
            None,
            Some(Priority::Control),
            Some(Priority::Data),
            Some(Priority::Control),
        ]
        .into_iter()
        .enumerate()
        {
            let batch = declarations(n);
            far.write_all(&batch, priority).await.expect("writes");
            let Some(Content::Batch(lane, sent)) = raw.receive().await else {
                panic!("a batch");
            };
            let is_shorter = accepts_compressed && priority == Some(Priority::Control);
            assert_eq!(sent.len() * 2 < batch.len(), is_shorter, "{priority:?}");
            if lane == Lane::first() {
                assert_eq!(into.decompress(sent.to_vec(), MAX), Ok(batch));
            }
        }
    }
}

pub async fn compressed_batch_that_cannot_be_restored_ends_the_link(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let (large, now) = (vec![7; 60_000], Instant::now().into_std());
    let too_large = Compressor::default().compress(&large, now).into_owned();
    for sent in [&b"\x3f\x07"[..], b"\x1f\x00", &too_large] {
        let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
        let far = b.incoming().await;
        raw.send(Content::Batch(Lane::first(), sent)).await;
        let mut buffer = [0; 2000];
        let reading = far.read(&mut buffer, Some(Priority::Control));
        // A kernel reports the end of the channel before unread data.
        let both = async { tokio::join!(reading, raw.receive_goodbye()) };
        let (read, goodbye) = within("the end", both).await;
        let error = read.expect_err("it ended").to_string();
        assert!(
            error.contains("a compressed batch that is damaged"),
            "{error}"
        );
        assert_eq!(goodbye, Some(Goodbye::ProtocolError.code()));
    }
}

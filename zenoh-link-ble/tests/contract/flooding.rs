//! Limits on the memory that a peer can make this side use: a lane that is not read has a bound.
use link_lanes::{
    goodbye::Goodbye,
    lanes::{credits::cost, receiver::HIGH_WATERMARK, Lane, LANES},
};
use zenoh_link_ble::locator::DEFAULT_MTU;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::World;
use crate::shared::{
    peer::{within, Peer},
    raw::{FloodEnd, RawPeer},
};

/// Size of the largest batch, in bytes.
const SIZE: usize = DEFAULT_MTU as usize;

/// Reads a lane until nothing more arrives, and returns the number of bytes.
async fn readable(link: &LinkUnicast, priority: Priority) -> usize {
    let mut bytes = 0;
    let mut buffer = [0; 2000];
    let timeout = std::time::Duration::from_secs(1);
    let mut read = async || {
        let reading = link.read(&mut buffer, Some(priority));
        tokio::time::timeout(timeout, reading).await
    };
    while let Ok(Ok(size)) = read().await {
        bytes += size;
    }
    bytes
}

/// Returns the cost of `bytes` of the largest batches, as a lane's bound counts them.
fn cost_of(bytes: usize) -> usize {
    bytes / SIZE * usize::from(cost(SIZE))
}

pub async fn bounds_an_unread_lane_of_a_flooding_peer(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
    let far = b.incoming().await;
    let lane = Lane::of(Priority::Data);
    let mut credits = raw.credits();
    let flooding = raw.flood(&mut credits, lane, &[7; SIZE], false);
    let received = within("the goodbye", flooding).await;
    assert_eq!(received, FloodEnd::Goodbye(Goodbye::ProtocolError.code()));
    let max_held = HIGH_WATERMARK + SIZE + usize::from(credits.window());
    let held = cost_of(readable(&far, Priority::Data).await);
    assert!(
        held > HIGH_WATERMARK && held <= max_held,
        "{held} of {max_held} bytes"
    );
    let error = far.read(&mut [0; 2000], None).await.expect_err("it ended");
    let error = error.to_string();
    assert!(error.contains("lane 5 that was stopped"), "{error}");
}

pub async fn delivers_everything_from_full_lanes(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let mut raw = RawPeer::dial(&world.a, &world.b, "raw").await;
    let far = b.incoming().await;
    let mut credits = raw.credits();
    let mut sent = [0; LANES];
    for lane in Lane::all() {
        let before = credits.sent();
        let flooding = raw.flood(&mut credits, lane, &[7; SIZE], true);
        let received = within("the stop", flooding).await;
        assert_eq!(received, FloodEnd::Stop);
        let spent = usize::from(credits.sent().wrapping_sub(before));
        sent[lane.index()] = spent / usize::from(cost(SIZE)) * SIZE;
    }
    let max_held = HIGH_WATERMARK + SIZE + usize::from(credits.window());
    for lane in Lane::all() {
        let priority = Priority::try_from(lane.number()).expect("every lane has a priority");
        let held = readable(&far, priority).await;
        assert_eq!(held, sent[lane.index()], "lane {}", lane.number());
        let held = cost_of(held);
        assert!(
            held > HIGH_WATERMARK && held <= max_held,
            "{held} of {max_held} bytes"
        );
    }
}

//! What a peer can make this side hold: a lane that nobody reads has a bound, whatever comes.
use zenoh_link_ble::{
    bye::Bye,
    lanes::{credits::cost, receiver::HIGH_MARK, Lane, LANES},
    locator::DEFAULT_MTU,
};
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::World;
use crate::shared::{
    peer::{within, Peer},
    raw::{Heard, RawPeer},
};

/// The largest batch.
const SIZE: usize = DEFAULT_MTU as usize;

/// How much can be read of a lane before something else happens.
async fn readable(link: &LinkUnicast, priority: Priority) -> usize {
    let mut bytes = 0;
    let mut buffer = [0; 2000];
    let a_moment = std::time::Duration::from_secs(1);
    let mut read = async || {
        let reading = link.read(&mut buffer, Some(priority));
        tokio::time::timeout(a_moment, reading).await
    };
    while let Ok(Ok(size)) = read().await {
        bytes += size;
    }
    bytes
}

/// What so many bytes of the largest batches take, as a lane's bound counts them.
fn taken(bytes: usize) -> usize {
    bytes / SIZE * usize::from(cost(SIZE))
}

pub async fn a_peer_that_floods_a_lane_nobody_reads_is_held_to_a_bound(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let mut odd = RawPeer::dials(&world.a, &world.b, "odd").await;
    let far = b.incoming().await;
    let lane = Lane::of(Priority::Data);
    let mut credits = odd.credits();
    let flooding = odd.floods(&mut credits, lane, &[7; SIZE], false);
    let heard = within("the goodbye", flooding).await;
    assert_eq!(heard, Heard::Bye(Bye::ProtocolError.code()));
    let most = HIGH_MARK + SIZE + usize::from(credits.window());
    let held = taken(readable(&far, Priority::Data).await);
    assert!(held > HIGH_MARK && held <= most, "{held} of {most} bytes");
    let error = far.read(&mut [0; 2000], None).await.expect_err("it ended");
    let error = error.to_string();
    assert!(error.contains("lane 5 that was stopped"), "{error}");
}

pub async fn a_peer_may_fill_every_lane_and_nothing_is_lost_when_they_are_read(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let mut odd = RawPeer::dials(&world.a, &world.b, "odd").await;
    let far = b.incoming().await;
    let mut credits = odd.credits();
    let mut sent = [0; LANES];
    for lane in Lane::all() {
        let before = credits.sent();
        let flooding = odd.floods(&mut credits, lane, &[7; SIZE], true);
        let heard = within("being stopped", flooding).await;
        assert_eq!(heard, Heard::Stop);
        let spent = usize::from(credits.sent().wrapping_sub(before));
        sent[lane.index()] = spent / usize::from(cost(SIZE)) * SIZE;
    }
    let most = HIGH_MARK + SIZE + usize::from(credits.window());
    for lane in Lane::all() {
        let priority = Priority::try_from(lane.number()).expect("there is one for each");
        let held = readable(&far, priority).await;
        assert_eq!(held, sent[lane.index()], "lane {}", lane.number());
        let held = taken(held);
        assert!(held > HIGH_MARK && held <= most, "{held} of {most} bytes");
    }
}

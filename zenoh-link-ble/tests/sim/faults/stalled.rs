//! Tests a connected peer that reads nothing, or slowly, or sends without reading.
use std::time::Duration;

use link_lanes::{
    goodbye::Goodbye,
    lanes::{
        ack_timer::ACK_TIMEOUT,
        credits::{cost, Acks},
        receiver::HIGH_WATERMARK,
        sdu::Content,
        Lane, LANES,
    },
};
use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble::locator::DEFAULT_MTU;
use zenoh_link_ble_air::{Condition, RECEIVE_BUFFER_BYTES};
use zenoh_link_ble_radio::Radio;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::cuts::EVENTS;
use crate::shared::{
    heap::live_bytes,
    pair::{Pair, SUPERVISION},
    peer::within,
    raw::{FloodEnd, RawPeer, WINDOW},
};

/// Interval at which Zenoh sends keep-alives on an idle link.
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
const MTU: usize = DEFAULT_MTU as usize;
const BATCH: [u8; MTU] = [7; MTU];

async fn with_raw_peer(seed: u64) -> (Pair, RawPeer, LinkUnicast) {
    let pair = Pair::on(Condition::Room, seed).await;
    let near: std::sync::Arc<dyn Radio> = pair.air.radio("sim-near").await.expect("is attached");
    let far: std::sync::Arc<dyn Radio> = pair.air.radio("sim-far").await.expect("is attached");
    let raw = RawPeer::dial(&near, &far, "raw").await;
    let link = pair.far.incoming().await;
    (pair, raw, link)
}

async fn writes_until_it_fails(link: &LinkUnicast) -> String {
    loop {
        if let Err(error) = link.write_all(&BATCH, Some(Priority::Data)).await {
            return error.to_string();
        }
    }
}

/// The peer's radio responds, so no supervision timeout ends the link.
#[tokio::test(start_paused = true)]
async fn ends_the_link_with_a_frozen_peer_for_readers_and_writers() {
    let (pair, raw, link) = with_raw_peer(1).await;
    let start = Instant::now();
    let limit = ACK_TIMEOUT + SUPERVISION;
    let mut buffer = [0; 100];
    let ended = timeout(limit, async {
        tokio::join!(writes_until_it_fails(&link), link.read(&mut buffer, None))
    });
    let (written, read) = ended.await.expect("both end in time");
    let read = read.expect_err("the link ended").to_string();
    for error in [&written, &read] {
        let reason = "raw has acknowledged nothing for 20 s";
        assert!(error.contains(reason), "{error}");
    }
    assert!(start.elapsed() >= ACK_TIMEOUT, "too soon");
    assert_eq!(pair.far.manager.link_counts().links, 0);
    drop(raw);
}

/// The peer's program reads and sends, so neither a supervision timeout nor Zenoh's lease ends the link.
#[tokio::test(start_paused = true)]
async fn ends_the_link_with_a_peer_that_stops_acknowledging() {
    for batches in [1, 3, 40] {
        let (pair, mut raw, link) = with_raw_peer(7).await;
        let start = Instant::now();
        let bulk = async {
            for _ in 0..batches {
                // Batches beyond the window wait here until the link ends.
                if link.write_all(&BATCH, Some(Priority::Data)).await.is_err() {
                    break;
                }
            }
        };
        let keep_alives = async {
            while link.write_all(&[4], Some(Priority::Control)).await.is_ok() {
                sleep(KEEP_ALIVE).await;
            }
        };
        let ended = async { tokio::join!(bulk, keep_alives, raw.receive_goodbye()).2 };
        let goodbye = timeout(ACK_TIMEOUT + KEEP_ALIVE + SUPERVISION, ended).await;
        let goodbye = goodbye.unwrap_or_else(|_| panic!("{batches} batches: the link did not end"));
        assert_eq!(goodbye, Some(Goodbye::Unacknowledged.code()));
        assert!(start.elapsed() >= ACK_TIMEOUT, "too soon");
        let error = link
            .read(&mut [0; 10], None)
            .await
            .expect_err("the link ended");
        let error = error.to_string();
        assert!(error.contains("raw has acknowledged nothing"), "{error}");
        assert_eq!(pair.far.manager.link_counts().links, 0);
    }
}

/// A few bytes need not be acknowledged.
#[tokio::test(start_paused = true)]
async fn keeps_a_link_with_only_keep_alives() {
    let pair = Pair::on(Condition::Room, 8).await;
    let (near, far) = pair.link().await;
    let mut buffer = [0; 10];
    for _ in 0..100 {
        near.write_all(&[4], Some(Priority::Control))
            .await
            .expect("the link is open");
        sleep(KEEP_ALIVE).await;
        let size = far.read(&mut buffer, Some(Priority::Control)).await;
        assert_eq!(size.expect("the link is open"), 1);
    }
}

/// A peer that reads one SDU per second is slow, but not lost.
#[tokio::test(start_paused = true)]
async fn delivers_everything_to_a_slow_peer() {
    const BATCHES: usize = 120;
    let (_pair, mut raw, link) = with_raw_peer(2).await;
    let mut acks = Acks::new(WINDOW);
    let writing = async {
        for _ in 0..BATCHES {
            let written = link.write_all(&BATCH, Some(Priority::Data)).await;
            written.expect("the link is open");
        }
    };
    let reading = async {
        for n in 0..BATCHES {
            sleep(Duration::from_secs(1)).await;
            let received = raw.receive().await;
            assert!(
                matches!(received, Some(Content::Batch(_, batch)) if batch == BATCH),
                "{n}"
            );
            acks.on_received(cost(BATCH.len())).expect("in the window");
            if let Some(total) = acks.due() {
                raw.send(Content::Ack(total)).await;
            }
        }
    };
    tokio::join!(writing, reading);
    let (closed, code) = within("closing", async {
        let goodbye = async {
            let code = raw.receive_goodbye().await;
            drop(raw);
            code
        };
        tokio::join!(link.close(), goodbye)
    })
    .await;
    closed.expect("closes");
    assert_eq!(code, Some(Goodbye::Closing.code()));
}

/// The peer reads no acknowledgements, so it may send no more than its window.
#[tokio::test(start_paused = true)]
async fn ends_the_link_with_a_peer_that_exceeds_its_credits() {
    let (_pair, mut raw, link) = with_raw_peer(3).await;
    let reading = async {
        let mut buffer = BATCH;
        let mut batches = 0;
        loop {
            match link.read(&mut buffer, Some(Priority::Data)).await {
                Ok(_) => batches += 1,
                Err(error) => return (batches, error.to_string()),
            }
        }
    };
    let window = usize::from(raw.credits().window());
    let talking = async {
        loop {
            let lane = Lane::of(Priority::Data);
            raw.send(Content::Batch(lane, &BATCH)).await;
        }
    };
    let (batches, error) = tokio::select! {
        ended = reading => ended,
        () = talking => unreachable!("it sends forever"),
    };
    // Both controllers hold acknowledgements that the peer has not read, each for a quarter of the window plus one
    // batch.
    let acknowledged = RECEIVE_BUFFER_BYTES / 247 * window / 4;
    assert!(
        batches * BATCH.len() < 3 * acknowledged,
        "{batches} batches"
    );
    assert!(error.contains("more than its credits allow"), "{error}");
}

/// A program that does not read blocks only its own lane.
#[tokio::test(start_paused = true)]
async fn an_unread_lane_does_not_block_others_or_lose_batches() {
    const BATCHES: usize = 100;
    let pair = Pair::on(Condition::Room, 4).await;
    let (near, far) = pair.link().await;
    let bulk = async {
        for n in 0..BATCHES {
            let batch = [n as u8; MTU];
            near.write_all(&batch, Some(Priority::DataLow))
                .await
                .expect("there is room");
        }
    };
    bulk.await;
    sleep(Duration::from_secs(60)).await;
    let mut buffer = [0; MTU];
    for n in 0..20 {
        let start = Instant::now();
        near.write_all(&[n; 50], Some(Priority::RealTime))
            .await
            .expect("writes");
        let size = far.read(&mut buffer, Some(Priority::RealTime)).await;
        assert_eq!(&buffer[..size.expect("reads")], [n; 50]);
        assert!(start.elapsed() <= EVENTS, "{:?}", start.elapsed());
    }
    for n in 0..BATCHES {
        let size = far.read(&mut buffer, Some(Priority::DataLow)).await;
        assert_eq!(&buffer[..size.expect("reads")], [n as u8; MTU]);
    }
}

#[tokio::test(start_paused = true)]
async fn all_readers_of_a_lane_receive_the_end() {
    let pair = Pair::on(Condition::Room, 5).await;
    let (near, far) = pair.link().await;
    let readers = [(); 3].map(|()| async { near.read(&mut [0; 100], None).await.map(drop) });
    let cutting = async { far.close().await };
    let ended = async { tokio::join!(futures::future::join_all(readers), cutting).0 };
    for result in within("the end", ended).await {
        let error = result.expect_err("the link ended").to_string();
        assert!(
            error.contains("closed the link: it has finished"),
            "{error}"
        );
    }
}

/// Small batches cost the most: the overhead of the queue for each batch counts too.
#[tokio::test(start_paused = true)]
async fn bounds_the_memory_a_peer_can_use_for_any_batch_size() {
    for size in [1, 20, MTU] {
        let (_pair, mut raw, link) = with_raw_peer(6).await;
        let mut credits = raw.credits();
        let before = live_bytes();
        for lane in Lane::all() {
            let received = raw.flood(&mut credits, lane, &BATCH[..size], true).await;
            assert_eq!(received, FloodEnd::Stop);
        }
        let held = live_bytes() - before;
        let documented = LANES * (HIGH_WATERMARK + MTU + usize::from(credits.window()));
        println!("batches of {size}: {held} bytes in use, {documented} documented");
        assert!(
            held > LANES as isize * HIGH_WATERMARK as isize / 2,
            "{held} bytes"
        );
        // A queue has up to twice the capacity that it needs.
        assert!(
            held <= 2 * documented as isize,
            "{held} of {documented} bytes"
        );
        drop(link);
    }
}

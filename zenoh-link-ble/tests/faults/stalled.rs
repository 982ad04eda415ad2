//! A peer that is there, but takes nothing, or slowly, or speaks and does not hear.
use std::time::Duration;

use tokio::time::{sleep, timeout, Instant};
use zenoh_link_ble::{
    bye::Bye,
    lanes::{
        ack_timer::ACK_TIMEOUT,
        credits::{cost, Acks},
        receiver::HIGH_MARK,
        sdu::Content,
        Lane, LANES,
    },
    locator::DEFAULT_MTU,
    radio::{
        sim::{Condition, RECEIVE_BUFFER_BYTES},
        Radio,
    },
};
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use super::cuts::EVENTS;
use crate::shared::{
    heap::live_bytes,
    pair::{Pair, SUPERVISION},
    peer::within,
    raw::{Heard, RawPeer, WINDOW},
};

/// How often Zenoh sends a keep-alive where nothing else is sent.
const KEEP_ALIVE: Duration = Duration::from_millis(2500);
const MTU: usize = DEFAULT_MTU as usize;
const BATCH: [u8; MTU] = [7; MTU];

async fn with_raw_peer(seed: u64) -> (Pair, RawPeer, LinkUnicast) {
    let pair = Pair::on(Condition::Room, seed).await;
    let near: std::sync::Arc<dyn Radio> = pair.air.radio("sim-near").await.expect("is there");
    let far: std::sync::Arc<dyn Radio> = pair.air.radio("sim-far").await.expect("is there");
    let raw = RawPeer::dials(&near, &far, "raw").await;
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

/// Its radio answers, so that no supervision timeout ends the link.
#[tokio::test(start_paused = true)]
async fn a_frozen_peer_is_given_up_and_readers_and_writers_are_told() {
    let (pair, raw, link) = with_raw_peer(1).await;
    let start = Instant::now();
    let limit = ACK_TIMEOUT + SUPERVISION;
    let mut buffer = [0; 100];
    let ended = timeout(limit, async {
        tokio::join!(writes_until_it_fails(&link), link.read(&mut buffer, None))
    });
    let (written, read) = ended.await.expect("both are told");
    let read = read.expect_err("it is over").to_string();
    for error in [&written, &read] {
        let reason = "raw has acknowledged nothing for 20 s";
        assert!(error.contains(reason), "{error}");
    }
    assert!(start.elapsed() >= ACK_TIMEOUT, "too soon");
    assert_eq!(pair.far.manager.census().links, 0);
    drop(raw);
}

/// Its program reads and sends, so that neither a supervision timeout nor Zenoh's lease ends the link.
#[tokio::test(start_paused = true)]
async fn a_peer_that_stops_acknowledging_is_given_up_whatever_keep_alives_do() {
    for batches in [1, 3, 40] {
        let (pair, mut raw, link) = with_raw_peer(7).await;
        let start = Instant::now();
        let bulk = async {
            for _ in 0..batches {
                // More than the window waits here until the link ends.
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
        let ended = async { tokio::join!(bulk, keep_alives, raw.hears_goodbye()).2 };
        let goodbye = timeout(ACK_TIMEOUT + KEEP_ALIVE + SUPERVISION, ended).await;
        let goodbye = goodbye.unwrap_or_else(|_| panic!("{batches} batches: it lives on"));
        assert_eq!(goodbye, Some(Bye::Unacknowledged.code()));
        assert!(start.elapsed() >= ACK_TIMEOUT, "too soon");
        let error = link.read(&mut [0; 10], None).await.expect_err("it is over");
        let error = error.to_string();
        assert!(error.contains("raw has acknowledged nothing"), "{error}");
        assert_eq!(pair.far.manager.census().links, 0);
    }
}

/// Nobody owes an acknowledgement of a few bytes.
#[tokio::test(start_paused = true)]
async fn a_link_with_nothing_but_keep_alives_lives_on() {
    let pair = Pair::on(Condition::Room, 8).await;
    let (near, far) = pair.link().await;
    let mut buffer = [0; 10];
    for _ in 0..100 {
        near.write_all(&[4], Some(Priority::Control))
            .await
            .expect("lives");
        sleep(KEEP_ALIVE).await;
        let size = far.read(&mut buffer, Some(Priority::Control)).await;
        assert_eq!(size.expect("lives"), 1);
    }
}

/// A peer whose reader takes an SDU a second is slow, not gone.
#[tokio::test(start_paused = true)]
async fn a_slow_peer_gets_everything_however_long_it_takes() {
    const BATCHES: usize = 120;
    let (_pair, mut raw, link) = with_raw_peer(2).await;
    let mut acks = Acks::new(WINDOW);
    let writing = async {
        for _ in 0..BATCHES {
            let written = link.write_all(&BATCH, Some(Priority::Data)).await;
            written.expect("the link lives");
        }
    };
    let reading = async {
        for n in 0..BATCHES {
            sleep(Duration::from_secs(1)).await;
            let heard = raw.hears().await;
            assert!(
                matches!(heard, Some(Content::Batch(_, batch)) if batch == BATCH),
                "{n}"
            );
            acks.on_received(cost(BATCH.len())).expect("in the window");
            if let Some(total) = acks.due() {
                raw.says(Content::Ack(total)).await;
            }
        }
    };
    tokio::join!(writing, reading);
    let (closed, bye) = within("closing", async {
        let goodbye = async {
            let bye = raw.hears_goodbye().await;
            drop(raw);
            bye
        };
        tokio::join!(link.close(), goodbye)
    })
    .await;
    closed.expect("closes");
    assert_eq!(bye, Some(Bye::Closing.code()));
}

/// It hears no acknowledgement, and so has no right to more than its window.
#[tokio::test(start_paused = true)]
async fn a_peer_that_overruns_its_credits_is_ended_with_that_reason() {
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
            raw.says(Content::Batch(lane, &BATCH)).await;
        }
    };
    let (batches, error) = tokio::select! {
        ended = reading => ended,
        () = talking => unreachable!("it talks for ever"),
    };
    // Both controllers hold acknowledgements that it has not read; each is for a quarter of the window and a batch.
    let acknowledged = RECEIVE_BUFFER_BYTES / 247 * window / 4;
    assert!(
        batches * BATCH.len() < 3 * acknowledged,
        "{batches} batches"
    );
    assert!(error.contains("more than its credits allow"), "{error}");
}

/// A program that does not read holds up its own lane only.
#[tokio::test(start_paused = true)]
async fn a_lane_nobody_reads_holds_up_no_other_and_loses_nothing() {
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
async fn all_who_wait_on_one_lane_are_told_of_the_end() {
    let pair = Pair::on(Condition::Room, 5).await;
    let (near, far) = pair.link().await;
    let readers = [(); 3].map(|()| async { near.read(&mut [0; 100], None).await.map(drop) });
    let cutting = async { far.close().await };
    let ended = async { tokio::join!(futures::future::join_all(readers), cutting).0 };
    for told in within("the end", ended).await {
        let error = told.expect_err("it is over").to_string();
        assert!(error.contains("closed the link: it is done"), "{error}");
    }
}

/// Small batches cost the most: what a queue needs for each counts too.
#[tokio::test(start_paused = true)]
async fn what_a_peer_makes_this_side_hold_has_a_bound_on_the_heap_whatever_the_size_of_its_batches()
{
    for size in [1, 20, MTU] {
        let (_pair, mut raw, link) = with_raw_peer(6).await;
        let mut credits = raw.credits();
        let before = live_bytes();
        for lane in Lane::all() {
            let heard = raw.floods(&mut credits, lane, &BATCH[..size], true).await;
            assert_eq!(heard, Heard::Stop);
        }
        let held = live_bytes() - before;
        let documented = LANES * (HIGH_MARK + MTU + usize::from(credits.window()));
        println!("batches of {size}: {held} bytes held, {documented} documented");
        assert!(
            held > LANES as isize * HIGH_MARK as isize / 2,
            "{held} bytes"
        );
        // A queue has up to twice the room that it needs.
        assert!(
            held <= 2 * documented as isize,
            "{held} of {documented} bytes"
        );
        drop(link);
    }
}

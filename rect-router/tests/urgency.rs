//! What is more urgent overtakes what is not, from the program to the other robot's: `cargo test --workspace --test urgency`
mod support;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex,
    },
    time::{Duration, Instant},
};

use rect::Json;
use support::{joined, simulated, Air, DEADLINE};
use zenoh_link::ble::radio::sim::{AirOptions, LlPayload};

/// How long bulk is said as fast as the router takes it.
const FLOOD: Duration = Duration::from_secs(6);

#[test]
fn a_program_that_floods_the_radio_with_bulk_is_still_heard_and_answered_at_once() {
    // As slow as a Pi 3B's.
    let air = Air::with(AirOptions {
        pdu: LlPayload::Bytes27,
        ..AirOptions::default()
    });
    let (_one, here) = simulated(&air, 1, &[]);
    let (_two, there) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(flood(&here, &there));
}

async fn flood(here: &str, there: &str) {
    let (one, two) = (
        joined("wombat-1", here).await,
        joined("wombat-2", there).await,
    );
    let begun = Instant::now();
    let late: Arc<Mutex<Vec<Duration>>> = Arc::default();
    let heard = late.clone();
    let _stops = two
        .on_message("wombat-1/stop", move |message| {
            let sent_us: u64 = message.payload.value().expect("a number");
            let age = begun.elapsed() - Duration::from_micros(sent_us);
            heard.lock().expect("whole").push(age);
        })
        .await
        .expect("subscribed");
    let _maps = two.subscribe("wombat-1/map").await.expect("subscribed");
    let _service = two
        .serve("battery", |_| async { Ok::<_, String>(Json(7.2)) })
        .await
        .expect("served");
    let ask = || one.request("wombat-2", "battery", "", DEADLINE);
    while ask().await.is_err() {
        assert!(begun.elapsed() < DEADLINE, "the service is known");
    }

    let is_over = Arc::new(AtomicBool::new(false));
    let (bulk, over) = (one.bulk(), is_over.clone());
    let flooding = tokio::spawn(async move {
        while !over.load(Ordering::Relaxed) {
            bulk.publish("map", vec![7u8; 4096]).await.expect("said");
        }
    });
    let urgent = one.urgent();
    let (mut said, mut answered) = (0, Vec::new());
    let flood = Instant::now();
    while flood.elapsed() < FLOOD {
        let sent_us = u64::try_from(begun.elapsed().as_micros()).expect("short");
        urgent.publish("stop", Json(sent_us)).await.expect("said");
        said += 1;
        if said % 10 == 0 {
            let asked = Instant::now();
            ask().await.expect("answered");
            answered.push(asked.elapsed());
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    is_over.store(true, Ordering::Relaxed);
    tokio::time::sleep(Duration::from_millis(500)).await;
    let mut late = late.lock().expect("whole").clone();
    late.sort();
    answered.sort();
    let most = late[late.len() * 99 / 100 - 1];
    println!(
        "urgent p50 {:?} p99 {most:?} of {said}; answers at most {:?}",
        late[late.len() / 2],
        answered.last()
    );
    assert_eq!(late.len(), said, "each arrived");
    assert!(most < Duration::from_millis(250), "{late:?}");
    assert!(
        answered.last() < Some(&Duration::from_secs(1)),
        "{answered:?}"
    );
    flooding.abort();
}

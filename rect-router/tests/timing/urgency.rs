//! Tests that urgent messages overtake less urgent ones all the way from one program to another robot's:
//! `cargo test -p rect-router --test timing urgency`
use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc, Mutex,
    },
    time::{Duration, Instant},
};

use crate::support::{joined, simulated, Air, DEADLINE};
use rect::{Json, Payload};
use zenoh_link_ble_air::{AirOptions, LlPayload};

/// Time for which bulk messages are published as fast as the router accepts them.
const FLOOD: Duration = Duration::from_secs(6);

#[test]
fn urgent_messages_and_requests_are_fast_during_a_flood_of_bulk_messages() {
    // As slow as the radio of a Pi 3B.
    let air = Air::with(AirOptions {
        pdu: LlPayload::Bytes27,
        ..AirOptions::default()
    });
    let (_one, local) = simulated(&air, 1, &[]);
    let (_two, remote) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(flood(&local, &remote));
}

async fn flood(local: &str, remote: &str) {
    let (one, two) = (
        joined("wombat-1", local).await,
        joined("wombat-2", remote).await,
    );
    let begun = Instant::now();
    let ages: Arc<Mutex<Vec<Duration>>> = Arc::default();
    let received_ages = ages.clone();
    let _stops = two
        .on_message::<Payload>("wombat-1/stop", move |message| {
            let sent_us: u64 = message.payload.value().expect("a number");
            let age = begun.elapsed() - Duration::from_micros(sent_us);
            received_ages.lock().expect("unpoisoned").push(age);
        })
        .await
        .expect("subscribed");
    let _maps = two
        .subscribe::<Payload>("wombat-1/map")
        .await
        .expect("subscribed");
    let _service = two
        .serve("battery", |_| async { Ok::<_, String>(Json(7.2)) })
        .await
        .expect("served");
    let ask = || one.request::<Payload>("wombat-2", "battery", "");
    while ask().await.is_err() {
        assert!(begun.elapsed() < DEADLINE, "the service is known");
    }

    let is_finished = Arc::new(AtomicBool::new(false));
    let (bulk, finished) = (one.bulk(), is_finished.clone());
    let flooding = tokio::spawn(async move {
        while !finished.load(Ordering::Relaxed) {
            bulk.publish("map", vec![7u8; 4096])
                .await
                .expect("published");
        }
    });
    let urgent = one.urgent();
    let (mut published, mut answered) = (0, Vec::new());
    let flood = Instant::now();
    while flood.elapsed() < FLOOD {
        let sent_us = u64::try_from(begun.elapsed().as_micros()).expect("short");
        urgent
            .publish("stop", Json(sent_us))
            .await
            .expect("published");
        published += 1;
        if published % 10 == 0 {
            let asked = Instant::now();
            ask().await.expect("answered");
            answered.push(asked.elapsed());
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    is_finished.store(true, Ordering::Relaxed);
    tokio::time::sleep(Duration::from_millis(500)).await;
    let mut ages = ages.lock().expect("unpoisoned").clone();
    ages.sort();
    answered.sort();
    let p99 = ages[ages.len() * 99 / 100 - 1];
    println!(
        "urgent p50 {:?} p99 {p99:?} of {published}; answers at most {:?}",
        ages[ages.len() / 2],
        answered.last()
    );
    assert_eq!(ages.len(), published, "each message arrived");
    assert!(p99 < Duration::from_millis(250), "{ages:?}");
    assert!(
        answered.last() < Some(&Duration::from_secs(1)),
        "{answered:?}"
    );
    flooding.abort();
}

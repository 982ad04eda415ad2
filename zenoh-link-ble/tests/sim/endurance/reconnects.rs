//! Tests that ten thousand links between two nodes, ended in every possible way, leak no resources.
use std::time::Duration;

use tokio::time::{sleep, Instant};
use zenoh_link_ble_air::Condition;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use crate::shared::{
    heap::live_bytes,
    pair::{Pair, Resources},
    peer::within,
};

const RECONNECTS: usize = 10_000;
/// Number of reconnects after which every table has reached its final size.
const WARM: usize = 1_000;
/// Allowed growth of the heap in bytes: less than one byte per reconnect.
const SLACK: isize = 4_096;

/// Ends a link in one of ten ways.
async fn end(pair: &Pair, way: usize, near: &LinkUnicast, far: &LinkUnicast) {
    let name = ["sim-near", "sim-far"][way % 2];
    match way % 10 {
        // Closed by either side.
        0 => drop(tokio::join!(near.close(), until_it_ends(far))),
        1 => drop(tokio::join!(far.close(), until_it_ends(near))),
        // Cut with batches in flight.
        2 | 3 => {
            let _ = near.write_all(&[1; 700], Some(Priority::Data)).await;
            let _ = far.write_all(&[2; 700], Some(Priority::Data)).await;
            pair.air.cut();
        }
        4 | 5 => pair.air.power(name, false).expect("is attached"),
        6 | 7 => pair.air.remove(name).expect("is attached"),
        8 => {
            pair.air.power(name, false).expect("is attached");
            pair.air.power(name, true).expect("is attached");
        }
        // Dropped, as by a program that is killed.
        _ => return,
    }
    within("the end", async {
        tokio::join!(until_it_ends(near), until_it_ends(far))
    })
    .await;
    pair.air.restore();
    for name in ["sim-near", "sim-far"] {
        pair.air.power(name, true).expect("is attached");
    }
}

async fn until_it_ends(link: &LinkUnicast) {
    for priority in [Priority::Control, Priority::Data] {
        while link.read(&mut [0; 1000], Some(priority)).await.is_ok() {}
    }
    link.close().await.expect("closing never fails");
}

fn open_files() -> usize {
    let files = std::fs::read_dir("/proc/self/fd").expect("exists on Linux");
    files.count()
}

/// Returns all resources that could leak.
async fn measure_resources(pair: &Pair) -> (Resources, isize, usize) {
    (
        pair.resources_after_cleanup().await,
        live_bytes(),
        open_files(),
    )
}

#[tokio::test(start_paused = true)]
async fn ten_thousand_reconnects_leak_no_resources() {
    let pair = Pair::on(Condition::Room, 1).await;
    let (initial_resources, _, files_at_first) = measure_resources(&pair).await;
    let mut bytes_when_warm = 0;
    let mut slowest = Duration::ZERO;
    for n in 1..=RECONNECTS {
        let start = Instant::now();
        let (near, far) = pair.link_again(start, &format!("link {n}")).await;
        slowest = slowest.max(start.elapsed());
        end(&pair, n, &near, &far).await;
        drop((near, far));
        // Wait until the radios have released the connection.
        sleep(Duration::from_millis(300)).await;
        if n == WARM {
            bytes_when_warm = measure_resources(&pair).await.1;
        }
    }
    let (resources, bytes, files) = measure_resources(&pair).await;
    println!(
        "{RECONNECTS} reconnects in {:?} of the air's time, the slowest in {slowest:?}: \
         {bytes_when_warm} bytes after {WARM}, {bytes} in the end, {resources:?}, {files} open files",
        pair.air.elapsed()
    );
    assert_eq!(resources, initial_resources);
    assert!(bytes <= bytes_when_warm + SLACK, "{bytes} bytes");
    // Concurrent tests have an event loop each.
    assert!(files <= files_at_first + 8, "{files} open files");
}

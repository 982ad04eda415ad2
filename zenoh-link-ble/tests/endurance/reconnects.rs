//! Ten thousand links between the same two nodes, ended in every way there is, leave nothing behind.
use std::time::Duration;

use tokio::time::{sleep, Instant};
use zenoh_link_ble::radio::sim::Condition;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use crate::shared::{
    heap::live_bytes,
    pair::{Leftovers, Pair},
    peer::within,
};

const RECONNECTS: usize = 10_000;
/// By now every table has grown to the size it needs.
const WARM: usize = 1_000;
/// Bytes that a table may still grow by: far less than a byte for each reconnect.
const SLACK: isize = 4_096;

/// How a link ends.
async fn end(pair: &Pair, way: usize, near: &LinkUnicast, far: &LinkUnicast) {
    let name = ["sim-near", "sim-far"][way % 2];
    match way % 10 {
        // In good order, by either side.
        0 => drop(tokio::join!(near.close(), until_it_ends(far))),
        1 => drop(tokio::join!(far.close(), until_it_ends(near))),
        // With traffic still under way.
        2 | 3 => {
            let _ = near.write_all(&[1; 700], Some(Priority::Data)).await;
            let _ = far.write_all(&[2; 700], Some(Priority::Data)).await;
            pair.air.cut();
        }
        4 | 5 => pair.air.power(name, false).expect("is there"),
        6 | 7 => pair.air.remove(name).expect("is there"),
        8 => {
            pair.air.power(name, false).expect("is there");
            pair.air.power(name, true).expect("is there");
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
        pair.air.power(name, true).expect("is there");
    }
}

async fn until_it_ends(link: &LinkUnicast) {
    for priority in [Priority::Control, Priority::Data] {
        while link.read(&mut [0; 1000], Some(priority)).await.is_ok() {}
    }
    link.close().await.expect("closing never fails");
}

fn open_files() -> usize {
    let files = std::fs::read_dir("/proc/self/fd").expect("is there on Linux");
    files.count()
}

/// Everything that could be left behind.
async fn account(pair: &Pair) -> (Leftovers, isize, usize) {
    (
        pair.leftovers_in_the_end().await,
        live_bytes(),
        open_files(),
    )
}

#[tokio::test(start_paused = true)]
async fn ten_thousand_reconnects_leave_nothing_behind() {
    let pair = Pair::on(Condition::Room, 1).await;
    let (leftovers_at_first, _, files_at_first) = account(&pair).await;
    let mut bytes_when_warm = 0;
    let mut slowest = Duration::ZERO;
    for n in 1..=RECONNECTS {
        let start = Instant::now();
        let (near, far) = pair.link_again(start, &format!("link {n}")).await;
        slowest = slowest.max(start.elapsed());
        end(&pair, n, &near, &far).await;
        drop((near, far));
        // Until the radios have let go of it.
        sleep(Duration::from_millis(300)).await;
        if n == WARM {
            bytes_when_warm = account(&pair).await.1;
        }
    }
    let (leftovers, bytes, files) = account(&pair).await;
    println!(
        "{RECONNECTS} reconnects in {:?} of the air's time, the slowest in {slowest:?}: \
         {bytes_when_warm} bytes after {WARM}, {bytes} in the end, {leftovers:?}, {files} open files",
        pair.air.elapsed()
    );
    assert_eq!(leftovers, leftovers_at_first);
    assert!(bytes <= bytes_when_warm + SLACK, "{bytes} bytes");
    // The tests beside this one have an event loop each.
    assert!(files <= files_at_first + 8, "{files} open files");
}

//! Over UDP what is lost is lost, and counted (R4): two programs with a wire between them that loses datagrams.
//! `cargo test -p rect --test udp`
mod pair;

use std::{
    net::{SocketAddr, UdpSocket},
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
    time::Duration,
};

use pair::{dialling, listening, PATIENCE};
use rect::Receiving;
use tokio::time::timeout;

/// Forwards datagrams between whoever speaks to it and `to`; once `lossy`, every fifth towards the dialler is lost.
fn wire(to: SocketAddr, lossy: Arc<AtomicBool>) -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let address = socket.local_addr().expect("bound");
    thread::spawn(move || {
        let (mut buffer, mut dialler, mut count) = ([0; 65536], None, 0u32);
        while let Ok((length, from)) = socket.recv_from(&mut buffer) {
            let target = if from == to {
                count += 1;
                if lossy.load(Ordering::Acquire) && count % 5 == 0 {
                    continue;
                }
                dialler
            } else {
                dialler = Some(from);
                Some(to)
            };
            if let Some(target) = target {
                let _ = socket.send_to(&buffer[..length], target);
            }
        }
    });
    address
}

#[tokio::test(flavor = "multi_thread")]
async fn over_udp_lost_is_lost_and_counted() {
    let free = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let there = free.local_addr().expect("bound");
    drop(free);
    let lossy = Arc::new(AtomicBool::new(false));
    let between = wire(there, lossy.clone());
    let a = listening("a", &format!("udp/{there}")).await;
    let b = dialling("b", &format!("udp/{between}")).await;
    let enough = Receiving {
        capacity: 1000,
        ..Receiving::default()
    };
    let heard = b.subscribe_with("a/n", enough).await.expect("subscribed");
    let first = async {
        loop {
            a.publish("n", "").await.expect("said");
            tokio::time::sleep(Duration::from_millis(5)).await;
            if let Some(message) = heard.try_recv() {
                break message.sequence.expect("numbered");
            }
        }
    };
    let first = timeout(PATIENCE, first).await.expect("linked in time");
    lossy.store(true, Ordering::Release);
    for _ in 0..300 {
        a.urgent().publish("n", "").await.expect("said");
        a.publish("n", "").await.expect("said");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    lossy.store(false, Ordering::Release);
    a.publish("n", "the end").await.expect("said");
    let mut numbers = vec![first];
    let mut urgent = 0;
    let (mut missed, mut late) = (0, 0);
    loop {
        let message = timeout(PATIENCE, heard.recv())
            .await
            .expect("in time")
            .expect("open");
        missed += message.missed;
        late += u32::from(message.late);
        if message.urgency == rect::Urgency::Urgent {
            urgent += 1;
            continue;
        }
        numbers.extend(message.sequence);
        if message.payload.bytes == b"the end"[..] {
            break;
        }
    }
    let (robot, tally) = heard.tallies()[0].clone();
    let last = *numbers.last().expect("some");
    println!(
        "heard {} and {urgent} urgent, missed {missed}, late {late}",
        numbers.len()
    );
    assert_eq!(robot, "a");
    assert!(
        missed > 50,
        "a fifth of 600 was lost, in datagrams of one or more: {missed}"
    );
    assert_eq!(
        tally.missed,
        u64::from(missed - late),
        "what came late was not lost"
    );
    assert!(
        numbers.is_sorted_by(|one, next| one < next),
        "none twice, none repaired"
    );
    assert!(numbers.len() < (last - first + 1) as usize);
    assert_eq!(b.counters().missed, u64::from(missed));
}

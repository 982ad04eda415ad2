//! Tests that messages lost over UDP are counted and not retransmitted, with a relay that drops datagrams:
//! `cargo test -p rect-robot --test behaviour udp`
use std::{
    net::{SocketAddr, UdpSocket},
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    thread,
    time::Duration,
};

use rect::{Payload, QueueOptions};

use crate::pair::{dialling, listening, TIMEOUT};
use tokio::time::timeout;

/// Relays datagrams between the dialler and `listener`, and returns the address to dial. While `lossy` is set, every
/// fifth datagram to the dialler is dropped.
fn relay(listener: SocketAddr, lossy: Arc<AtomicBool>) -> SocketAddr {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let relay_address = socket.local_addr().expect("bound");
    thread::spawn(move || {
        let (mut buffer, mut dialler, mut count) = ([0; 65536], None, 0u32);
        while let Ok((length, source)) = socket.recv_from(&mut buffer) {
            let target = if source == listener {
                count += 1;
                if lossy.load(Ordering::Acquire) && count % 5 == 0 {
                    continue;
                }
                dialler
            } else {
                dialler = Some(source);
                Some(listener)
            };
            if let Some(target) = target {
                let _ = socket.send_to(&buffer[..length], target);
            }
        }
    });
    relay_address
}

#[tokio::test(flavor = "multi_thread")]
async fn lost_datagrams_are_counted_and_not_retransmitted() {
    let free = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let address = free.local_addr().expect("bound");
    drop(free);
    let lossy = Arc::new(AtomicBool::new(false));
    let relay_address = relay(address, lossy.clone());
    let a = listening("a", &format!("udp/{address}")).await;
    let b = dialling("b", &format!("udp/{relay_address}")).await;
    let queue = QueueOptions {
        capacity: 1000,
        ..QueueOptions::default()
    };
    let messages = b
        .subscribe_with::<Payload>("a/n", queue)
        .await
        .expect("subscribed");
    let first = async {
        loop {
            a.publish("n", "").await.expect("published");
            tokio::time::sleep(Duration::from_millis(5)).await;
            if let Some(message) = messages.try_next() {
                break message.sequence.expect("numbered");
            }
        }
    };
    let first = timeout(TIMEOUT, first).await.expect("linked in time");
    lossy.store(true, Ordering::Release);
    for _ in 0..300 {
        a.urgent().publish("n", "").await.expect("published");
        a.publish("n", "").await.expect("published");
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    lossy.store(false, Ordering::Release);
    a.publish("n", "the end").await.expect("published");
    let mut numbers = vec![first];
    let mut urgent = 0;
    let (mut missed, mut late) = (0, 0);
    loop {
        let message = timeout(TIMEOUT, messages.next())
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
    let (robot, counts) = messages.counts_by_sender()[0].clone();
    let last = *numbers.last().expect("some");
    println!(
        "received {} and {urgent} urgent, missed {missed}, late {late}",
        numbers.len()
    );
    assert_eq!(robot, "a");
    assert!(
        missed > 50,
        "a fifth of the datagrams, each with one or more of 600 messages, was dropped: {missed}"
    );
    assert_eq!(
        counts.missed,
        u64::from(missed - late),
        "late messages are not missed"
    );
    assert!(
        numbers.is_sorted_by(|number, next| number < next),
        "no duplicates, no retransmissions"
    );
    assert!(numbers.len() < (last - first + 1) as usize);
    assert_eq!(b.counters().missed, u64::from(missed));
}

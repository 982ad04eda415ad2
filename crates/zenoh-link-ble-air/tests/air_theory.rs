//! Tests the simulated air against the arithmetic of Bluetooth LE and against its guarantees to links, in virtual time:
//! `cargo test -p zenoh-link-ble-air --test air_theory`.
use std::{sync::Arc, time::Duration};

use tokio::time::{timeout, Instant};
use zenoh_link_ble_air::{
    AirOptions, Condition, LlPayload, Phy, SimAir, SimRadio, RECEIVE_BUFFER_BYTES,
};
use zenoh_link_ble_radio::{
    address::Psm, advertisement::Advertisement, AdapterState, AdvertisingGuard, Channel,
    ChannelListener, ChannelOptions, Radio, RadioError, Security,
};

const OPTIONS: ChannelOptions = ChannelOptions {
    recv_mtu: 8192,
    security: Security::Low,
    passkey: None,
};
const LONG: Duration = Duration::from_secs(60);

fn air(options: AirOptions) -> SimAir {
    println!("{options:?}");
    SimAir::new(options)
}

fn desk() -> AirOptions {
    AirOptions {
        condition: Condition::Desk,
        ..AirOptions::default()
    }
}

struct Host {
    radio: Arc<SimRadio>,
    listener: Box<dyn ChannelListener>,
    _advertised: Box<dyn AdvertisingGuard>,
}

/// Returns an adapter that listens and advertises.
async fn host(air: &SimAir, name: &str) -> Host {
    let radio = air.radio(name).await.expect("attaches");
    let listener = radio.listen(None, OPTIONS).await.expect("listens");
    let advertisement = Advertisement {
        psm: listener.psm(),
        plain: false,
        name_hash: Advertisement::hash_of_name(name),
        fleet_hash: 0,
        incarnation: 1,
    };
    let advertised = radio
        .advertise(&advertisement, name)
        .await
        .expect("advertises");
    Host {
        radio,
        listener,
        _advertised: advertised,
    }
}

type End = Arc<dyn Channel>;

/// Opens a channel from the adapter to the host. Returns the dialling end first.
async fn dial(from: &SimRadio, to: &Host) -> (End, End) {
    let peer = to.radio.address().await.expect("is attached");
    let dialled = from.connect(peer, to.listener.psm(), OPTIONS);
    let (dialled, accepted) = tokio::join!(timeout(LONG, dialled), to.listener.accept());
    let dialled = dialled.expect("in time").expect("connects");
    (dialled, accepted.expect("accepts"))
}

/// Sends SDUs without end, each starting with its number.
fn send_continuously(into: End, sdu_bytes: usize) -> tokio::task::JoinHandle<u32> {
    tokio::spawn(async move {
        let mut number = 0_u32;
        loop {
            let mut sdu = vec![0xa5; sdu_bytes];
            sdu[..4].copy_from_slice(&number.to_le_bytes());
            if into.send(&sdu).await.is_err() {
                return number;
            }
            number += 1;
        }
    })
}

/// Returns the rate of received SDUs after the first one, in kbit/s.
async fn rate(from: &End, during: Duration) -> f64 {
    let mut buffer = vec![0; 65535];
    from.recv(&mut buffer).await.expect("first sdu");
    let start = Instant::now();
    let (mut bytes, mut last) = (0, start);
    while last - start < during {
        bytes += from.recv(&mut buffer).await.expect("next sdu");
        last = Instant::now();
    }
    bytes as f64 * 8.0 / (last - start).as_secs_f64() / 1000.0
}

async fn throughput(options: AirOptions, during: Duration) -> f64 {
    let sdu_bytes = 4 * usize::from(options.mps) - 2;
    let air = air(options);
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let (a, b) = dial(&radio, &host).await;
    send_continuously(Arc::clone(&a), sdu_bytes);
    rate(&b, during).await
}

/// Asserts that the rate is within 5 % of `expected_kbit_s`: the bits of a full L2CAP frame, divided by the duration of
/// the exchanges of full packets that carry it.
async fn check_throughput(phy: Phy, pdu: LlPayload, mps: u16, expected_kbit_s: f64) {
    let options = AirOptions {
        phy,
        pdu,
        mps,
        // Long, so that the unused time at the end of an event is negligible.
        interval: Duration::from_secs(1),
        supervision_timeout: Duration::from_secs(6),
        ..desk()
    };
    let measured = throughput(options, Duration::from_secs(5)).await;
    println!("{phy} {pdu} mps {mps}: {measured:.0} kbit/s, theory {expected_kbit_s}");
    assert!(
        (measured / expected_kbit_s - 1.0).abs() < 0.05,
        "{measured:.0} kbit/s, theory {expected_kbit_s}"
    );
}

#[tokio::test(start_paused = true)]
async fn le_1m_with_short_packets_and_frames_carries_272_kbit_s() {
    check_throughput(Phy::Le1M, LlPayload::Bytes27, 23, 272.0).await;
}

#[tokio::test(start_paused = true)]
async fn le_1m_with_short_packets_and_long_frames_carries_292_kbit_s() {
    check_throughput(Phy::Le1M, LlPayload::Bytes27, 247, 292.0).await;
}

#[tokio::test(start_paused = true)]
async fn le_1m_with_long_packets_carries_801_kbit_s() {
    check_throughput(Phy::Le1M, LlPayload::Bytes251, 247, 801.0).await;
}

#[tokio::test(start_paused = true)]
async fn le_2m_with_short_packets_carries_371_kbit_s() {
    check_throughput(Phy::Le2M, LlPayload::Bytes27, 23, 371.0).await;
}

#[tokio::test(start_paused = true)]
async fn le_2m_with_long_packets_carries_1420_kbit_s() {
    check_throughput(Phy::Le2M, LlPayload::Bytes251, 247, 1420.0).await;
}

#[tokio::test(start_paused = true)]
async fn coded_s2_carries_377_kbit_s() {
    check_throughput(Phy::CodedS2, LlPayload::Bytes251, 247, 377.0).await;
}

#[tokio::test(start_paused = true)]
async fn coded_s8_carries_111_kbit_s() {
    check_throughput(Phy::CodedS8, LlPayload::Bytes251, 247, 111.0).await;
}

#[tokio::test(start_paused = true)]
async fn throughput_decreases_with_the_radio_condition() {
    let mut rates = Vec::new();
    for condition in [
        Condition::Desk,
        Condition::Room,
        Condition::Wall,
        Condition::CrowdedHall,
        Condition::EdgeOfRange,
    ] {
        let options = AirOptions {
            condition,
            ..AirOptions::default()
        };
        rates.push((condition, throughput(options, Duration::from_secs(5)).await));
    }
    println!("{rates:.0?}");
    assert!(rates.windows(2).all(|pair| pair[0].1 > pair[1].1));
    assert!(rates[4].1 > 200.0, "the edge of range still carries a link");
}

#[tokio::test(start_paused = true)]
async fn two_links_share_one_adapter_equally() {
    check_sharing(desk(), 600.0..800.0).await;
}

// An exchange of two full coded packets takes longer than half an interval, so the events of the two links overlap. A
// controller shares its time between the connections of which it is the central.
#[tokio::test(start_paused = true)]
async fn links_of_one_central_with_overlapping_events_take_turns() {
    let phy = Phy::CodedS8;
    check_sharing(AirOptions { phy, ..desk() }, 40.0..111.0).await;
}

/// Measures two links from one central.
async fn check_sharing(options: AirOptions, expected_kbit_s: std::ops::Range<f64>) {
    let air = air(options);
    let central = air.radio("sim-central").await.expect("attaches");
    let (mut ends, mut hosts) = (Vec::new(), Vec::new());
    for name in ["sim-a", "sim-b"] {
        let host = host(&air, name).await;
        ends.push(dial(&central, &host).await);
        hosts.push(host);
    }
    for (a, _) in &ends {
        send_continuously(Arc::clone(a), 986);
    }
    let (x, y) = tokio::join!(
        rate(&ends[0].1, Duration::from_secs(5)),
        rate(&ends[1].1, Duration::from_secs(5))
    );
    assert!((x / y - 1.0).abs() < 0.15, "{x:.0} and {y:.0} kbit/s");
    assert!(
        expected_kbit_s.contains(&(x + y)),
        "{x:.0} and {y:.0} kbit/s"
    );
}

#[tokio::test(start_paused = true)]
async fn pairs_without_a_common_adapter_do_not_affect_each_other() {
    let alone = throughput(desk(), Duration::from_secs(5)).await;
    let air = air(desk());
    let mut ends = Vec::new();
    for (a, b) in [("sim-a", "sim-b"), ("sim-c", "sim-d")] {
        let host = host(&air, b).await;
        let radio = air.radio(a).await.expect("attaches");
        let (from, to) = dial(&radio, &host).await;
        send_continuously(Arc::clone(&from), 986);
        ends.push((from, to, host));
    }
    let during = Duration::from_secs(5);
    let (x, y) = tokio::join!(rate(&ends[0].1, during), rate(&ends[1].1, during));
    for together in [x, y] {
        assert!(
            (together / alone - 1.0).abs() < 0.02,
            "{together:.0}, alone {alone:.0}"
        );
    }
}

#[tokio::test(start_paused = true)]
async fn both_ends_detect_a_cut_within_the_supervision_timeout() {
    let air = air(desk());
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let (a, b) = dial(&radio, &host).await;
    air.cut_between("sim-a", "sim-host");
    let start = Instant::now();
    for end in [&a, &b] {
        let ended = end.recv(&mut [0; 8]).await;
        assert!(
            matches!(ended, Err(RadioError::ChannelDown { .. })),
            "{ended:?}"
        );
    }
    let took = start.elapsed();
    let expected = Duration::from_millis(1900)..Duration::from_millis(2010);
    assert!(expected.contains(&took), "{took:?}");
    air.restore();
    let (a, b) = dial(&radio, &host).await;
    a.send(b"again").await.expect("sends");
    let mut buffer = [0; 8];
    assert_eq!(b.recv(&mut buffer).await.expect("receives"), 5);
}

#[tokio::test(start_paused = true)]
async fn applies_backpressure_without_loss_if_the_receiver_does_not_read() {
    let air = air(AirOptions::default());
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let (a, b) = dial(&radio, &host).await;
    let sent = Arc::new(std::sync::atomic::AtomicU32::new(0));
    let counter = Arc::clone(&sent);
    tokio::spawn(async move {
        for number in 0_u32..300 {
            let mut sdu = vec![0; 986];
            sdu[..4].copy_from_slice(&number.to_le_bytes());
            a.send(&sdu).await.expect("sends");
            counter.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        }
        // Kept open until everything has arrived.
        let _ = a.recv(&mut [0; 8]).await;
    });
    tokio::time::advance(Duration::from_millis(1)).await;
    tokio::time::sleep(Duration::from_secs(30)).await;
    let stuck_at = sent.load(std::sync::atomic::Ordering::Relaxed) as usize;
    assert!(stuck_at * 986 > RECEIVE_BUFFER_BYTES / 2, "{stuck_at}");
    assert!(stuck_at * 986 < RECEIVE_BUFFER_BYTES + 10_000, "{stuck_at}");
    let mut buffer = [0; 1000];
    for number in 0_u32..300 {
        assert_eq!(b.recv(&mut buffer).await.expect("arrives"), 986);
        assert_eq!(buffer[..4], number.to_le_bytes());
    }
}

#[tokio::test(start_paused = true)]
async fn delivers_sdus_of_every_size_in_order_in_every_condition() {
    for (condition, pdu) in Condition::ALL.into_iter().zip(
        [LlPayload::Bytes251, LlPayload::Bytes27]
            .into_iter()
            .cycle(),
    ) {
        let air = air(AirOptions {
            condition,
            pdu,
            ..AirOptions::default()
        });
        let host = host(&air, "sim-host").await;
        let radio = air.radio("sim-a").await.expect("attaches");
        let (a, b) = dial(&radio, &host).await;
        let sdus: Vec<Vec<u8>> = (0_u32..1000)
            .map(|number| {
                let hash = number.wrapping_mul(2_654_435_761);
                vec![
                    number as u8;
                    1 + (hash >> 16) as usize % if number % 50 == 0 { 8000 } else { 600 }
                ]
            })
            .collect();
        let sending = sdus.clone();
        let sender = tokio::spawn(async move {
            for sdu in &sending {
                a.send(sdu).await.expect("sends");
            }
            a
        });
        let mut buffer = [0; 8192];
        for (number, sdu) in sdus.iter().enumerate() {
            let size = b.recv(&mut buffer).await.expect("arrives");
            assert_eq!(&buffer[..size], sdu, "sdu {number}, {condition}");
        }
        sender.await.expect("sends all");
    }
}

#[tokio::test(start_paused = true)]
async fn power_off_ends_all_operations_and_the_peers_channel() {
    let air = air(desk());
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let (a, b) = dial(&radio, &host).await;
    let mut scan = radio.scan().await.expect("scans");
    let changed = host.radio.changed();
    air.power("sim-host", false).expect("is attached");
    changed.await;
    assert_eq!(host.radio.state().await, AdapterState::Off);
    assert!(matches!(
        host.listener.accept().await,
        Err(RadioError::AdapterOff { .. })
    ));
    assert!(b.recv(&mut [0; 8]).await.is_err());
    assert!(timeout(Duration::from_secs(1), a.recv(&mut [0; 8]))
        .await
        .expect("in time")
        .is_err());
    assert!(matches!(
        host.radio.listen(None, OPTIONS).await.err(),
        Some(RadioError::AdapterOff { .. })
    ));
    // It no longer advertises: only reports from before arrive.
    while let Ok(received) = timeout(Duration::from_secs(1), scan.next()).await {
        received.expect("a report from before");
    }
    air.power("sim-host", true).expect("is attached");
    assert_eq!(radio.state().await, AdapterState::On);
    let changed = radio.changed();
    air.remove("sim-a").expect("is attached");
    changed.await;
    assert!(matches!(
        scan.next().await,
        Err(RadioError::NoAdapter { .. })
    ));
    assert!(matches!(
        radio.address().await,
        Err(RadioError::NoAdapter { .. })
    ));
}

#[tokio::test(start_paused = true)]
async fn refuses_a_psm_without_a_listener_and_a_psm_in_use() {
    let air = air(desk());
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let psm = Psm::new(0xf0).expect("valid");
    let peer = host.radio.address().await.expect("is attached");
    let refused = radio.connect(peer, psm, OPTIONS).await.err();
    assert!(
        matches!(refused, Some(RadioError::Refused { .. })),
        "{refused:?}"
    );
    let again = host
        .radio
        .listen(Some(host.listener.psm()), OPTIONS)
        .await
        .err();
    assert!(matches!(again, Some(RadioError::PsmTaken(_))), "{again:?}");
}

#[tokio::test(start_paused = true)]
async fn connect_waits_for_an_advertisement_and_can_be_cancelled() {
    let air = air(desk());
    let radio = air.radio("sim-a").await.expect("attaches");
    let other = air.radio("sim-b").await.expect("attaches");
    let listener = other.listen(None, OPTIONS).await.expect("listens");
    let peer = other.address().await.expect("is attached");
    let waiting = radio.connect(peer, listener.psm(), OPTIONS);
    assert!(timeout(Duration::from_secs(10), waiting).await.is_err());
    // Advertising now brings no incoming channel, because the connect was cancelled.
    let advertisement = Advertisement {
        psm: listener.psm(),
        plain: false,
        name_hash: 0,
        fleet_hash: 0,
        incarnation: 0,
    };
    let _advertised = other
        .advertise(&advertisement, "b")
        .await
        .expect("advertises");
    assert!(timeout(Duration::from_secs(2), listener.accept())
        .await
        .is_err());
    assert!(air.status().links.is_empty());
}

#[tokio::test(start_paused = true)]
async fn two_channels_share_one_connection_until_it_is_closed() {
    let air = air(desk());
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let first = dial(&radio, &host).await;
    let second = dial(&radio, &host).await;
    assert_eq!(air.status().links.len(), 1);
    drop(first);
    second.0.send(b"still here").await.expect("sends");
    assert_eq!(second.1.recv(&mut [0; 16]).await.expect("receives"), 10);
    drop(second.0);
    assert!(second.1.recv(&mut [0; 16]).await.is_err());
    drop(second.1);
    tokio::time::sleep(Duration::from_secs(60)).await;
    assert_eq!(air.status().links.len(), 1, "without a channel");
    // Either side may close it, and the channels end with it.
    let third = dial(&radio, &host).await;
    let own = radio.address().await.expect("is attached");
    host.radio.disconnect(own).await;
    for end in [&third.0, &third.1] {
        assert!(end.recv(&mut [0; 16]).await.is_err());
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert!(air.status().links.is_empty());
}

#[tokio::test(start_paused = true)]
async fn refuses_sdus_above_the_peers_limit() {
    let air = air(desk());
    let host = host(&air, "sim-host").await;
    let radio = air.radio("sim-a").await.expect("attaches");
    let (a, b) = dial(&radio, &host).await;
    assert_eq!(a.send_mtu(), 8192);
    assert!(matches!(
        a.send(&[0; 8193]).await,
        Err(RadioError::SduTooLarge {
            size: 8193,
            limit: 8192
        })
    ));
    a.send(&[7; 100]).await.expect("sends");
    assert!(matches!(
        b.recv(&mut [0; 50]).await,
        Err(RadioError::SduTooLarge { size: 100, .. })
    ));
}

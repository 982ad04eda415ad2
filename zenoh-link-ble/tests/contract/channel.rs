//! Contract of a radio's advertising, scanning and channels.
use std::{sync::Arc, time::Duration};

use zenoh_link_ble_radio::{
    address::{Address, AddressType, DeviceAddress, Psm},
    ChannelOptions, RadioError, Security,
};

use super::{advertisement, channel_pair, channel_pair_with, closing::disconnected, Paced, World};
use crate::shared::{listener::OPTIONS, peer::within};

pub async fn reports_an_advertisement_unchanged_and_repeatedly(world: World) {
    let sent = advertisement(Psm::new(0x91).expect("valid"), "wombat-7");
    let _advertising = world
        .b
        .advertise(&sent, "wombat-7")
        .await
        .expect("advertises");
    let device = world.b.address().await.expect("has an address");
    let mut scan = world.a.scan().await.expect("scans");
    for _ in 0..2 {
        let report = within("receiving the advertisement", async {
            loop {
                let report = scan.next().await.expect("keeps scanning");
                if report.device == device && report.advertisement.is_some() {
                    return report;
                }
            }
        })
        .await;
        assert_eq!(report.advertisement, Some(sent));
    }
}

pub async fn scan_starts_after_cancelled_scans(world: World) {
    for given_up_after_ms in 0..40 {
        let limit = Duration::from_millis(given_up_after_ms);
        let _ = tokio::time::timeout(limit, world.a.scan()).await;
    }
    within("starting a scan", world.a.scan())
        .await
        .expect("the next scan starts");
}

pub async fn delivers_sdus_of_every_size_in_order_in_both_directions(world: World) {
    let (near, far, _listener) = channel_pair(&world).await;
    let limit = near.send_mtu().min(far.send_mtu()).min(4096);
    let sizes: Vec<usize> = (0..60)
        .map(|n| [1, 2, 22, 23, 24, 246, 247, 248, 1000, limit][n % 10].min(limit))
        .collect();
    for (from, to) in [(&near, &far), (&far, &near)] {
        let sending = async {
            for (n, size) in sizes.iter().enumerate() {
                from.send(&vec![n as u8; *size]).await.expect("sends");
            }
        };
        let receiving = async {
            let mut buffer = vec![0; 5000];
            for (n, size) in sizes.iter().enumerate() {
                let received = to.recv(&mut buffer).await.expect("receives");
                assert_eq!(received, *size, "size of sdu {n}");
                assert!(buffer[..received].iter().all(|b| *b == n as u8), "sdu {n}");
            }
        };
        within("sending sixty sdus", async {
            tokio::join!(sending, receiving)
        })
        .await;
    }
}

/// A sender that the radio keeps waiting rests. Each K-frame that the radio sends may be a reason to try again.
pub async fn waiting_for_room_costs_few_attempts(world: World) {
    const SDUS: usize = 60;
    /// An SDU of 2000 bytes is about that many K-frames.
    const MAX_ATTEMPTS: usize = 10 * SDUS;
    // The limit of a link. With a smaller one, kernel 5.10 grants too few credits.
    let options = ChannelOptions {
        recv_mtu: 16_384,
        ..OPTIONS
    };
    let (near, far, _listener) = channel_pair_with(&world, options).await;
    let _paced = Paced::new(&world, 34_000);
    let sdu = vec![7; near.send_mtu().min(2000)];
    let sending = async {
        let mut attempts = 0_usize;
        for _ in 0..SDUS {
            while !near.try_send(&sdu).expect("sends") {
                attempts += 1;
                near.writable().await;
            }
        }
        attempts
    };
    let receiving = async {
        let mut buffer = vec![0; 5000];
        for _ in 0..SDUS {
            far.recv(&mut buffer).await.expect("receives");
        }
    };
    let (attempts, ()) = within("sending the sdus", async {
        tokio::join!(sending, receiving)
    })
    .await;
    println!("{attempts} attempts for {SDUS} sdus of {} bytes", sdu.len());
    assert!(
        attempts <= MAX_ATTEMPTS,
        "{attempts} attempts for {SDUS} sdus"
    );
}

pub async fn closing_a_channel_ends_the_peers_receive(world: World) {
    let (near, far, _listener) = channel_pair(&world).await;
    near.shutdown();
    let ended = within("the end", far.recv(&mut [0; 100])).await;
    assert!(
        matches!(ended, Err(RadioError::ChannelDown { .. })),
        "{ended:?}"
    );
}

/// Every call fails with `ChannelDown`, even after a send has returned the reason and the socket has no error left.
pub async fn channel_stays_down_after_repeated_calls(world: World) {
    let (_near, far, _listener) = channel_pair(&world).await;
    (world.lose_links)();
    within("the end", async { while far.send(b"?").await.is_ok() {} }).await;
    for _ in 0..3 {
        let received = within("an answer", far.recv(&mut [0; 100])).await;
        assert!(
            matches!(received, Err(RadioError::ChannelDown { .. })),
            "{received:?}"
        );
        let sent = within("an answer", far.send(b"?")).await;
        assert!(
            matches!(sent, Err(RadioError::ChannelDown { .. })),
            "{sent:?}"
        );
    }
}

pub async fn dropping_a_channel_ends_the_peers_receive(world: World) {
    let (near, far, _listener) = channel_pair(&world).await;
    drop(near);
    let ended = within("the end", far.recv(&mut [0; 100])).await;
    assert!(
        matches!(ended, Err(RadioError::ChannelDown { .. })),
        "{ended:?}"
    );
}

pub async fn refuses_a_psm_without_a_listener(world: World) {
    let listener = world.b.listen(None, OPTIONS).await.expect("listens");
    let free = (Psm::MIN..=Psm::MAX)
        .rev()
        .filter_map(Psm::new)
        .find(|psm| *psm != listener.psm())
        .expect("many are free");
    let _advertising = world
        .b
        .advertise(&advertisement(free, "b"), "b")
        .await
        .expect("advertises");
    let to = world.b.address().await.expect("has an address");
    let refused = within("the refusal", world.a.connect(to, free, OPTIONS)).await;
    assert!(
        matches!(refused, Err(RadioError::Refused { .. })),
        "{:?}",
        refused.err()
    );
}

pub async fn refuses_a_second_listener_on_a_psm(world: World) {
    let psm = Psm::new(0xa5).expect("valid");
    let _first = world.b.listen(Some(psm), OPTIONS).await.expect("listens");
    let second = world.b.listen(Some(psm), OPTIONS).await;
    assert!(matches!(second, Err(RadioError::PsmTaken(taken)) if taken == psm));
}

pub async fn connects_after_cancelled_connects(world: World) {
    let nobody = DeviceAddress {
        address: Address([0xc0, 1, 2, 3, 4, 5]),
        kind: AddressType::Random,
    };
    let psm = Psm::new(0x80).expect("valid");
    for _ in 0..2 {
        let attempt = world.a.connect(nobody, psm, OPTIONS);
        let given_up = tokio::time::timeout(Duration::from_millis(300), attempt).await;
        assert!(given_up.is_err(), "no device responds");
    }
    let (near, far, _listener) = channel_pair(&world).await;
    near.send(b"still works").await.expect("sends");
    let mut buffer = [0; 100];
    let size = within("the sdu", far.recv(&mut buffer))
        .await
        .expect("receives");
    assert_eq!(&buffer[..size], b"still works");
}

pub async fn supports_several_channels_between_two_radios(world: World) {
    let (one, one_far, listener) = channel_pair(&world).await;
    let _advertising = world
        .b
        .advertise(&advertisement(listener.psm(), "b"), "b")
        .await
        .expect("advertises");
    let to = world.b.address().await.expect("has an address");
    let (two, two_far) = within("the second channel", async {
        tokio::join!(
            world.a.connect(to, listener.psm(), OPTIONS),
            listener.accept()
        )
    })
    .await;
    let (two, two_far) = (two.expect("connects"), two_far.expect("accepts"));
    one.send(b"one").await.expect("sends");
    two.send(b"two").await.expect("sends");
    let mut buffer = [0; 100];
    let size = within("two", two_far.recv(&mut buffer))
        .await
        .expect("receives");
    assert_eq!(&buffer[..size], b"two");
    let size = within("one", one_far.recv(&mut buffer))
        .await
        .expect("receives");
    assert_eq!(&buffer[..size], b"one");
    two.shutdown();
    one.send(b"one again").await.expect("sends");
    let size = within("one", one_far.recv(&mut buffer))
        .await
        .expect("receives");
    assert_eq!(&buffer[..size], b"one again");
}

pub async fn refuses_an_sdu_above_the_channels_limit(world: World) {
    let (near, _far, _listener) = channel_pair(&world).await;
    let limit = near.send_mtu();
    let refused = near.send(&vec![0; limit + 1]).await;
    assert!(
        matches!(refused, Err(RadioError::SduTooLarge { .. })),
        "{refused:?}"
    );
}

/// A peer that does not advertise while it is connected can be dialled again only after that.
pub async fn connection_stays_open_until_it_is_closed(world: World) {
    for closing in [&world.a, &world.b] {
        let (near, far, _listener) = channel_pair(&world).await;
        drop((near, far));
        // Linux itself would close it two seconds after the last channel.
        tokio::time::sleep(Duration::from_secs(4)).await;
        assert!((world.is_connected)().await, "nobody has closed it");
        let other = match Arc::ptr_eq(closing, &world.a) {
            true => &world.b,
            false => &world.a,
        };
        let peer = other.address().await.expect("has an address");
        within("closing", closing.disconnect(peer)).await;
        disconnected(&world).await;
        // There is nothing to close.
        within("closing again", closing.disconnect(peer)).await;
    }
}

/// BlueZ's sockets, and bluer with them, report too early that they are connected. An SDU that is sent immediately
/// after that would be refused or lost.
pub async fn can_send_immediately_after_connect(world: World) {
    let listener = world.b.listen(None, OPTIONS).await.expect("listens");
    let _advertising = world
        .b
        .advertise(&advertisement(listener.psm(), "b"), "b")
        .await
        .expect("advertises");
    let to = world.b.address().await.expect("has an address");
    for round in 0..20 {
        let dialling = async {
            let near = world.a.connect(to, listener.psm(), OPTIONS).await;
            let near = near.expect("connects");
            near.send(b"hello").await.expect("sends at once");
            let mut buffer = [0; 100];
            let size = near.recv(&mut buffer).await.expect("receives");
            assert_eq!(&buffer[..size], b"hello to you");
        };
        let answering = async {
            let far = listener.accept().await.expect("accepts");
            let mut buffer = [0; 100];
            let size = far.recv(&mut buffer).await.expect("receives");
            assert_eq!(&buffer[..size], b"hello");
            far.send(b"hello to you").await.expect("sends");
            // Wait until the dialler has read it and closed the channel.
            let _ = far.recv(&mut buffer).await;
        };
        within(&format!("first exchange of round {round}"), async {
            tokio::join!(dialling, answering)
        })
        .await;
    }
}

pub async fn pairs_two_unknown_devices_for_an_encrypted_channel(world: World) {
    let options = ChannelOptions {
        security: Security::Medium,
        ..OPTIONS
    };
    let (near, far, _listener) = channel_pair_with(&world, options).await;
    near.send(b"in private").await.expect("sends");
    let mut buffer = [0; 100];
    let size = within("the sdu", far.recv(&mut buffer))
        .await
        .expect("receives");
    assert_eq!(&buffer[..size], b"in private");
}

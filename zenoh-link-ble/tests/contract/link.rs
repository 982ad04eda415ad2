//! What Zenoh may expect of a `ble` link.
use std::time::Duration;

use tokio::time::Instant;
use zenoh_link_commons::LinkManagerUnicastTrait;

use super::World;
use crate::shared::peer::{says, within, Peer};

pub async fn a_peer_is_found_by_name_and_batches_go_both_ways(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    assert_eq!(near.get_dst().address().as_str(), "wombat-2");
    assert!(near.is_reliable() && !near.is_streamed());
    let longest = vec![7; usize::from(near.get_mtu())];
    says(&near, &far, b"there").await;
    says(&far, &near, b"and back").await;
    says(&near, &far, &longest).await;
}

pub async fn a_peer_is_found_by_address(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2;psm=170").await;
    let a = Peer::on(&world.a);
    let address = world.b.address().await.expect("has an address");
    let near = a
        .dials(&format!("ble/{address}#psm=170"))
        .await
        .expect("dials");
    says(&near, &b.incoming().await, b"there").await;
    near.close().await.expect("closes");
}

pub async fn two_nodes_that_dial_each_other_at_once_make_one_link(world: World) {
    let a = Peer::on(&world.a).listens_as("name=wombat-1").await;
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let (from_a, from_b) = tokio::join!(
        a.dials("ble/wombat-2#timeout=6000"),
        b.dials("ble/wombat-1#timeout=6000")
    );
    let (near, far) = match (from_a, from_b) {
        (Ok(near), Err(_)) => (near, b.incoming().await),
        (Err(_), Ok(near)) => (near, a.incoming().await),
        (Ok(_), Ok(_)) => panic!("two links"),
        (Err(one), Err(other)) => panic!("no link: {one}; {other}"),
    };
    assert!(
        a.no_more_incoming() && b.no_more_incoming(),
        "a second link"
    );
    says(&near, &far, b"one link").await;
    says(&far, &near, b"both ways").await;
}

pub async fn a_link_opens_again_after_it_was_closed(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    for round in 0..3u8 {
        let near = a.dials("ble/wombat-2").await.expect("dials");
        let far = b.incoming().await;
        says(&near, &far, &[round + 1; 10]).await;
        // Either side may close; the other one's read then ends, and it closes too.
        let (closing, other) = if round % 2 == 0 {
            (&near, &far)
        } else {
            (&far, &near)
        };
        let reading = async {
            let ended = other.read(&mut [0; 2000], None).await;
            assert!(ended.is_err(), "the other side sees the end");
            other.close().await.expect("closes");
        };
        let (closed, ()) =
            within("closing", async { tokio::join!(closing.close(), reading) }).await;
        closed.expect("closes");
    }
}

pub async fn a_link_waits_until_zenoh_let_the_ended_one_go_and_computed_its_routes(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("dials");
    let ended = b.incoming().await;
    let reading = async {
        let end = ended.read(&mut [0; 2000], None).await;
        assert!(end.is_err(), "the other side sees the end");
    };
    within("closing", async { tokio::join!(near.close(), reading) })
        .await
        .0
        .expect("closes");

    let near = a.dials("ble/wombat-2").await.expect("dials");
    tokio::time::sleep(Duration::from_millis(500)).await;
    assert!(b.no_more_incoming(), "Zenoh holds the ended one still");
    ended.close().await.expect("closes");
    let released = Instant::now();
    let far = b.incoming().await;
    // Zenoh computes its routes at most every 100 ms, and some time goes by until it gets to it.
    assert!(released.elapsed() >= Duration::from_millis(200));
    says(&near, &far, b"there").await;
}

pub async fn what_was_sent_before_close_arrives(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    for n in 1..=5u8 {
        near.write_all(&[n; 500], None).await.expect("writes");
    }
    let reading = async {
        let mut buffer = [0; 2000];
        for n in 1..=5u8 {
            let size = far.read(&mut buffer, None).await.expect("reads");
            assert_eq!(&buffer[..size], &[n; 500]);
        }
        assert!(far.read(&mut buffer, None).await.is_err(), "then the end");
    };
    within("closing", async { tokio::join!(near.close(), reading) })
        .await
        .0
        .expect("closes");
}

pub async fn an_empty_write_is_no_end_of_the_link(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    near.write_all(&[], None).await.expect("does nothing");
    says(&near, &far, b"still here").await;
}

pub async fn the_smaller_mtu_of_both_sides_counts(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2;mtu=300").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2#mtu=2000").await.expect("dials");
    let far = b.incoming().await;
    assert_eq!((near.get_mtu(), far.get_mtu()), (300, 300));
    assert!(near.write_all(&[0; 301], None).await.is_err());
    says(&near, &far, &[9; 300]).await;
}

pub async fn a_name_nobody_advertises_is_an_error_that_names_it(world: World) {
    let a = Peer::on(&world.a);
    let error = a
        .dials("ble/nobody#timeout=500")
        .await
        .expect_err("nobody")
        .to_string();
    assert!(
        error.contains("nobody in range advertises as nobody"),
        "{error}"
    );
}

pub async fn a_second_node_of_the_same_name_is_told_so(world: World) {
    let _b = Peer::on(&world.b).listens_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let error = a
        .try_listen("name=wombat-2")
        .await
        .expect_err("the name is taken")
        .to_string();
    assert!(
        error.contains("give one of the two another name="),
        "{error}"
    );
}

pub async fn a_listener_ends_when_it_is_deleted_and_can_start_again(world: World) {
    let b = Peer::on(&world.b).listens_as("name=wombat-2;psm=171").await;
    assert!(b.try_listen("name=other").await.is_err(), "one per adapter");
    let endpoint = "ble/hci0".parse().expect("an endpoint");
    b.manager.del_listener(&endpoint).await.expect("ends");
    assert!(b.manager.get_listeners().await.is_empty());
    assert!(b.manager.del_listener(&endpoint).await.is_err());
    let b = b.listens_as("name=wombat-2;psm=171").await;
    let a = Peer::on(&world.a);
    let near = a.dials("ble/wombat-2").await.expect("dials");
    says(&near, &b.incoming().await, b"again").await;
}

//! Contract between Zenoh and a `ble` link.

use zenoh_link_commons::LinkManagerUnicastTrait;

use super::World;
use crate::shared::peer::{assert_delivers, within, Peer};

pub async fn dials_by_name_and_delivers_batches_in_both_directions(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dial("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    assert_eq!(near.get_dst().address().as_str(), "wombat-2");
    assert!(near.is_reliable() && !near.is_streamed());
    let longest = vec![7; usize::from(near.get_mtu())];
    assert_delivers(&near, &far, b"there").await;
    assert_delivers(&far, &near, b"and back").await;
    assert_delivers(&near, &far, &longest).await;
}

pub async fn dials_by_address(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2;psm=170").await;
    let a = Peer::on(&world.a);
    let address = world.b.address().await.expect("has an address");
    let near = a
        .dial(&format!("ble/{address}#psm=170"))
        .await
        .expect("dials");
    assert_delivers(&near, &b.incoming().await, b"there").await;
    near.close().await.expect("closes");
}

pub async fn two_nodes_that_dial_each_other_make_one_link(world: World) {
    let a = Peer::on(&world.a).listen_as("name=wombat-1").await;
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let (from_a, from_b) = tokio::join!(
        a.dial("ble/wombat-2#timeout=6000"),
        b.dial("ble/wombat-1#timeout=6000")
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
    assert_delivers(&near, &far, b"one link").await;
    assert_delivers(&far, &near, b"both ways").await;
}

pub async fn reconnects_after_a_close_by_either_side(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    for round in 0..3u8 {
        let near = a.dial("ble/wombat-2").await.expect("dials");
        let far = b.incoming().await;
        assert_delivers(&near, &far, &[round + 1; 10]).await;
        // Either side may close. The read of the other side then fails, and it closes too.
        let (closing, other) = if round % 2 == 0 {
            (&near, &far)
        } else {
            (&far, &near)
        };
        let reading = async {
            let ended = other.read(&mut [0; 2000], None).await;
            assert!(ended.is_err(), "the other side detects the end");
            other.close().await.expect("closes");
        };
        let (closed, ()) =
            within("closing", async { tokio::join!(closing.close(), reading) }).await;
        closed.expect("closes");
    }
}

pub async fn delivers_batches_sent_before_close(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dial("ble/wombat-2").await.expect("dials");
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
        assert!(
            far.read(&mut buffer, None).await.is_err(),
            "the link has ended"
        );
    };
    within("closing", async { tokio::join!(near.close(), reading) })
        .await
        .0
        .expect("closes");
}

pub async fn an_empty_write_does_not_end_the_link(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let near = a.dial("ble/wombat-2").await.expect("dials");
    let far = b.incoming().await;
    near.write_all(&[], None).await.expect("does nothing");
    assert_delivers(&near, &far, b"still here").await;
}

pub async fn uses_the_smaller_mtu_of_both_sides(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2;mtu=300").await;
    let a = Peer::on(&world.a);
    let near = a.dial("ble/wombat-2#mtu=2000").await.expect("dials");
    let far = b.incoming().await;
    assert_eq!((near.get_mtu(), far.get_mtu()), (300, 300));
    assert!(near.write_all(&[0; 301], None).await.is_err());
    assert_delivers(&near, &far, &[9; 300]).await;
}

pub async fn error_names_a_peer_that_does_not_advertise(world: World) {
    let a = Peer::on(&world.a);
    let error = a
        .dial("ble/nobody#timeout=500")
        .await
        .expect_err("nobody")
        .to_string();
    assert!(
        error.contains("cannot connect to nobody: no advertisement received"),
        "{error}"
    );
}

pub async fn rejects_a_second_listener_with_the_same_name(world: World) {
    let _b = Peer::on(&world.b).listen_as("name=wombat-2").await;
    let a = Peer::on(&world.a);
    let endpoint = "ble/hci0".parse().expect("an endpoint");
    let error = within("the rejection", async {
        loop {
            match a.try_listen("name=wombat-2").await {
                Err(error) => break error.to_string(),
                Ok(()) if world.is_simulated => panic!("the name is taken"),
                // The search takes half a second, in which a busy computer may receive no advertisement.
                Ok(()) => a.manager.del_listener(&endpoint).await.expect("ends"),
            }
        }
    })
    .await;
    assert!(
        error.contains("give one of the two another name="),
        "{error}"
    );
}

pub async fn listener_can_be_deleted_and_started_again(world: World) {
    let b = Peer::on(&world.b).listen_as("name=wombat-2;psm=171").await;
    assert!(b.try_listen("name=other").await.is_err(), "one per adapter");
    let endpoint = "ble/hci0".parse().expect("an endpoint");
    b.manager.del_listener(&endpoint).await.expect("ends");
    assert!(b.manager.get_listeners().await.is_empty());
    assert!(b.manager.del_listener(&endpoint).await.is_err());
    let b = b.listen_as("name=wombat-2;psm=171").await;
    let a = Peer::on(&world.a);
    let near = a.dial("ble/wombat-2").await.expect("dials");
    assert_delivers(&near, &b.incoming().await, b"again").await;
}

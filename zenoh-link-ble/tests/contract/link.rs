//! What Zenoh may expect of a `ble` link.
use std::sync::Arc;

use tokio::runtime::Handle;
use zenoh_link_ble::{radio::Radio, LinkManagerUnicastBle};
use zenoh_link_commons::{LinkManagerUnicastTrait, LinkUnicast};
use zenoh_result::ZResult;

use super::{within, World};

/// A node as Zenoh has one: a link manager, and the links that came in.
pub struct Peer {
    pub manager: Arc<LinkManagerUnicastBle>,
    incoming: flume::Receiver<LinkUnicast>,
}

impl Peer {
    pub fn on(radio: &Arc<dyn Radio>) -> Self {
        let (sender, incoming) = flume::unbounded();
        let radio = Arc::clone(radio);
        let open = move |_: Option<&str>| Ok(Arc::clone(&radio));
        let manager = LinkManagerUnicastBle::with_radios(sender, Handle::current(), open);
        Self {
            manager: Arc::new(manager),
            incoming,
        }
    }

    /// Listens on the radio that it was made with, whatever its name.
    pub async fn listens_as(self, options: &str) -> Self {
        self.try_listen(options).await.expect("listens");
        self
    }

    pub async fn try_listen(&self, options: &str) -> ZResult<()> {
        let endpoint = format!("ble/hci0#{options}").parse().expect("an endpoint");
        within("listening", self.manager.new_listener(endpoint))
            .await
            .map(|_| ())
    }

    pub async fn dials(&self, locator: &str) -> ZResult<LinkUnicast> {
        let endpoint = locator.parse().expect("an endpoint");
        within("dialling", self.manager.new_link(endpoint)).await
    }

    pub async fn incoming(&self) -> LinkUnicast {
        within("the incoming link", self.incoming.recv_async())
            .await
            .expect("the manager lives")
    }

    pub fn no_more_incoming(&self) -> bool {
        self.incoming.is_empty()
    }
}

pub async fn says(from: &LinkUnicast, to: &LinkUnicast, batch: &[u8]) {
    within("writing", from.write_all(batch, None))
        .await
        .expect("writes");
    let mut buffer = vec![0; 9000];
    let size = within("reading", to.read(&mut buffer, None))
        .await
        .expect("reads");
    assert_eq!(&buffer[..size], batch);
}

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

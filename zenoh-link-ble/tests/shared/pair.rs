//! Provides two nodes on a separate air, and measures the resources that remain after their links ended.
use std::{sync::Arc, time::Duration};

use tokio::{runtime::Handle, time::Instant};
use zenoh_link_ble::LinkCounts;
use zenoh_link_ble_air::{AirOptions, Condition, SimAir};
use zenoh_link_ble_radio::Radio;
use zenoh_link_commons::LinkUnicast;

use crate::shared::peer::{assert_delivers, Peer};

/// Supervision timeout of the radios.
pub const SUPERVISION: Duration = Duration::from_secs(2);
/// Maximum time from the end of a fault to a working link. The air needs about half of it: an advertising report, an
/// advertisement to respond to, three events to set the connection up, and the round trips of the channel and the
/// handshake. A connect request that is lost costs 200 ms more.
pub const RECONNECT_LIMIT: Duration = Duration::from_millis(1200);

/// Two nodes: `near` dials, `far` listens.
pub struct Pair {
    pub air: SimAir,
    pub near: Peer,
    pub far: Peer,
}

/// Resources in use while the nodes are not linked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resources {
    tasks: usize,
    link_counts: [LinkCounts; 2],
    connections: usize,
}

impl Pair {
    pub async fn on(condition: Condition, seed: u64) -> Self {
        let air = SimAir::new(AirOptions {
            seed,
            condition,
            supervision_timeout: SUPERVISION,
            ..AirOptions::default()
        });
        let far: Arc<dyn Radio> = air.radio("sim-far").await.expect("attaches");
        let near: Arc<dyn Radio> = air.radio("sim-near").await.expect("attaches");
        let (near, far) = (Peer::on(&near), Peer::on(&far));
        let far = far.listen_as("name=far").await;
        // Wait until the listener has finished its check for name conflicts.
        tokio::time::sleep(Duration::from_secs(3)).await;
        Self { air, near, far }
    }

    /// Links the two nodes and checks the link in both directions.
    pub async fn link(&self) -> (LinkUnicast, LinkUnicast) {
        let near = self.near.dial("ble/far").await.expect("dials");
        let far = self.far.incoming().await;
        assert_delivers(&near, &far, b"there").await;
        assert_delivers(&far, &near, b"and back").await;
        (near, far)
    }

    /// Links the nodes again after a fault that ended at `since`, and checks how long it took.
    pub async fn link_again(&self, since: Instant, what: &str) -> (LinkUnicast, LinkUnicast) {
        let linked = self.link().await;
        let took = since.elapsed();
        assert!(
            took <= RECONNECT_LIMIT,
            "{what}: linked again after {took:?}"
        );
        assert!(self.far.no_more_incoming(), "{what}: a second link exists");
        linked
    }

    pub fn resources(&self) -> Resources {
        Resources {
            tasks: Handle::current().metrics().num_alive_tasks(),
            link_counts: [
                self.near.manager.link_counts(),
                self.far.manager.link_counts(),
            ],
            connections: self.air.status().links.len(),
        }
    }

    /// Returns the resources after everything that ends by timeout is released: a pending handshake, a connection
    /// without a channel.
    pub async fn resources_after_cleanup(&self) -> Resources {
        tokio::time::sleep(2 * SUPERVISION).await;
        self.resources()
    }
}

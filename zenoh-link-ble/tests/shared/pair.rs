//! Two nodes on an air of their own, and what must be left of them when their links are over.
use std::{sync::Arc, time::Duration};

use tokio::{runtime::Handle, time::Instant};
use zenoh_link_ble::{
    links::Census,
    radio::{
        sim::{AirOptions, Condition, SimAir},
        Radio,
    },
};
use zenoh_link_commons::LinkUnicast;

use crate::shared::peer::{says, Peer};

/// When a radio gives up a connection on which it hears nothing.
pub const SUPERVISION: Duration = Duration::from_secs(2);
/// From the end of a fault to a link that works: a second, of which the air needs about half: a sighting, an advertisement to
/// answer, three events to set the connection up, and the round trips of the channel and of the hellos.
pub const BACK: Duration = Duration::from_secs(1);
/// `near` dials, `far` listens.
pub struct Pair {
    pub air: SimAir,
    pub near: Peer,
    pub far: Peer,
}

/// What there is while nobody is linked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leftovers {
    tasks: usize,
    censuses: [Census; 2],
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
        let far = far.listens_as("name=far").await;
        // Until the listener has done looking for another one of its name.
        tokio::time::sleep(Duration::from_secs(3)).await;
        Self { air, near, far }
    }

    /// Links the two and tries the link both ways.
    pub async fn link(&self) -> (LinkUnicast, LinkUnicast) {
        let near = self.near.dials("ble/far").await.expect("dials");
        let far = self.far.incoming().await;
        says(&near, &far, b"there").await;
        says(&far, &near, b"and back").await;
        (near, far)
    }

    /// The same after a fault that is over since `since`.
    pub async fn link_again(&self, since: Instant, what: &str) -> (LinkUnicast, LinkUnicast) {
        let linked = self.link().await;
        let took = since.elapsed();
        assert!(took <= BACK, "{what}: linked again after {took:?}");
        assert!(
            self.far.no_more_incoming(),
            "{what}: there is a second link"
        );
        linked
    }

    pub fn leftovers(&self) -> Leftovers {
        Leftovers {
            tasks: Handle::current().metrics().num_alive_tasks(),
            censuses: [self.near.manager.census(), self.far.manager.census()],
            connections: self.air.status().links.len(),
        }
    }

    /// The same once all that goes by itself is gone: a silent peer's greeting, a connection without a channel.
    pub async fn leftovers_in_the_end(&self) -> Leftovers {
        tokio::time::sleep(2 * SUPERVISION).await;
        self.leftovers()
    }
}

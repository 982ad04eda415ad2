//! Runs the link contract on the simulated air: `cargo test -p zenoh-link-ble --test sim link_contract`.
use zenoh_link_ble_air::{AirOptions, Condition, SimAir};

use crate::contract::{self, World};

async fn world(condition: Condition) -> World {
    let air = SimAir::new(AirOptions {
        condition,
        ..AirOptions::default()
    });
    World {
        a: air.radio("sim-a").await.expect("attaches"),
        b: air.radio("sim-b").await.expect("attaches"),
        is_connected: {
            let air = air.clone();
            Box::new(move || {
                let is_connected = !air.status().links.is_empty();
                Box::pin(async move { is_connected })
            })
        },
        lose_links: Box::new(move || air.cut()),
        set_pace: Box::new(|_| ()),
        is_simulated: true,
    }
}

macro_rules! on_sim {
    ($($scenario:ident: $group:ident,)+) => {
        $(
            #[tokio::test(start_paused = true)]
            async fn $scenario() {
                for condition in [Condition::Desk, Condition::Room, Condition::Wall] {
                    contract::$group::$scenario(world(condition).await).await;
                }
            }
        )+
    };
}

for_each_scenario!(on_sim);

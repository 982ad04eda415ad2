//! Teleoperation: steering commands overtake everything else, and a robot that hears none for half a second stops.
//!
//!     cargo run --example teleoperation -- wombat-1             # is driven
//!     cargo run --example teleoperation -- laptop wombat-1      # drives it
use std::time::Duration;

use serde::{Deserialize, Serialize};

#[derive(Debug, Serialize, Deserialize)]
struct Drive {
    left: f64,
    right: f64,
}

const STOP: Drive = Drive {
    left: 0.0,
    right: 0.0,
};

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut names = std::env::args().skip(1);
    let me = names.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    match names.next() {
        Some(other) => drive(&robot, &other).await,
        None => be_driven(&robot).await,
    }
}

async fn drive(robot: &rect::Robot, other: &str) -> Result<(), rect::Error> {
    let urgent = robot.urgent();
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    for n in 0..200 {
        ticks.tick().await;
        let left = (f64::from(n) / 20.0).sin();
        let command = Drive { left, right: -left };
        urgent.send(other, "drive", rect::Cbor(command)).await?;
    }
    urgent.send(other, "drive", rect::Cbor(STOP)).await
}

async fn be_driven(robot: &rect::Robot) -> Result<(), rect::Error> {
    let commands = robot.subscribe("*/drive").await?;
    loop {
        let next = tokio::time::timeout(Duration::from_millis(500), commands.recv()).await;
        match next {
            Ok(Some(message)) => println!(
                "{} says {:?}",
                message.from,
                message.payload.value::<Drive>()?
            ),
            Ok(None) => return Ok(()),
            Err(_) => println!("nobody steers: {STOP:?}"),
        }
    }
}

//! Teleoperation: drive commands are urgent and overtake all other messages, and expire. A robot that receives none for
//! half a second stops.
//!
//!     cargo run --example teleoperation -- wombat-1             # receives commands
//!     cargo run --example teleoperation -- laptop wombat-1      # sends commands
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

/// A drive command is dropped rather than executed later than this. The last one, to stop, never expires.
const LIFETIME: Duration = Duration::from_millis(200);

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut names = std::env::args().skip(1);
    let me = names.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    match names.next() {
        Some(other) => drive(&robot, &other).await,
        None => follow(&robot).await,
    }
}

async fn drive(robot: &rect::Robot, recipient: &str) -> Result<(), rect::Error> {
    let urgent = robot.urgent();
    let steering = urgent.expires_after(LIFETIME);
    let mut ticks = tokio::time::interval(Duration::from_millis(50));
    for n in 0..200 {
        ticks.tick().await;
        let left = (f64::from(n) / 20.0).sin();
        let command = Drive { left, right: -left };
        let command = rect::Cbor(command);
        match steering.send(recipient, "drive", command).await {
            // It stops by itself, and is steered again when it is back.
            Err(error @ rect::Error::NotReachable { .. }) => eprintln!("{error}"),
            sent => sent?,
        }
    }
    urgent.send(recipient, "drive", rect::Cbor(STOP)).await
}

async fn follow(robot: &rect::Robot) -> Result<(), rect::Error> {
    let within = Duration::from_millis(500);
    let execute = |command: Drive| println!("{command:?}");
    let stop = |reason: &str| println!("stopping: {reason}");
    let _switch = robot
        .deadman::<Drive>("*/drive", within, execute, stop)
        .await?;
    std::future::pending().await
}

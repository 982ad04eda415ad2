//! Telemetry: a robot publishes its arm's angle and battery voltage ten times per second, compressed with a dictionary, and
//! prints those of other robots.
//!
//!     cargo run --example telemetry -- wombat-1
use std::{sync::Arc, time::Duration};

use rect::core::dictionary::Dictionary;
use serde::{Deserialize, Serialize};

#[derive(Debug, Serialize, Deserialize)]
struct Telemetry {
    angle_deg: f64,
    battery_volt: f64,
    moving: bool,
}

fn measure(n: u32) -> Telemetry {
    let angle_deg = (f64::from(n) / 20.0).sin() * 90.0;
    Telemetry {
        angle_deg: (angle_deg * 10.0).round() / 10.0,
        battery_volt: 7.2,
        moving: n % 100 < 50,
    }
}

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&name).await?;

    // Trains a dictionary on messages of the same kind, which reduces 60 bytes to a third. Receivers fetch it automatically.
    let samples: Vec<_> = (0..2000)
        .flat_map(|n| serde_json::to_vec(&measure(n)))
        .collect();
    let dictionary = Arc::new(Dictionary::train(&samples, 4096)?);
    let compressing = robot.with_dictionary(dictionary)?;

    let _subscription = robot
        .on_message("*/telemetry", |message| {
            match message.payload.value::<Telemetry>() {
                Ok(telemetry) => println!("{}: {telemetry:?}", message.sender),
                Err(error) => eprintln!("{}: {error}", message.sender),
            }
        })
        .await?;
    let mut ticks = tokio::time::interval(Duration::from_millis(100));
    for n in 0.. {
        ticks.tick().await;
        compressing
            .publish("telemetry", rect::Json(measure(n)))
            .await?;
    }
    Ok(())
}

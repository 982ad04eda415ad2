//! Telemetry: publishes an arm's angle and the battery's voltage ten times per second, and prints those of all robots.
//!
//!     cargo run --example telemetry -- wombat-1
//!     cargo run --example telemetry -- wombat-1 compressed      # the messages after the first 100 have half the size
use std::{ops::Range, sync::Arc, time::Duration};

use rect::Dictionary;
use serde::{Deserialize, Serialize};

type Result = std::result::Result<(), Box<dyn std::error::Error>>;

#[derive(Debug, Serialize, Deserialize)]
struct Telemetry {
    angle_deg: f64,
    battery_volt: f64,
    moving: bool,
}

const FIRST: Range<u32> = 0..100;

fn measure(n: u32) -> Telemetry {
    let angle_deg = (f64::from(n) / 20.0).sin() * 90.0;
    Telemetry {
        angle_deg: (angle_deg * 10.0).round() / 10.0,
        battery_volt: 7.2,
        moving: n % 100 < 50,
    }
}

#[tokio::main]
async fn main() -> Result {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&name).await?;
    let _subscription = robot
        .on_message::<Telemetry>("*/telemetry", |message| match message.value {
            Ok(telemetry) => println!("{}: {telemetry:?}", message.sender),
            Err(problem) => eprintln!("{}: {problem}", message.sender),
        })
        .await?;
    match arguments.next().as_deref() {
        Some("compressed") => publish_compressed(&robot).await,
        _ => publish(&robot, 0..u32::MAX).await,
    }
}

async fn publish(robot: &rect::Robot, numbers: Range<u32>) -> Result {
    let mut ticks = tokio::time::interval(Duration::from_millis(100));
    for n in numbers {
        ticks.tick().await;
        robot.publish("telemetry", rect::Json(measure(n))).await?;
    }
    Ok(())
}

/// Optional second step: trains a dictionary on the first 100 messages. Receivers fetch it automatically.
async fn publish_compressed(robot: &rect::Robot) -> Result {
    publish(robot, FIRST).await?;
    let samples: Vec<_> = FIRST
        .map(|n| serde_json::to_vec(&measure(n)))
        .collect::<std::result::Result<_, _>>()?;
    let dictionary = Arc::new(Dictionary::train(&samples, 1024)?);
    publish(&robot.with_dictionary(dictionary)?, FIRST.end..u32::MAX).await
}

//! Rescue: each robot publishes its battery and serves its pose. If the battery of one is low, the others ask it.
//!
//!     cargo run --example rescue -- wombat-1
//!     cargo run --example rescue -- wombat-2 12      # its battery has 12 percent
use std::{env, time::Duration};

use serde::{Deserialize, Serialize};

#[derive(Serialize, Deserialize)]
struct Battery {
    percent: f64,
    #[serde(default)]
    charging: bool,
}

#[derive(Debug, Serialize, Deserialize)]
struct Pose {
    x: f64,
    y: f64,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = env::args().nth(1).unwrap_or("wombat-1".to_owned());
    let percent = env::args().nth(2).unwrap_or("80".to_owned()).parse()?;
    let robot = rect::blocking::connect(&name)?;
    let _service = robot.serve("pose", |_| {
        Ok::<_, String>(rect::Json(Pose { x: 1.5, y: 0.5 }))
    })?;
    let publisher = robot.publisher::<Battery>("battery")?;
    let batteries = robot.subscribe::<Battery>("*/battery")?;
    publisher.wait_for_subscriber(Duration::from_secs(60))?;
    publisher.publish(Battery {
        percent,
        charging: false,
    })?;
    for message in batteries {
        let sender = message.sender;
        match message.value {
            Ok(battery) if battery.percent < 20.0 && !battery.charging => {
                let pose = robot.request::<Pose>(sender.clone(), "pose", "")?.value;
                println!("{sender} needs help at {}, {}", pose.x, pose.y);
            }
            Ok(battery) => println!("{sender}: {} percent", battery.percent),
            Err(problem) => println!("{sender}: {problem}"),
        }
    }
    Ok(())
}

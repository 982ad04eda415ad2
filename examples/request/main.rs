//! Request and response: a robot serves its battery's state; another asks, and all are asked.
//!
//!     cargo run --example request -- wombat-1             # serves
//!     cargo run --example request -- wombat-2 wombat-1    # asks
use std::time::Duration;

use serde_json::{json, Value};

const PATIENCE: Duration = Duration::from_secs(2);

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut names = std::env::args().skip(1);
    let me = names.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    let Some(other) = names.next() else {
        return serve(&robot).await;
    };
    // The answer comes to this call alone. An error of the service is an error here.
    let reply = robot
        .request(other.as_str(), "battery", json!({"cell": 1}), PATIENCE)
        .await?;
    println!("{}: {}", reply.from, reply.payload.value::<Value>()?);
    let mut replies = robot
        .request_all("battery", json!({"cell": 9}), PATIENCE)
        .await?;
    while let Some(reply) = replies.next().await {
        match reply {
            Ok(reply) => println!("{}: {}", reply.from, reply.payload.value::<Value>()?),
            Err(error) => println!("{error}"),
        }
    }
    Ok(())
}

async fn serve(robot: &rect::Robot) -> Result<(), rect::Error> {
    let _service = robot
        .serve("battery", |request| async move {
            let asked: Value = request.payload.value().map_err(|error| error.to_string())?;
            match asked["cell"].as_u64() {
                Some(cell @ 1..=2) => Ok(json!({ "cell": cell, "volt": 3.6 })),
                _ => Err("there are the cells 1 and 2".to_owned()),
            }
        })
        .await?;
    println!("{} serves; Ctrl-C ends this", robot.name());
    std::future::pending().await
}

//! Request: a robot offers its battery's state as a service. Another robot sends requests to it, and to all robots.
//!
//!     cargo run --example request -- wombat-1             # offers the service
//!     cargo run --example request -- wombat-2 wombat-1    # sends requests
use rect::Json;
use serde::{Deserialize, Serialize};
use serde_json::{json, Value};

#[derive(Debug, Serialize, Deserialize)]
struct Cell {
    cell: u64,
    volt: f64,
}

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut names = std::env::args().skip(1);
    let me = names.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    let Some(other) = names.next() else {
        return serve(&robot).await;
    };
    // Only this call receives the reply. If the service replies with an error, the call fails with it.
    let reply = robot
        .request::<Cell>(other.as_str(), "battery", json!({"cell": 1}))
        .await?;
    println!("{}: {:?}", reply.sender, reply.value);
    let replies = robot
        .request_all::<Cell>("battery", json!({"cell": 9}))
        .await?;
    while let Some(reply) = replies.next().await {
        match reply {
            Ok(reply) => println!("{}: {:?}", reply.sender, reply.value),
            Err(error) => println!("{error}"),
        }
    }
    Ok(())
}

async fn serve(robot: &rect::Robot) -> Result<(), rect::Error> {
    let _service = robot
        .serve("battery", |request| async move {
            let query: Value = request.payload.value().map_err(|error| error.to_string())?;
            match query["cell"].as_u64() {
                Some(cell @ 1..=2) => Ok(Json(Cell { cell, volt: 3.6 })),
                _ => Err("the cell must be 1 or 2".to_owned()),
            }
        })
        .await?;
    println!("{} serves requests; press Ctrl-C to stop", robot.name());
    std::future::pending().await
}

//! Log: a robot logs lines, which `rect log` shows at any robot of the fleet, and raises an alert.
//!
//!     cargo run --example log -- wombat-1
use tracing_subscriber::prelude::*;

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let me = std::env::args().nth(1).unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    robot.log(rect::Level::Info, "ready");
    // From here on, the program's own `tracing` does the same.
    let layer = rect::LogLayer::new(&robot);
    tracing_subscriber::registry().with(layer).init();
    tracing::warn!(angle = 12.5, "the gripper is slow");
    // Until robot.clear_alert("battery low").
    robot.alert(rect::Level::Warn, "battery low").await?;
    robot.close().await
}

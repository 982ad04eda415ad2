//! State: a robot retains its mode. A program that starts later receives the last mode of each robot first, and then each change.
//!
//!     cargo run --example state -- wombat-1 auto      # retains the mode, and ends
//!     cargo run --example state -- wombat-2           # prints the modes of all robots
//!     cargo run --example state -- wombat-1 none      # forgets the mode
#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut arguments = std::env::args().skip(1);
    let me = arguments.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    match arguments.next().as_deref() {
        Some("none") => return robot.forget("mode").await,
        // The router of this robot keeps the value when this program ends.
        Some(mode) => return robot.retained().publish("mode", mode).await,
        None => {}
    }
    let modes = robot.subscribe::<String>("*/mode").await?;
    // Until Ctrl-C. A topic that was forgotten has no value.
    while let Some(message) = modes.next().await {
        let mode = message.value.unwrap_or("none".to_owned());
        let age = message.retained.unwrap_or_default().age;
        println!("{}: {mode}, for {} s", message.sender, age.as_secs());
    }
    Ok(())
}

//! Hello: publishes a message, sends a request, and prints what another robot publishes. Start `rect sim` first.
//!
//!     cargo run --example hello
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robot = rect::blocking::connect("wombat-1")?;
    // Every program that subscribes to greetings receives this.
    robot.publish("greeting", "hello")?;
    // Only this program receives the reply.
    let battery = robot.request::<rect::Value>("wombat-2", "battery", "")?;
    println!("battery of {}: {}", battery.sender, battery.value);
    // Until Ctrl-C.
    for message in robot.subscribe::<rect::Value>("wombat-2/**")? {
        println!("{} {}: {}", message.sender, message.topic, message.value?);
    }
    Ok(())
}

//! A program of a user. `rustc` accepts it without its wrong lines, and rejects each of those.
use rect::{blocking::Robot, Message, Payload, Value};

fn show(message: &Message<f64>) -> String {
    format!("{}: {:?}", message.sender, message.value)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let robot: Robot = rect::blocking::connect("wombat-1")?;
    let angles = robot.publisher::<f64>("arm/angle")?;
    angles.publish(12.5)?;
    angles.publish("12.5")?; // wrong
    for message in robot.subscribe::<f64>("*/arm/angle")? {
        show(&message);
        let angle: f64 = message.value?;
        let text: String = message.value?; // wrong
        println!("{}", angle + 1.0);
    }
    for message in robot.subscribe("*/arm/angle")? {} // wrong
    for message in robot.subscribe::<std::thread::Thread>("*/arm/angle")? {} // wrong
    for message in robot.subscribe::<Payload>("*/camera")? {
        println!("{}", message.payload.bytes.len());
        show(&message); // wrong
    }
    let pose: (f64, f64) = robot.request::<(f64, f64)>("wombat-2", "pose", "")?.value;
    let pose: f64 = robot.request::<(f64, f64)>("wombat-2", "pose", "")?.value; // wrong
    let any: Value = robot.request::<Value>("wombat-2", "battery", "")?.value;
    println!("{pose:?} {any}");
    Ok(())
}

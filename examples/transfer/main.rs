//! Transfer: a file of any size goes to another robot, over a radio that comes and goes.
//!
//!     cargo run --example transfer -- wombat-1                        # takes files, into the folder `received`
//!     cargo run --example transfer -- wombat-2 wombat-1 map.bin       # sends one
use std::path::Path;

use rect::ReceiveTransfers;

/// Whoever sends more is refused.
const MAX_BYTES: u64 = 1 << 30;

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut arguments = std::env::args().skip(1);
    let me = arguments.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    if let (Some(other), Some(file)) = (arguments.next(), arguments.next()) {
        let shown = |progress: rect::core::transfer::Progress| {
            println!("{:3.0} %", progress.fraction() * 100.0);
        };
        let sent = robot.transfer(other.as_str(), "files", Path::new(&file))?;
        sent.on_progress(shown).await?;
        println!("{file} is there, whole");
        return Ok(());
    }
    let options = ReceiveTransfers::in_folder("received", MAX_BYTES);
    let files = robot.receive_transfers("*/files", options).await?;
    println!("{} takes files; Ctrl-C ends this", robot.name());
    while let Some(file) = files.next().await {
        match file {
            Ok(file) => println!(
                "{} of {}: {:?}",
                file.about.name, file.about.from, file.content
            ),
            Err(error) => println!("{error}"),
        }
    }
    Ok(())
}

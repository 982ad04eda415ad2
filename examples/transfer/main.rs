//! Transfer: sends a file of any size to another robot. The transfer resumes after an interruption of the link.
//!
//!     cargo run --example transfer -- wombat-1                        # receives files into the folder `received`
//!     cargo run --example transfer -- wombat-2 wombat-1 map.bin       # sends a file
use std::path::Path;

use rect::ReceiveOptions;

/// Maximum size of a file. Larger ones are refused.
const MAX_BYTES: u64 = 1 << 30;

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut arguments = std::env::args().skip(1);
    let me = arguments.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    if let (Some(other), Some(file)) = (arguments.next(), arguments.next()) {
        let on_progress = |progress: rect::Progress| {
            println!("{:3.0} %", progress.fraction() * 100.0);
        };
        let transfer = robot.transfer(other.as_str(), "files", Path::new(&file))?;
        transfer.on_progress(on_progress).await?;
        println!("{file}: complete");
        return Ok(());
    }
    let options = ReceiveOptions::in_folder("received", MAX_BYTES);
    let files = robot.receive_transfers("*/files", options).await?;
    println!("{} receives files; press Ctrl-C to stop", robot.name());
    while let Some(file) = files.next().await {
        match file {
            Ok(file) => println!(
                "{} from {}: {:?}",
                file.transfer.name, file.transfer.sender, file.content
            ),
            Err(error) => println!("{error}"),
        }
    }
    Ok(())
}

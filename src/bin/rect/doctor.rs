//! Owns `rect doctor`: what a program needs, looked at one after another. What the router and Bluetooth need is
//! `rect-router doctor`'s to say, which this calls.
use std::process::{Command, ExitCode};

use clap::Args;

use crate::{session::JoinArguments, Done};

/// Look for what keeps a program here from talking to other robots, and say what to do.
#[derive(Args)]
pub struct DoctorArguments {
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect doctor`.
pub async fn run(arguments: DoctorArguments) -> Done {
    let mut well = true;
    match arguments.join.join().await {
        Ok(robot) => {
            println!(
                "ok       a program here speaks as {} of the fleet {}",
                robot.name(),
                robot.fleet()
            );
            let peers = robot.peers().await?;
            if peers.is_empty() {
                println!("note     no other robot of the fleet is there now");
            } else {
                let names: Vec<_> = peers.iter().map(|peer| peer.as_str()).collect();
                println!("ok       other robots there: {}", names.join(", "));
            }
            robot.close().await?;
        }
        Err(error) => {
            well = false;
            println!("trouble  {error}");
        }
    }
    println!("         what the router and Bluetooth need (rect-router doctor):");
    match Command::new("rect-router").arg("doctor").status() {
        Ok(status) => well &= status.success(),
        Err(error) => {
            well = false;
            println!("trouble  rect-router can't be started ({error}): install it, or put it on the PATH");
        }
    }
    Ok(if well {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

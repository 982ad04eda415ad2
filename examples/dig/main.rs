//! Dig: a robot carries out a long task, which another one starts, follows and cancels.
//!
//!     cargo run --example dig -- wombat-2                  # digs when it is asked to
//!     cargo run --example dig -- wombat-1 wombat-2 5       # asks wombat-2 to dig 5 cm deep, and prints how it goes
use std::time::Duration;

use rect::{Goal, Json};

async fn dig(goal: Goal) -> Result<String, String> {
    let depth: u32 = goal.payload.value().map_err(|error| error.to_string())?;
    for done in 0..depth {
        let sent = goal.feedback(
            format!("{done} cm"),
            Some(f64::from(done) / f64::from(depth)),
        );
        sent.map_err(|error| error.to_string())?;
        // Fails if the goal is cancelled: then nothing more is dug.
        let slept = goal.sleep(Duration::from_millis(500)).await;
        slept.map_err(|cancelled| cancelled.to_string())?;
    }
    Ok(format!("a hole of {depth} cm"))
}

#[tokio::main]
async fn main() -> Result<(), rect::Error> {
    let mut arguments = std::env::args().skip(1);
    let me = arguments.next().unwrap_or("wombat-1".to_owned());
    let robot = rect::connect(&me).await?;
    let Some(digger) = arguments.next() else {
        let _action = robot.action("dig", dig).await?;
        println!("ready to dig, until Ctrl-C");
        std::future::pending::<()>().await;
        return Ok(());
    };
    let depth = arguments.next().and_then(|depth| depth.parse().ok());
    let run = robot
        .start(digger.as_str(), "dig", Json(depth.unwrap_or(5_u32)))
        .await?;
    let (mut changes, mut last) = (run.changes(), None);
    while changes.next().await.is_some() {
        let progress = run.progress();
        if let Some(news) = run.feedback().filter(|_| progress != last) {
            let percent = 100.0 * progress.unwrap_or(0.0);
            println!("{}, {percent:.0} %", news.value::<String>()?);
            last = progress;
        }
    }
    // The result, or the reason why there is none: the goal has failed, or was refused, cancelled or preempted.
    println!("{}", run.result::<String>().await?);
    Ok(())
}

//! Stops the fleet, and releases a stop.
use std::{process::ExitCode, time::Duration};

use clap::Args;
use rect::{Confirmation, FleetStop, Name, Robot};
use rect_core::text::display::line;
use rect_terminal::{paint, paint_err, Style};
use tokio::time::{timeout_at, Instant};

use crate::{session::JoinArguments, Done, Failure};

/// How long it takes at most until the values of all robots that can be reached have arrived.
const LEARNS_WITHIN: Duration = Duration::from_secs(1);
const EXAMPLE: &str = "\
Examples:
  rect stop 'wombat-2 is on the table edge'   # stops all robots whose programs take part, until somebody releases it
  rect stop --list                            # shows whether the fleet is stopped, by whom, and which robots have confirmed it
  rect stop --release                         # moves nothing yet: each robot waits for a neutral command

Exit status: 0 if all reachable robots that take part have confirmed, 1 if one has not.";

/// Stop all robots of the fleet, until somebody releases the stop
#[derive(Args)]
#[command(after_help = EXAMPLE)]
pub struct StopArguments {
    /// Why, in a few words, for people
    #[arg(default_value = "", conflicts_with_all = ["release", "list"])]
    reason: String,
    /// Release all stops
    #[arg(long, conflicts_with = "list")]
    release: bool,
    /// Only show the stops that nobody has released, and which robots have confirmed them
    #[arg(long)]
    list: bool,
    /// How long to wait for the confirmations, in seconds
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0)]
    within: f64,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect stop`.
pub async fn run(arguments: StopArguments) -> Done {
    let within = Duration::try_from_secs_f64(arguments.within)
        .map_err(|_| "--within must be a number of seconds, such as 3")?;
    let robot = arguments.join.join().await?;
    let stop = robot.fleet_stop().await?;
    let mut sent = Ok(());
    if arguments.list || arguments.release {
        learn(&stop).await;
    }
    match (arguments.list, arguments.release) {
        (true, _) => {}
        (false, true) => sent = stop.release().await,
        (false, false) => sent = stop.press(&arguments.reason).await,
    }
    if let Err(error) = &sent {
        eprintln!("{} {error}", paint_err(Style::Wrong, "rect:"));
    }
    let is_confirmed = show(&robot, &stop, within).await?;
    for pressed in stop.pressed() {
        println!("{}", line(&pressed.in_words()));
    }
    if !stop.is_stopped() {
        println!("the fleet is not stopped");
    }
    robot.close().await?;
    Ok(ExitCode::from(u8::from(!is_confirmed || sent.is_err())))
}

/// Waits for what the robots know of stops. It has been retained before this program began.
async fn learn(stop: &FleetStop) {
    let mut changes = stop.changes();
    let until = Instant::now() + LEARNS_WITHIN;
    while timeout_at(until, changes.next()).await.is_ok() {}
}

/// Waits for the confirmations of the robots that can be reached, and prints them. Returns whether all of them that take part have
/// confirmed.
async fn show(robot: &Robot, stop: &FleetStop, within: Duration) -> Result<bool, Failure> {
    let mut changes = stop.changes();
    let until = Instant::now() + within;
    let mut robots: Vec<Name> = robot.peers().await?;
    loop {
        let waiting = robots
            .iter()
            .any(|robot| stop.confirmation(robot) != Some(Confirmation::Confirmed));
        if !waiting || timeout_at(until, changes.next()).await.is_err() {
            break;
        }
    }
    robots.sort();
    let mut is_confirmed = true;
    for other in &robots {
        let confirmation = stop.confirmation(other);
        let (style, text) = match confirmation {
            Some(Confirmation::Confirmed) => (Style::Good, "has confirmed"),
            Some(Confirmation::Waiting) => (Style::Wrong, "has not confirmed"),
            Some(Confirmation::Ended) => (Style::Faint, "takes no part: its program has ended"),
            None => (Style::Faint, "takes no part: none of its programs does"),
        };
        is_confirmed &= confirmation != Some(Confirmation::Waiting);
        println!("{} {text}", paint(style, other.as_str()));
    }
    Ok(is_confirmed)
}

//! Implements `rect bench`, which measures the connection to another robot that runs `rect bench --serve`.
use std::{process::ExitCode, time::Duration};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rect::{Name, Robot};
use rect_core::text::display::line;
use serde_json::{json, Value};

use crate::{
    duration::DurationArgument,
    measure::{
        goodput::{self, Goodput},
        partner::Partner,
        round_trip::{self, RoundTrips, PING_BYTES},
    },
    session::{name, JoinArguments},
    Done,
};

/// Size of a message of the load, in bytes.
const LOAD_BYTES: usize = 4096;

/// Measure the round trip (idle and under load), goodput and loss to another robot that runs `rect bench --serve`
#[derive(Args)]
pub struct BenchArguments {
    /// The other robot
    #[arg(value_parser = name, required_unless_present = "serve")]
    robot: Option<Name>,
    /// Serve measurements of other robots, until Ctrl-C
    #[arg(long, conflicts_with = "robot")]
    serve: bool,
    /// The duration of each of the two measurements
    #[arg(long, default_value = "5s")]
    duration: DurationArgument,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect bench`.
pub async fn run(arguments: BenchArguments) -> Done {
    let robot = arguments.join.join().await?;
    let Some(other) = arguments.robot else {
        return serve(&robot).await;
    };
    let duration = arguments.duration.0;
    // One duration for each of the two measurements.
    let bar = progress(duration * 2);
    let advance = |time: Duration| bar.inc(time.as_millis() as u64);
    let idle = round_trip::measure(&robot, &other, duration, advance).await?;
    let (goodput, loaded) = tokio::join!(
        goodput::to(&robot, &other, LOAD_BYTES, duration),
        round_trip::measure(&robot, &other, duration, advance)
    );
    let (goodput, loaded) = (goodput?, loaded?);
    bar.finish_and_clear();
    let method = method(&robot, &other).await;
    if arguments.json {
        let all = json!({
            "robot": other, "method": method, "idle": to_json(&idle), "under_load": to_json(&loaded),
            "goodput_kb_s": goodput.kb_per_s, "load_messages": goodput.sent, "load_lost": goodput.lost,
        });
        rect_terminal::json(&all)?;
        return Ok(ExitCode::SUCCESS);
    }
    rect_terminal::outln!(
        "{other}, linked by {}",
        line(method.as_deref().unwrap_or("another robot"))
    );
    for (condition, round_trips) in [("idle", idle), ("under load", loaded)] {
        rect_terminal::outln!(
            "round trip, {condition}: p50 {:.1} ms, p99 {:.1} ms ({} replies, {} lost; urgent, {PING_BYTES} bytes)",
            round_trips.quantile_ms(0.5).unwrap_or(f64::NAN),
            round_trips.quantile_ms(0.99).unwrap_or(f64::NAN),
            round_trips.replies(),
            round_trips.lost
        );
    }
    let Goodput {
        kb_per_s,
        sent,
        lost,
        ..
    } = goodput;
    rect_terminal::outln!(
        "goodput: {kb_per_s:.1} kB/s ({} of {sent} messages of {LOAD_BYTES} bytes, {lost} lost)",
        sent.saturating_sub(lost)
    );
    Ok(ExitCode::SUCCESS)
}

async fn serve(robot: &Robot) -> Done {
    let partner = Partner::serve(robot).await?;
    rect_terminal::errln!(
        "rect: ready; start the measurement on the other robot with `rect bench {}`; press Ctrl-C to exit",
        robot.name()
    );
    partner.run().await?;
    Ok(ExitCode::SUCCESS)
}

/// Returns the method of the link with `other`, if the two robots are linked.
async fn method(robot: &Robot, other: &Name) -> Option<String> {
    let me = robot.name().as_str();
    let connections = robot.connections_of(other, "").await.ok()?;
    let mut connections = connections.into_iter();
    connections
        .find(|connection| connection.robot() == Some(me))
        .map(|connection| connection.method)
}

fn to_json(round_trips: &RoundTrips) -> Value {
    json!({
        "p50_ms": round_trips.quantile_ms(0.5), "p99_ms": round_trips.quantile_ms(0.99),
        "answers": round_trips.replies(), "lost": round_trips.lost,
    })
}

fn progress(duration: Duration) -> ProgressBar {
    let bar = ProgressBar::new(duration.as_millis() as u64);
    let style = ProgressStyle::with_template("{bar:40} {percent}%");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}

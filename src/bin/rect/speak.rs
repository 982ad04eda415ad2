//! Owns `rect pub` and `rect send`.
use std::{process::ExitCode, time::Duration};

use clap::Args;
use rect::{Name, Payload, Robot, Topic};
use tokio::time::{interval, MissedTickBehavior};

use crate::{
    payload::PayloadArguments,
    session::{name, JoinArguments, SpeakArguments},
    span::Span,
    Done, Failure,
};

/// Say something to all.
#[derive(Args)]
pub struct PubArguments {
    /// About what, such as arm/angle
    topic: Topic,
    #[command(flatten)]
    saying: SayingArguments,
}

/// Say something to one robot alone.
#[derive(Args)]
pub struct SendArguments {
    /// To whom
    #[arg(value_parser = name)]
    robot: Name,
    /// About what, such as arm/angle
    topic: Topic,
    #[command(flatten)]
    saying: SayingArguments,
}

#[derive(Args)]
struct SayingArguments {
    #[command(flatten)]
    payload: PayloadArguments,
    /// Again and again, at this interval: 100ms, 1s
    #[arg(long, value_name = "INTERVAL")]
    every: Option<Span>,
    /// So often [default: once; with --every, until Ctrl-C]
    #[arg(long)]
    count: Option<u64>,
    #[command(flatten)]
    speak: SpeakArguments,
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect pub`.
pub async fn publish(arguments: PubArguments) -> Done {
    let topic = arguments.topic;
    say(arguments.saying, async |robot, payload| {
        robot.publish(&topic, payload).await
    })
    .await
}

/// `rect send`.
pub async fn send(arguments: SendArguments) -> Done {
    let (to, topic) = (arguments.robot, arguments.topic);
    say(arguments.saying, async |robot, payload| {
        robot.send(&to, &topic, payload).await
    })
    .await
}

async fn say(
    arguments: SayingArguments,
    say: impl AsyncFn(&Robot, Payload) -> Result<(), rect::Error>,
) -> Done {
    let payload = arguments.payload.payload()?;
    let robot = arguments.join.join().await?;
    let speaking = arguments.speak.of(&robot)?;
    let again = arguments.every.is_some();
    let times = arguments.count.unwrap_or(if again { u64::MAX } else { 1 });
    let every = arguments
        .every
        .map_or(Duration::from_millis(1), |span| span.0);
    if every.is_zero() {
        return Err(Failure::from("--every 0s: the interval is to be longer"));
    }
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    for _ in 0..times {
        ticks.tick().await;
        say(&speaking, payload.clone()).await?;
    }
    if arguments.speak.dictionary.is_some() {
        rect::errln!("rect: staying for those who fetch the dictionary; Ctrl-C ends this");
        std::future::pending::<()>().await;
    }
    robot.close().await?;
    Ok(ExitCode::SUCCESS)
}

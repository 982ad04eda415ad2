//! Implements `rect pub` and `rect send`.
use std::{process::ExitCode, time::Duration};

use clap::Args;
use rect::{Name, Payload, Robot, Topic};
use tokio::time::{interval, MissedTickBehavior};

use crate::{
    duration::DurationArgument,
    payload::PayloadArguments,
    retained::Place,
    session::{name, DeliveryArguments, JoinArguments},
    Done, Failure,
};

/// Publish a message to every robot
#[derive(Args)]
pub struct PubArguments {
    /// The topic, such as arm/angle
    topic: Topic,
    #[command(flatten)]
    message: MessageArguments,
    /// Keep the value at the router of this robot, for programs that start later: in its memory, or with `disk` also on its disk, where it
    /// survives a restart
    #[arg(long, value_name = "PLACE", value_enum, num_args = 0..=1, require_equals = true, default_missing_value = "memory")]
    retained: Option<Place>,
}

/// Send a message to one robot only
#[derive(Args)]
pub struct SendArguments {
    /// The robot
    #[arg(value_parser = name)]
    robot: Name,
    /// The topic, such as arm/angle
    topic: Topic,
    #[command(flatten)]
    message: MessageArguments,
}

#[derive(Args)]
struct MessageArguments {
    #[command(flatten)]
    payload: PayloadArguments,
    /// Repeat the message at this interval, such as 100ms or 1s
    #[arg(long, value_name = "INTERVAL")]
    every: Option<DurationArgument>,
    /// How many times to send the message [default: once; with --every, until Ctrl-C]
    #[arg(long)]
    count: Option<u64>,
    #[command(flatten)]
    delivery: DeliveryArguments,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect pub`.
pub async fn publish(arguments: PubArguments) -> Done {
    let PubArguments {
        topic,
        message,
        retained,
    } = arguments;
    repeat(message, async |robot, payload| match retained {
        None => robot.publish(&topic, payload).await,
        Some(place) => place.handle(robot).publish(&topic, payload).await,
    })
    .await
}

/// Runs `rect send`.
pub async fn send(arguments: SendArguments) -> Done {
    let (recipient, topic) = (arguments.robot, arguments.topic);
    repeat(arguments.message, async |robot, payload| {
        robot.send(&recipient, &topic, payload).await
    })
    .await
}

/// Connects, and calls `send` as often as the arguments specify.
async fn repeat(
    arguments: MessageArguments,
    send: impl AsyncFn(&Robot, Payload) -> Result<(), rect::Error>,
) -> Done {
    let payload = arguments.payload.payload()?;
    let robot = arguments.join.join().await?;
    let handle = arguments.delivery.apply(&robot)?;
    let default_count = if arguments.every.is_some() {
        u64::MAX
    } else {
        1
    };
    let count = arguments.count.unwrap_or(default_count);
    let every = arguments
        .every
        .map_or(Duration::from_millis(1), |interval| interval.0);
    if every.is_zero() {
        return Err(Failure::from(
            "--every 0s: the interval must be greater than zero",
        ));
    }
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    for _ in 0..count {
        ticks.tick().await;
        if let Err(error) = send(&handle, payload.clone()).await {
            // A message that is not retained was published, and leaves the program before it ends.
            robot.close().await?;
            return Err(error.into());
        }
    }
    if arguments.delivery.dictionary.is_some() {
        rect_terminal::errln!(
            "rect: serving the dictionary to the receivers; press Ctrl-C to exit"
        );
        std::future::pending::<()>().await;
    }
    robot.close().await?;
    Ok(ExitCode::SUCCESS)
}

//! Implements `rect request` and `rect serve`.
use std::{
    pin::pin,
    process::{ExitCode, Stdio},
    time::Duration,
};

use clap::Args;
use rect::{Encoding, Error, Payload, Reply, Robot, Topic};
use rect_terminal as terminal;
use serde_json::json;
use tokio::{io::AsyncWriteExt, process::Command};

use crate::{
    display,
    duration::DurationArgument,
    payload::PayloadArguments,
    report,
    session::{name, DeliveryArguments, JoinArguments},
    Done, Failure,
};

/// Send a request to a service of a robot, and print the reply
#[derive(Args)]
pub struct RequestArguments {
    /// The robot, or '*' for all robots that provide the service
    robot: String,
    /// The topic of the service, such as battery
    topic: Topic,
    #[command(flatten)]
    payload: PayloadArguments,
    /// How long to wait for the reply, or for all replies
    #[arg(long, default_value = "5s")]
    timeout: DurationArgument,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    delivery: DeliveryArguments,
    #[command(flatten)]
    join: JoinArguments,
}

/// Provide a service with a program that reads the request from stdin and prints the reply to stdout
///
/// The program is started for each request. The environment variable RECT_SENDER contains the name of the requesting robot.
/// If the program fails, the reply is an error with the text that it printed to stderr.
#[derive(Args)]
pub struct ServeArguments {
    /// The topic of the service, such as battery
    topic: Topic,
    /// The program and its arguments, such as: -- cat /sys/class/power_supply/BAT0/capacity
    #[arg(required = true, last = true)]
    program: Vec<String>,
    #[command(flatten)]
    join: JoinArguments,
}

/// Runs `rect request`.
pub async fn request(arguments: RequestArguments) -> Done {
    let payload = arguments.payload.payload()?;
    let robot = arguments.join.join_unnamed().await?;
    let robot = arguments.delivery.apply(&robot)?;
    let timeout = arguments.timeout.0;
    if arguments.robot == "*" {
        return request_all(&robot, &arguments, payload, timeout).await;
    }
    let recipient = name(&arguments.robot)?;
    let reply = robot
        .with_timeout(timeout)
        .request::<Payload>(&recipient, &arguments.topic, payload)
        .await?;
    show(&reply, arguments.json)?;
    Ok(ExitCode::SUCCESS)
}

async fn request_all(
    robot: &Robot,
    arguments: &RequestArguments,
    payload: Payload,
    timeout: Duration,
) -> Done {
    let replies = robot
        .with_timeout(timeout)
        .request_all::<Payload>(&arguments.topic, payload)
        .await?;
    let mut answers = 0;
    while let Some(reply) = replies.next().await {
        match reply {
            Ok(reply) => {
                answers += 1;
                show(&reply, arguments.json)?;
            }
            Err(error @ Error::TimedOut { .. }) if answers == 0 => return Err(error.into()),
            Err(error) => report(&error),
        }
    }
    if answers == 0 {
        return Err(format!("no robot replied about {}", arguments.topic).into());
    }
    Ok(ExitCode::SUCCESS)
}

fn show(reply: &Reply, as_json: bool) -> Result<(), Failure> {
    let Reply {
        sender, payload, ..
    } = reply;
    if as_json {
        let encoding = payload.encoding.as_str();
        let reply =
            json!({ "sender": sender, "encoding": encoding, "value": display::json(payload) });
        terminal::json_line(&reply)?;
    } else {
        rect_terminal::outln!("{sender}: {}", display::text(payload));
    }
    Ok(())
}

/// Runs `rect serve`.
pub async fn serve(arguments: ServeArguments) -> Done {
    let robot = arguments.join.join().await?;
    let program = arguments.program.clone();
    let answer = move |request: std::sync::Arc<rect::Request>| {
        let program = program.clone();
        async move { answer(&program, &request).await }
    };
    let _service = robot.serve(&arguments.topic, answer).await?;
    let (me, topic) = (robot.name(), &arguments.topic);
    rect_terminal::errln!(
        "rect: {me} serves {topic}; test it with `rect request {me} {topic}`; press Ctrl-C to exit"
    );
    std::future::pending().await
}

/// Runs the program with the request as its input, and returns its output, or an error with what it printed to stderr.
async fn answer(program: &[String], request: &rect::Request) -> Result<Payload, String> {
    let Some((name, arguments)) = program.split_first() else {
        return Err("no program is given".to_owned());
    };
    let mut command = Command::new(name);
    command.args(arguments).kill_on_drop(true);
    if let Some(sender) = &request.sender {
        command.env("RECT_SENDER", sender.as_str());
    }
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let failed = |error: std::io::Error| format!("{name}: {error}");
    let mut child = command.spawn().map_err(failed)?;
    let stdin = child.stdin.take();
    let write_input = async {
        if let Some(mut stdin) = stdin {
            // Fails if the program does not read its input, which is permitted.
            let _ = stdin.write_all(&request.payload.bytes).await;
        }
    };
    // A program may print before it has read all its input, or exit without reading it.
    let run = async {
        let mut output = pin!(child.wait_with_output());
        tokio::select! {
            output = &mut output => output,
            () = write_input => output.await,
        }
    };
    let output = tokio::time::timeout(request.remaining(), run).await;
    let output = output
        .map_err(|_| format!("{name} did not finish before the timeout of the request"))?
        .map_err(failed)?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        return Err(format!("{name}: {} {}", output.status, text.trim()));
    }
    let mut bytes = output.stdout;
    if bytes.last() == Some(&b'\n') {
        bytes.pop();
    }
    let encoding = match std::str::from_utf8(&bytes) {
        Ok(text) if serde_json::from_str::<serde::de::IgnoredAny>(text).is_ok() => Encoding::JSON,
        Ok(_) => Encoding::TEXT,
        Err(_) => Encoding::BYTES,
    };
    Ok(Payload::new(bytes, encoding))
}

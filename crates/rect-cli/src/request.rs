//! Implements `rect request` and `rect serve`.
use std::{
    pin::pin,
    process::{ExitCode, Stdio},
};

use clap::Args;
use rect::{Encoding, Payload, Reply, Robot, ServiceOptions, Topic};
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
    /// Repeat the request while the link is interrupted; it is carried out at most once
    #[arg(long, conflicts_with = "stream")]
    retry: bool,
    /// Print all replies of a service that sends several
    #[arg(long)]
    stream: bool,
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
/// If the program fails, the reply is an error with the text that it printed to stderr. The program is stopped when nobody waits for
/// the reply any more.
#[derive(Args)]
pub struct ServeArguments {
    /// The topic of the service, such as battery
    topic: Topic,
    /// The purpose of the service, for `rect service list` and the dashboard
    #[arg(long, default_value = "", hide_default_value = true)]
    about: String,
    /// Let other programs of this robot serve the same topic, if they allow it, too; each of them replies
    #[arg(long)]
    allow_several: bool,
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
    let (mut robot, topic) = (robot.with_timeout(timeout), &arguments.topic);
    if arguments.robot == "*" {
        if arguments.retry || arguments.stream {
            return Err("--retry and --stream need the name of a robot".into());
        }
        return request_all(&robot, &arguments, payload).await;
    }
    let recipient = name(&arguments.robot)?;
    if arguments.stream {
        let replies = robot.request_stream::<Payload>(&recipient, topic, payload);
        let replies = replies.await?;
        while let Some(reply) = replies.next().await {
            show(&reply?, arguments.json)?;
        }
        return Ok(ExitCode::SUCCESS);
    }
    if arguments.retry {
        robot = robot.retrying();
    }
    let reply = robot.request::<Payload>(&recipient, topic, payload).await?;
    show(&reply, arguments.json)?;
    Ok(ExitCode::SUCCESS)
}

/// Prints the replies, and on standard error why other robots have not replied.
async fn request_all(robot: &Robot, arguments: &RequestArguments, payload: Payload) -> Done {
    let replies = robot.request_all::<Payload>(&arguments.topic, payload);
    let gathered = replies.await?.gather().await?;
    let mut has_reply = false;
    for outcome in gathered.outcomes {
        match outcome.result {
            Ok(reply) => {
                has_reply = true;
                show(&reply, arguments.json)?;
            }
            Err(error) => report(&error),
        }
    }
    if !has_reply {
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
    let options = ServiceOptions {
        about: arguments.about,
        allow_several: arguments.allow_several,
    };
    let served = robot.serve_with(&arguments.topic, options, answer);
    let _service = served.await?;
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
    let output = tokio::select! {
        output = run => output.map_err(failed)?,
        () = request.unwanted() => {
            return Err(format!("{name} did not finish before the timeout of the request"));
        }
    };
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

//! Owns `rect request` and `rect serve`.
use std::{process::ExitCode, process::Stdio, time::Duration};

use clap::Args;
use rect::{terminal, Encoding, Error, Payload, Reply, Robot, Topic};
use serde_json::json;
use tokio::{io::AsyncWriteExt, process::Command};

use crate::{
    payload::PayloadArguments,
    report,
    session::{name, JoinArguments, SpeakArguments},
    shown::{self, shown},
    span::Span,
    Done, Failure,
};

/// Ask a service of a robot, and show its answer.
#[derive(Args)]
pub struct RequestArguments {
    /// Whom; '*' asks all robots that have it
    robot: String,
    /// The service, such as battery
    topic: Topic,
    #[command(flatten)]
    payload: PayloadArguments,
    /// How long to wait
    #[arg(long, default_value = "5s")]
    timeout: Span,
    /// As JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    speak: SpeakArguments,
    #[command(flatten)]
    join: JoinArguments,
}

/// Serve requests with a program: it gets each on its standard input, and what it prints is the answer.
///
/// A program that fails is answered as an error, with what it prints on stderr.
#[derive(Args)]
pub struct ServeArguments {
    /// The service, such as battery
    topic: Topic,
    /// The program and its arguments, such as: -- cat /sys/class/power_supply/BAT0/capacity
    #[arg(required = true, last = true)]
    program: Vec<String>,
    #[command(flatten)]
    join: JoinArguments,
}

/// `rect request`.
pub async fn request(arguments: RequestArguments) -> Done {
    let payload = arguments.payload.payload()?;
    let robot = arguments.join.join_to_hear().await?;
    let asking = arguments.speak.of(&robot)?;
    let timeout = arguments.timeout.0;
    if arguments.robot == "*" {
        return request_all(&asking, &arguments, payload, timeout).await;
    }
    let whom = name(&arguments.robot)?;
    let reply = asking
        .request(&whom, &arguments.topic, payload, timeout)
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
    let mut replies = robot
        .request_all(&arguments.topic, payload, timeout)
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
        return Err(format!("nobody answers about {}", arguments.topic).into());
    }
    Ok(ExitCode::SUCCESS)
}

fn show(reply: &Reply, as_json: bool) -> Result<(), Failure> {
    let Reply { from, payload } = reply;
    if as_json {
        let encoding = payload.encoding.as_str();
        let reply = json!({ "from": from, "encoding": encoding, "value": shown::json(payload) });
        terminal::json_line(&reply)?;
    } else {
        rect::outln!("{from}: {}", shown(payload));
    }
    Ok(())
}

/// `rect serve`.
pub async fn serve(arguments: ServeArguments) -> Done {
    let robot = arguments.join.join().await?;
    let program = arguments.program.clone();
    let answer = move |request: std::sync::Arc<rect::Request>| {
        let program = program.clone();
        async move { answer(&program, &request).await }
    };
    let _service = robot.serve(&arguments.topic, answer).await?;
    let (me, topic) = (robot.name(), &arguments.topic);
    rect::errln!("rect: {me} serves {topic}; `rect request {me} {topic}` asks; Ctrl-C ends this");
    std::future::pending().await
}

async fn answer(program: &[String], request: &rect::Request) -> Result<Payload, String> {
    let Some((name, arguments)) = program.split_first() else {
        return Err("no program".to_owned());
    };
    let mut command = Command::new(name);
    command.args(arguments).kill_on_drop(true);
    if let Some(from) = &request.from {
        command.env("RECT_FROM", from.as_str());
    }
    command
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    let failed = |error: std::io::Error| format!("{name}: {error}");
    let mut child = command.spawn().map_err(failed)?;
    if let Some(mut input) = child.stdin.take() {
        // One that does not read its input is fine.
        let _ = input.write_all(&request.payload.bytes).await;
    }
    let output = tokio::time::timeout(request.remaining(), child.wait_with_output()).await;
    let output = output
        .map_err(|_| format!("{name} takes too long"))?
        .map_err(failed)?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(format!("{name}: {} {}", output.status, said.trim()));
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
